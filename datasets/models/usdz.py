"""USDZ: one package a batch that viewers without MaterialX show as renderers do.

The stage, flattened, with its own prims, ids, labels, cameras and times. The ground's looks are
UsdPreviewSurface with baked pictures and texture coordinates ``st``; objects keep theirs, with
their pictures where they have one. MaterialX and scenec's own description of surfaces go.
"""

from __future__ import annotations

import os
import shutil
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

from scenec.datasets.models.gltf import ModelContent
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic
from scenec.schemas.model import Look, Model, Part
from scenec.schemas.scratch import scratch_folder
from scenec.schemas.udim import UDIM, is_tiled, tiles_of

#: Looks of the ground.
_SCOPE = Sdf.Path("/World/BakedLooks")
_TEXTURES = "textures"
#: What describes surfaces to scenec's renderers alone, and to MaterialX.
_OF_MATERIALS = ("scenec:surface:", "outputs:mtlx:", "config:mtlx:")
_OF_GROUND = ("primvars:scenec_weight_", "primvars:scenec_variation", "scenec:layers")
_FAMILY = "labels"
#: The first time that archives know, in the local zone, which they have theirs in.
_FIRST_TIME = (1980, 1, 1, 0, 0, 0, 0, 0, -1)


def write_usdz(model: Model, stage: Path, path: Path) -> ModelContent:
    """Writes ``path``.

    Args:
        model: The batch, whole.
        stage: The stage that it is of.
        path: A .usdz.

    Raises:
        OutputError: It cannot be written.
    """
    with scratch_folder() as name:
        folder = Path(name)
        (folder / _TEXTURES).mkdir()
        layer = Usd.Stage.Open(str(stage)).Flatten(addSourceFileComment=False)
        losses = _Looks(Usd.Stage.Open(layer), model, folder).replace()
        _take_pictures(layer, folder)
        root = folder / "stage.usdc"
        layer.Export(str(root))
        made = folder / "package.usdz"
        # Archives have the times of files: the same, for the same bytes each time.
        for file in (root, *(folder / _TEXTURES).iterdir()):
            os.utime(file, times=(time.mktime(_FIRST_TIME),) * 2)
        if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(root)), str(made)):
            raise OutputError(f"{path}: OpenUSD could not make the package")
        with atomic(path) as temporary:
            shutil.copyfile(made, temporary)
    # Of what glTF and the page leave out, a stage keeps light, lenses and motion.
    kept = ("light:", "motion:", "cameras:")
    own = [line for line in model.losses if not line.startswith(kept)]
    return ModelContent(model.triangles, model.instances, (*own, *losses))


class _Looks:
    """The looks of a flattened stage, being replaced."""

    def __init__(self, stage: Usd.Stage, model: Model, folder: Path) -> None:
        self._stage, self._model, self._folder = stage, model, folder
        self._losses = [
            "looks: MaterialX and scenec's own surfaces are replaced by UsdPreviewSurface"
        ]
        if any(look.diffuse_transmission > 0.0 for look in model.looks):
            self._losses.append("looks: no light passes through sheets such as leaves")

    def replace(self) -> list[str]:
        """Does it; returns a line for each thing that is lost."""
        by_path: dict[str, list[Part]] = defaultdict(list)
        for part in self._model.parts:
            by_path[part.path].append(part)
        ground = {
            self._model.parts[i].path
            for p in self._model.placements
            if not p.owner
            for i in p.parts
        }
        pictured: dict[int, bool] = {}
        for path, parts in by_path.items():
            prim = self._stage.GetPrimAtPath(path)
            for part in parts:
                whole = len(parts) == 1 and bool(prim) and _same_faces(prim, part)
                if path in ground and whole:
                    self._bake(prim, part)
                    continue
                if path in ground:
                    self._losses.append(f"{path}: is no plain mesh; its looks stay unbaked")
                if part.uv is not None:
                    if whole and not prim.HasAttribute("primvars:st"):
                        _author_corners(prim, part.uv)
                    pictured[part.look] = whole and pictured.get(part.look, True)
        names = {look.name: i for i, look in enumerate(self._model.looks)}
        materials = [p for p in self._stage.TraverseAll() if p.IsA(UsdShade.Material)]
        for prim in materials:
            if prim.GetPath().HasPrefix(_SCOPE):
                continue
            number = names.get(prim.GetName(), -1)
            self._strip(prim)
            if _has_picture(prim):
                # Of an object with texture coordinates of its own.
                continue
            if pictured.get(number):
                self._texture(prim, self._model.looks[number])
            elif number in pictured:
                self._losses.append(f"{prim.GetPath()}: its picture counts by its mean color")
        # What else holds MaterialX is shared by reference; flattened, it is of no use.
        rest = [p for p in self._stage.TraverseAll() if _of_materialx(p)]
        for path in sorted({p.GetParent().GetPath() for p in rest}):
            self._stage.RemovePrim(path)
        return self._losses

    def _bake(self, prim: Usd.Prim, part: Part) -> None:
        look = self._model.looks[part.look]
        assert part.uv is not None
        assert isinstance(look.picture, np.ndarray)
        uv = np.zeros((len(part.points), 2), np.float32)
        uv[part.faces] = part.uv
        coordinates = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
        )
        coordinates.Set(Vt.Vec2fArray.FromNumpy(uv))
        name = f"{_TEXTURES}/{look.name}.png"
        Image.fromarray(look.picture).save(self._folder / name)
        if not self._stage.GetPrimAtPath(_SCOPE):
            UsdGeom.Scope.Define(self._stage, _SCOPE)
        material = UsdShade.Material.Define(self._stage, _SCOPE.AppendChild(look.name))
        surface = UsdShade.Shader.Define(self._stage, material.GetPath().AppendChild("Surface"))
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(look.roughness)
        surface.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
        surface.CreateInput("specularColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0.0))
        material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
        self._connect(surface, str(self._folder / name), (1.0, 1.0, 1.0), "clamp")
        for child in prim.GetChildren():
            if child.IsA(UsdGeom.Subset):
                _as_labels(child)
        for name in prim.GetPropertyNames():
            if name.startswith((*_OF_GROUND, "subsetFamily:materialBind:")):
                prim.RemoveProperty(name)
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)

    def _strip(self, prim: Usd.Prim) -> None:
        for child in prim.GetChildren():
            if _of_materialx(child):
                self._stage.RemovePrim(child.GetPath())
        for name in prim.GetPropertyNames():
            if name.startswith(_OF_MATERIALS):
                prim.RemoveProperty(name)

    def _texture(self, prim: Usd.Prim, look: Look) -> None:
        surface = UsdShade.Material(prim).ComputeSurfaceSource()[0]
        if not surface or not isinstance(look.picture, Path):
            return
        self._connect(surface, str(look.picture), look.base_color, "repeat")
        reader = self._stage.GetPrimAtPath(prim.GetPath().AppendChild("Color"))
        if reader:
            self._stage.RemovePrim(reader.GetPath())

    def _connect(
        self, surface: UsdShade.Shader, file: str, scale: tuple[float, float, float], wrap: str
    ) -> None:
        """Colors of a surface out of a picture by ``st``."""
        parent = surface.GetPath().GetParentPath()
        reader = UsdShade.Shader.Define(self._stage, parent.AppendChild("St"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        texture = UsdShade.Shader.Define(self._stage, parent.AppendChild("Texture"))
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
        texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*scale, 1.0))
        for axis in ("wrapS", "wrapT"):
            texture.CreateInput(axis, Sdf.ValueTypeNames.Token).Set(wrap)
        result = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(result)
        color = texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
        diffuse.ClearSources()
        diffuse.ConnectToSource(color)


def _has_picture(material: Usd.Prim) -> bool:
    shaders = map(UsdShade.Shader, material.GetChildren())
    return any(bool(s) and s.GetIdAttr().Get() == "UsdUVTexture" for s in shaders)


def _of_materialx(prim: Usd.Prim) -> bool:
    shader = UsdShade.Shader(prim)
    return bool(shader) and str(shader.GetIdAttr().Get() or "").startswith("ND_")


def _same_faces(prim: Usd.Prim, part: Part) -> bool:
    """Whether a mesh is a part's triangles, one for one."""
    mesh = UsdGeom.Mesh(prim)
    if not mesh:
        return False
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get() or [])
    indices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get() or [])
    return bool((counts == 3).all()) and np.array_equal(indices, part.faces.ravel())


def _author_corners(prim: Usd.Prim, uv: NDArray[np.float32]) -> None:
    coordinates = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    coordinates.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(uv.reshape(-1, 2))))


def _as_labels(prim: Usd.Prim) -> None:
    """A subset of faces that says what they are, and no more what they look like."""
    subset = UsdGeom.Subset(prim)
    subset.GetFamilyNameAttr().Set(_FAMILY)
    prim.RemoveProperty("material:binding")
    prim.RemoveAPI(UsdShade.MaterialBindingAPI)


def _take_pictures(layer: Sdf.Layer, folder: Path) -> None:
    """Copies all files that the layer names beside it, and names the copies."""
    names: dict[str, str] = {}

    def of(name: str) -> str:
        file = Path(layer.ComputeAbsolutePath(name))
        sources = tiles_of(file).values() if is_tiled(file) else [file] if file.is_file() else []
        if not sources:
            return name
        if file.parent == folder / _TEXTURES:
            return f"./{_TEXTURES}/{file.name}"
        if str(file) not in names:
            # Of each tile, the number in its name.
            tiles = [one.name.removeprefix(file.name.partition(UDIM)[0])[:4] for one in sources]
            own, number = file.name, 0
            while any((folder / _TEXTURES / own.replace(UDIM, tile)).exists() for tile in tiles):
                number += 1
                own = f"{file.stem}_{number}{file.suffix}"
            for source, tile in zip(sources, tiles, strict=True):
                shutil.copyfile(source, folder / _TEXTURES / own.replace(UDIM, tile))
            names[str(file)] = f"./{_TEXTURES}/{own}"
        return names[str(file)]

    UsdUtils.ModifyAssetPaths(layer, of)
