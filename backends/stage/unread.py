"""Reports what a stage has that the reader does not follow: a line for each kind of it.

Nothing is dropped in silence. Of every concrete type that USD knows one of four tables says what
becomes of it (a test goes through USD's registry); of types that are read, attributes that are
authored, differ from what they are without, and are not followed are named as well. Only what would
be drawn counts: the reader's walk leaves out what is hidden, guides and proxies.
"""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdSemantics, UsdShade, UsdSkel

from scenec.backends.stage import values
from scenec.backends.stage.deforming import is_skinned
from scenec.backends.stage.followed import NEUTRAL, is_followed
from scenec.backends.stage.implicit import LENGTHS, kind_of
from scenec.backends.stage.omniverse import applied_schemas, model_of
from scenec.backends.stage.products import settings_of_products
from scenec.backends.stage.rigid import flat, sheared, stretched
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.textures import (
    INPUTS,
    connected,
    constant,
    opacity_threshold,
    texture_maps,
)
from scenec.schemas import stage as names
from scenec.schemas.omnipbr import mdl_shader
from scenec.schemas.passes import is_pass

_FIRST = Usd.TimeCode.EarliestTime()
_CONSTANT = UsdGeom.Tokens.constant
_UNKNOWN = Sdf.SpecTypeUnknown
_SUBDIVIDED = (UsdGeom.Tokens.catmullClark, UsdGeom.Tokens.loop)
#: Attributes of meshes whose change makes other faces of them.
_DEFORMING = (
    *("faceVertexCounts", "faceVertexIndices", "holeIndices"),
    *("cornerIndices", "cornerSharpnesses", "creaseIndices", "creaseLengths", "creaseSharpnesses"),
    *("interpolateBoundary", "faceVaryingLinearInterpolation", "triangleSubdivisionRule"),
)

#: Types of lights that are drawn.
LIGHTS = ("DistantLight", "DomeLight", "DomeLight_1", "SphereLight")

#: Types that become something of a RenderScene.
READ = frozenset(
    (
        *("Mesh", "BasisCurves", "GeomSubset", "PointInstancer", "Camera", "Material", "Shader"),
        *("NodeGraph", "RenderProduct", "RenderVar", *LIGHTS),
    )
)

#: Types that become triangles.
TESSELLATED = frozenset(LENGTHS)

#: Types that show nothing themselves: groups, what others refer to and then are named for, physics.
HARMLESS = frozenset(
    (
        *("Xform", "Scope", "SkelRoot", "Skeleton", "SkelAnimation", "BlendShape", "Backdrop"),
        *("OpenVDBAsset", "Field3DAsset", "LODDistanceHeuristic", "LODScreenSizeHeuristic"),
        *(
            "RenderSettings",
            "RenderPass",
            "SpatialAudio",
            "PhysicsScene",
            "PhysicsCollisionGroup",
            "PhysicsJoint",
        ),
        *("PhysicsFixedJoint", "PhysicsRevoluteJoint", "PhysicsPrismaticJoint"),
        *("PhysicsSphericalJoint", "PhysicsDistanceJoint"),
    )
)

#: Types that show something, or shape light, and are not read.
LOST = frozenset(
    (
        *("HermiteCurves", "NurbsCurves", "NurbsPatch", "Points", "TetMesh"),
        *("Volume", "ParticleField", "ParticleField3DGaussianSplat", "GenerativeProcedural"),
        *("CylinderLight", "DiskLight", "RectLight", "GeometryLight", "PortalLight"),
        *("PluginLight", "LightFilter", "PluginLightFilter"),
    )
)

KNOWN = READ | TESSELLATED | HARMLESS | LOST
#: A plug-in's type that derives from one of these is taken for it.
_BASES = (
    *(UsdGeom.Mesh, UsdGeom.BasisCurves, UsdGeom.PointInstancer, UsdGeom.Xform, UsdGeom.Scope),
    *(getattr(UsdGeom, kind) for kind in LENGTHS),
)

_FILTERS = "light:filters"
#: What names of other renderers' attributes and schemas say where they are about a lens.
_LENS = re.compile("projection|lens|distort|fisheye|panoram", re.IGNORECASE)
#: Their values for no other lens than the pinhole.
_PINHOLES = ("pinhole", "perspective", "none", "")
#: Inputs of UsdPreviewSurface that are not followed, and the value at which they do nothing.
_WITHOUT_EFFECT = {
    "displacement": 0.0,
    "clearcoat": 0.0,
    "normal": Gf.Vec3f(0.0, 0.0, 1.0),
}
#: What is said of opacity that is no cut-out.
BLENDED = (
    "opacity of UsdPreviewSurface without opacityThreshold is no blend: what is below "
    f"{names.OPACITY_THRESHOLD} is cut out"
)
#: What is said of opacity that is given by shape.
FADED = (
    "displayOpacity is no blend: triangles of which the mean is below "
    f"{names.OPACITY_THRESHOLD} are left out"
)
#: Those that may be textures, by the kind of map that they become.
_TEXTURED = {name: kind for kind, name in INPUTS.items()}
#: Those that may be primvars.
_DISPLAYED = {"diffuseColor": "displayColor", "opacity": "displayOpacity"}
#: Those that only say how one of the others is meant, or of no effect on traced light.
_ASIDE = frozenset(
    ("useSpecularWorkflow", "opacityThreshold", "opacityMode", "clearcoatRoughness", "occlusion")
)


def gobo_of(light: Usd.Prim) -> Usd.Prim | None:
    """The filter that a DistantLight shines through, if it is a picture and there is no other.

    Raises:
        StageError: ``light:filters`` cannot be read.
    """
    if light.GetTypeName() != "DistantLight":
        return None
    found = [light.GetStage().GetPrimAtPath(path) for path in values.targets(light, _FILTERS)]
    if len(found) != 1 or not found[0] or found[0].GetTypeName() != "LightFilter":
        return None
    return found[0] if found[0].HasAttribute(names.ATTR_GOBO_FILE) else None


class Unread:
    """Collects what is not followed, in the order in which it is met.

    Args:
        moving: Whether what changes over time is seen to, or would be if its range were authored.
        sources: Of the stage.
    """

    def __init__(self, moving: bool, sources: Sources):
        self._moving = moving
        self._sources = sources
        #: By what is lost: the path to tell, by path of the prim (in its prototype).
        self._found: dict[str, dict[str, str]] = {}
        self._materials: set[str] = set()

    @property
    def lines(self) -> tuple[str, ...]:
        """Returns a line for each loss: its number of prims, the first; a prototype counts once."""
        return tuple(
            f"{what}: {len(paths)} prim{'s, the first is' if len(paths) > 1 else ','} "
            f"{next(iter(paths.values()))}"
            for what, paths in self._found.items()
        )

    def add(self, what: str, prim: Usd.Prim) -> None:
        """Notes that something of a prim is not followed."""
        source = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
        self._found.setdefault(what, {}).setdefault(str(source.GetPath()), str(prim.GetPath()))

    def prim(self, prim: Usd.Prim, in_prototype: bool) -> None:
        """Notes what of a prim is not followed, apart from its shape.

        Args:
            prim: Any prim that the reader comes by.
            in_prototype: Whether it is part of an instancer's prototype.
        """
        kind = str(prim.GetTypeName())
        if kind == "LightFilter" and prim.HasAttribute(names.ATTR_GOBO_FILE):
            self._attributes(prim, kind)
        elif kind in LOST:
            self.add(f"{kind} is not read", prim)
        elif kind and kind not in KNOWN and not any(prim.IsA(schema) for schema in _BASES):
            self.add(f"the type {kind} is not known", prim)
        if prim.HasAPI(UsdLux.LightAPI) and kind not in LOST:
            self._light(prim, kind, in_prototype)
        elif kind == "Camera" and in_prototype:
            self.add("a camera in the prototype of an instancer is not rendered", prim)
        elif kind == "BlendShape":
            shape = UsdSkel.BlendShape(prim)
            offsets = shape.GetNormalOffsetsAttr().Get() or ()
            if offsets and len(offsets) != len(shape.GetOffsetsAttr().Get() or ()):
                self.add("normalOffsets of another number than a BlendShape's offsets", prim)
        elif kind == "RenderProduct":
            self._attributes(prim, kind)
        elif kind == "RenderSettings":
            self._attributes(prim, kind)
            chosen = settings_of_products(prim.GetStage())
            if any(chosen.get(path) != prim for path in values.targets(prim, "products")):
                self.add("RenderSettings are not followed of products that others list", prim)
        elif kind == "RenderPass":
            if any(
                found.HasAuthoredTargets()
                for found in prim.GetAuthoredRelationships()
                if found.GetName().startswith("collection:")
            ) or any(
                name.endswith(":membershipExpression") for name in _in_namespace(prim, "collection")
            ):
                self.add("collections of RenderPass are not followed", prim)
        elif kind == "RenderVar":
            source = values.word(UsdRender.Var(prim).GetSourceNameAttr(), "")
            if not is_pass(source.split(".")[0]):
                self.add("a render variable of another renderer is not made", prim)
        elif kind == "GeomSubset":
            if self._changes(UsdGeom.Subset(prim).GetIndicesAttr()):
                self.add("subsets that change stay as they are at the first sample", prim)
        elif kind == "PointInstancer":
            self._attributes(prim, kind)
            instancer = UsdGeom.PointInstancer(prim)
            if self._changes(instancer.GetProtoIndicesAttr(), instancer.GetIdsAttr()):
                self.add(
                    "prototypes and ids that change stay as they are at the first sample", prim
                )
            if instancer.GetVelocitiesAttr().HasAuthoredValue() and self._changes(
                instancer.GetPositionsAttr()
            ):
                self.add("velocities are not followed, positions between samples are mixed", prim)
            primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
            if primvar and primvar.HasValue() and primvar.GetInterpolation() != _CONSTANT:
                self.add("displayColor of single instances is not shown", prim)
        if prim.HasAPI("LODRootAPI"):
            self.add("levels of detail are not chosen, all are shown", prim)
        hidden = prim.GetAttribute("renderVisibility")
        if hidden and values.word(hidden, "", _FIRST) == UsdGeom.Tokens.invisible:
            self.add("renderVisibility is not followed, what it hides is shown", prim)
        draw_mode = prim.GetAttribute("model:drawMode")
        if draw_mode and values.word(draw_mode, "default") not in ("inherited", "default"):
            self.add("model:drawMode is not followed, all geometry is shown", prim)
        labels = UsdSemantics.LabelsAPI
        if self._moving and self._changes(
            *(labels(prim, level).GetLabelsAttr() for level in labels.GetDirectTaxonomies(prim))
        ):
            self.add("labels that change stay as they are at the first sample", prim)
        if any(name.endswith(":semanticData") for name in _in_namespace(prim, "semantic")):
            self.add("a label of SemanticsAPI is not read, those of UsdSemantics are", prim)

    def camera(self, prim: Usd.Prim) -> None:
        """Notes what of a camera that is rendered is not followed."""
        ours = prim.HasAttribute(names.ATTR_SHUTTER_EXPOSURE)
        self._attributes(prim, "Camera", ("shutter:open", "shutter:close") if ours else ())
        words: dict[str, None] = {}
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if name.startswith("omni:rtx:"):
                self.add("a camera's settings of Omniverse's renderer are not followed", prim)
            if name == "projection" or name.startswith("scenec:") or not _LENS.search(name):
                continue
            value = values.value_of(attribute, _FIRST)
            switch = name.lower().endswith(("type", "model")) or isinstance(value, bool)
            if switch and value and str(value).lower() not in _PINHOLES:
                words[f"{name} = {value}" if isinstance(value, str) else name] = None
        schemas = [name for name in applied_schemas(prim) if _LENS.search(name)]
        for word in () if model_of(prim)[0] else words or schemas:
            self.add(
                f"{word}: a lens of another renderer is not followed, a pinhole is drawn", prim
            )

    def shape(self, prim: Usd.Prim, material: UsdShade.Material) -> None:
        """Notes what of the shape and the colors of a drawn prim is not followed.

        Args:
            prim: A mesh, or an implicit shape.
            material: What is bound to it; may be invalid.
        """
        mesh = UsdGeom.Mesh(prim)
        api = UsdGeom.PrimvarsAPI(prim)
        curves = UsdGeom.BasisCurves(prim)
        self._attributes(prim, "Mesh" if mesh else "BasisCurves" if curves else kind_of(prim))
        if mesh:
            if values.word(mesh.GetSubdivisionSchemeAttr(), "") in _SUBDIVIDED:
                self._cage(mesh)
        elif is_skinned(prim) and not curves:
            self.add("a skinned shape that is no mesh stands in its rest pose", prim)
        lengths = ("axis", *LENGTHS.get(kind_of(prim), ("widths", "curveVertexCounts")))
        if self._changes(*(prim.GetAttribute(name) for name in (*_DEFORMING, *lengths))):
            self.add("a shape that deforms stands still, as it is at the first sample", prim)
        primvars = api.GetPrimvarsWithAuthoredValues()
        if self._changes(*(primvar.GetAttr() for primvar in primvars)):
            self.add("primvars that change stay as they are at the first sample", prim)
        if not material and _shows_display_color(prim):
            if kind_of(prim) and not all_equal(api.FindPrimvarWithInheritance("displayColor")):
                self.add("displayColor that varies over a shape is shown as its mean", prim)
            opacity = api.FindPrimvarWithInheritance("displayOpacity")
            if opacity and opacity.HasValue():
                found = values.array(opacity.GetAttr(), np.float64, _FIRST)
                if found.min(initial=1.0) < 1.0:
                    self.add(FADED, prim)

    def _cage(self, mesh: UsdGeom.Mesh) -> None:
        prim = mesh.GetPrim()
        if not mesh.GetSubdivisionSchemeAttr().HasAuthoredValue():
            has_normals = UsdGeom.PrimvarsAPI(prim).HasPrimvar("normals")
            if has_normals or mesh.GetNormalsAttr().HasAuthoredValue():
                self.add(
                    "normals of a mesh without a subdivisionScheme give way to those of "
                    "USD's default, a Catmull-Clark surface",
                    prim,
                )
        if prim.HasRelationship(names.REL_LAYERS) or prim.HasAttribute(
            f"primvars:{names.PRIMVAR_VARIATION}"
        ):
            self.add("a subdivision surface with scenec's primvars is shown as its cage", prim)

    def material(self, material: UsdShade.Material) -> None:
        """Notes what of a bound material is not followed; of ours nothing is lost."""
        prim = material.GetPrim()
        if not prim or str(prim.GetPath()) in self._materials:
            return
        self._materials.add(str(prim.GetPath()))
        if prim.GetAttribute(names.ATTR_BASE_COLOR).HasValue():
            return
        for line in (prim.GetCustomDataByKey(names.LOSSES) or "").splitlines():
            self.add(line, prim)
        shader, _, _ = material.ComputeSurfaceSource()
        if shader and values.word(shader.GetIdAttr(), "") == "UsdPreviewSurface":
            self._preview_surface(prim, shader)
        elif shader:
            told = values.word(shader.GetIdAttr(), "") or "a shader of its own"
            self.add(f"the surface {told} is not read, displayColor is shown", prim)
        elif mdl := mdl_shader(material):
            self.add(f"the MDL material {mdl[1]} is not read, displayColor is shown", prim)
        elif any(output.HasConnectedSource() for output in material.GetSurfaceOutputs()):
            self.add("a surface for other renderers is not read, displayColor is shown", prim)
        for kind, outputs, (source, _, _) in (
            (
                "displacement",
                material.GetDisplacementOutputs(),
                material.ComputeDisplacementSource(),
            ),
            ("volume", material.GetVolumeOutputs(), material.ComputeVolumeSource()),
        ):
            connected = any(output.HasConnectedSource() for output in outputs)
            # A preview surface has its displacement among its inputs.
            if connected and not (
                source and values.word(source.GetIdAttr(), "") == "UsdPreviewSurface"
            ):
                self.add(f"the {kind} of a material is not read", prim)

    def _light(self, prim: Usd.Prim, kind: str, in_prototype: bool) -> None:
        if kind not in LIGHTS:
            self.add("a shape that is a light gives no light", prim)
            return
        if in_prototype:
            self.add("a light in the prototype of an instancer is not read", prim)
        self._attributes(prim, kind)
        light = UsdLux.LightAPI(prim)
        if (
            min(
                values.number(light.GetIntensityAttr(), 1.0, _FIRST),
                *(values.vector(light.GetColorAttr(), 3, _FIRST) or (1.0,)),
            )
            < 0.0
        ):
            self.add("a light of negative strength gives none", prim)
        place = values.matrices(prim, [_FIRST], of_world=True)
        if kind == "SphereLight" and (stretched(place).any() or sheared(place).any()):
            self.add("a sphere light that is stretched shines as a sphere of its volume", prim)
        if kind != "SphereLight" and flat(place).any():
            self.add("a light whose transform has no inverse gives none", prim)
        textured = values.value_of(prim.GetAttribute("inputs:texture:file"), _FIRST)
        if textured and (stretched(place).any() or sheared(place).any()):
            self.add("a picture of the sky that is stretched is shown as it is without that", prim)
        for relationship in prim.GetAuthoredRelationships():
            name = relationship.GetName()
            followed = not name.startswith(("light:", "portals", "collection:"))
            followed |= name == _FILTERS and gobo_of(prim) is not None
            if not followed and relationship.HasAuthoredTargets():
                self.add(f"{name} of {kind} is not followed", prim)

    def _attributes(self, prim: Usd.Prim, kind: str, followed: Collection[str] = ()) -> None:
        """Notes each attribute of a prim's schemas that is not as it is without being authored.

        Args:
            prim: The prim.
            kind: Type that it is of, or derives from.
            followed: Attributes that are followed of this prim.
        """
        definition = prim.GetPrimDefinition()
        # Applied schemas have lines of their own, but those of lights.
        own = Usd.SchemaRegistry().FindConcretePrimDefinition(kind)
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if not (name.startswith("inputs:") or own.GetSpecType(name) != _UNKNOWN):
                continue
            if attribute.HasAuthoredConnections():
                self.add(f"{name} of {prim.GetTypeName()} from a node is not read", prim)
            if name in followed or is_followed(kind, name):
                continue
            value = values.value_of(attribute, _FIRST)
            neutral = value is None or value == definition.GetAttributeFallbackValue(name)
            if (name, value) in NEUTRAL:
                neutral = True
            if not neutral or attribute.ValueMightBeTimeVarying():
                self.add(f"{name} of {prim.GetTypeName()} is not followed", prim)

    def _preview_surface(self, prim: Usd.Prim, shader: UsdShade.Shader) -> None:
        specular = values.value_of(constant(shader, "useSpecularWorkflow"), _FIRST) == 1
        maps = texture_maps(shader, specular, self._sources)
        for found in shader.GetInputs():
            name = found.GetBaseName()
            if name in _ASIDE or name == ("metallic" if specular else "specularColor"):
                continue
            node, _ = connected(shader, name)
            if node is None:
                value = values.value_of(constant(shader, name), _FIRST)
                if name == "opacity" and value != 1.0 and not opacity_threshold(shader)[1]:
                    self.add(BLENDED, prim)
                if name in _WITHOUT_EFFECT and value not in (None, _WITHOUT_EFFECT[name]):
                    self.add(f"{name} of UsdPreviewSurface is not followed", prim)
                if self._changes(*found.GetValueProducingAttributes()):
                    self.add("inputs of a material that change stay as they are first", prim)
                continue
            if maps is not None and getattr(maps, _TEXTURED.get(name, ""), None) is not None:
                modes = {values.word(constant(node, w), "", _FIRST) for w in ("wrapS", "wrapT")}
                if name == "opacity":
                    if not opacity_threshold(shader)[1]:
                        self.add(BLENDED, prim)
                elif modes & {"black", "clamp", "mirror"}:
                    self.add("wrap modes of textures are not followed, they repeat", prim)
                if name == "normal" and not _is_usual(node):
                    self.add("scale and bias of a texture of normals are not followed", prim)
            elif values.word(constant(node, "varname"), "", _FIRST) == _DISPLAYED.get(name):
                if name == "opacity" and not opacity_threshold(shader)[1]:
                    self.add(FADED, prim)
            else:
                source = values.word(node.GetIdAttr(), "") or "a node"
                self.add(f"{name} of UsdPreviewSurface from {source} is not read", prim)

    def _changes(self, *attributes: Usd.Attribute) -> bool:
        return self._moving and any(a and a.ValueMightBeTimeVarying() for a in attributes)


def _is_usual(texture: UsdShade.Shader) -> bool:
    """Tells whether a texture of normals says 2 * value - 1, y either way, or nothing."""
    scale, bias = (
        values.vector(constant(texture, name), 3, _FIRST, of_more=True)
        for name in ("scale", "bias")
    )
    usual = ((2.0, 2.0, 2.0), (-1.0, -1.0, -1.0)), ((2.0, -2.0, 2.0), (-1.0, 1.0, -1.0))
    return (scale, bias) in (*usual, (None, None))


def _in_namespace(prim: Usd.Prim, namespace: str) -> list[str]:
    return [found.GetName() for found in prim.GetAuthoredPropertiesInNamespace(namespace)]


def _shows_display_color(prim: Usd.Prim) -> bool:
    """Whether a prim without a bound material has faces that have none otherwise."""
    layers = prim.GetRelationship(names.REL_LAYERS)
    if layers and layers.HasAuthoredTargets():
        return False
    if not UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        return True
    family = UsdShade.Tokens.materialBind
    return bool(UsdGeom.Subset.GetUnassignedIndices(UsdGeom.Mesh(prim), "face", family))


def all_equal(primvar: UsdGeom.Primvar) -> bool:
    """Whether a primvar of colors, which may be invalid, has no two that differ."""
    if not primvar or not primvar.HasValue() or primvar.GetInterpolation() == _CONSTANT:
        return True
    colors = values.array(primvar.GetAttr(), np.float64, _FIRST, width=(3,))
    return bool((colors == colors[:1]).all())
