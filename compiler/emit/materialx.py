"""Writes MaterialX networks of the looks, in layers of their own, for viewers that know MaterialX.

They are derived from the numbers that backends read and say the same: the shared surface model
(1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c) in nodes of MaterialX's physically based
library, which every generator of MaterialX shaders knows (Storm's, and so usdview's, among them);
its standard surface would put a Fresnel term of its own on the glossy part. The diffuse node is
Lambert's law at roughness 0, the Schlick node with equal colors at 0 and 90 degrees a GGX lobe
without Fresnel. What is left between the two is the energy that MaterialX gives back to rough lobes
for light that bounces between facets.

Materials of a mixed ground all show the same network, the mix of all layers by the weights on the
vertices, whichever label a face has. It stands once, as a class that they inherit.
"""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from scenec.compiler.cache.memo import memoized_file
from scenec.compiler.emit.layer import TYPES, new_layer
from scenec.compiler.emit.looks import LOOKS, look_path
from scenec.compiler.emit.preview import is_encoded
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.material import Material
from scenec.schemas import materialx as mtlx
from scenec.schemas import stage as names

#: Class that the ground's materials inherit; no child of LOOKS, where the cfg gives the names.
GROUND_MIX = f"{names.ROOT}/GroundMix"
_X_AXIS = Gf.Vec3f(1.0, 0.0, 0.0)
#: The axes across which pictures are laid from three sides, and the world's axes that are u and v
#: there, as ``scenec.backends.surface.maps`` has them.
_PLANES = (("x", 1, 2), ("y", 0, 2), ("z", 0, 1))

type Value = UsdShade.Output | Gf.Vec2f | Gf.Vec3f | Sdf.AssetPath | float | int | str


def mixed_materials(ground: Ground) -> tuple[str, ...]:
    """Materials of the ground's layers, base first; none where there is nothing to mix."""
    layers = tuple(layer.material for layer in ground.layers)
    return layers if len(layers) > 1 else ()


@memoized_file("emit")
def write_material(path: Path, name: str, material: Material, maps: dict[str, str]) -> None:
    """Writes ``looks/<material>.mtlx.usda``: the network of one material."""
    with new_layer(path) as stage:
        UsdGeom.Scope.Define(stage, LOOKS)
        network = _Network(stage, UsdShade.Material.Define(stage, look_path(name)))
        files = {kind: f"../{file}" for kind, file in maps.items()}
        layer = _Layer(network, "", material, files)
        network.end(layer.bsdf(), **layer.mask())


@memoized_file("emit")
def write_ground_mix(
    path: Path,
    layers: tuple[str, ...],
    materials: dict[str, Material],
    maps: dict[str, dict[str, str]],
) -> None:
    """Writes ``terrain.mtlx.usda``: the mix of the ground's layers, for all its materials.

    Args:
        layers: Materials from the base up, two or more.
        maps: Of each material, its maps by kind, relative to the batch's folder.
    """
    with new_layer(path) as stage:
        mix = UsdShade.Material.Define(stage, GROUND_MIX)
        stage.GetRootLayer().GetPrimAtPath(GROUND_MIX).specifier = Sdf.SpecifierClass
        network = _Network(stage, mix)
        mixed: UsdShade.Output | None = None
        for i, name in enumerate(layers):
            files = {kind: f"./{file}" for kind, file in maps[name].items()}
            layer = _Layer(network, f"layer{i}_", materials[name], files).bsdf()
            if mixed is None:
                mixed = layer
            else:
                mixed = network.mix(f"merge{i}", mixed, layer, network.weight(i))
        network.end(mixed)
        for name in dict.fromkeys(layers):
            stage.OverridePrim(look_path(name)).GetInherits().AddInherit(GROUND_MIX)
            # Where there are no weights, on a rock or a viewer's ball, a material shows itself.
            own = max(i for i, layer in enumerate(layers) if layer == name)
            if own > 0:
                weight = stage.OverridePrim(f"{look_path(name)}/{_weight_node(own)}")
                UsdShade.Shader(weight).CreateInput("default", TYPES.Float).Set(1.0)


def _weight_node(merge: int) -> str:
    return f"weight{merge}"


class _Network:
    """Nodes under a Material, each written when it is first asked for."""

    def __init__(self, stage: Usd.Stage, material: UsdShade.Material) -> None:
        self._stage = stage
        self._material = material
        self._made: dict[str, UsdShade.Output] = {}

    def node(self, name: str, node_id: str, **inputs: Value) -> UsdShade.Output:
        """The output of a node; of that which has the name already, if there is one.

        Args:
            node_id: Key of ``schemas.materialx.NODES``.
            inputs: Constants, or outputs to connect; ``in_`` stands for the input "in".
        """
        if name in self._made:
            return self._made[name]
        kind = mtlx.NODES[node_id]
        shader = UsdShade.Shader.Define(self._stage, self._material.GetPath().AppendChild(name))
        shader.CreateIdAttr(node_id)
        for key, value in inputs.items():
            key = key.rstrip("_")
            made = shader.CreateInput(key, TYPES.Find(kind.inputs[key]))
            if isinstance(value, UsdShade.Output):
                made.ConnectToSource(value)
            else:
                made.Set(value)
                if kind.inputs[key] == "color3f":
                    made.GetAttr().SetColorSpace(mtlx.LINEAR)
        output = shader.CreateOutput(mtlx.OUTPUT, TYPES.Find(kind.output))
        self._made[name] = output
        return output

    def mix(
        self, name: str, below: UsdShade.Output | None, above: UsdShade.Output, amount: Value
    ) -> UsdShade.Output:
        """(1 - amount) * below + amount * above; ``above`` alone on nothing."""
        if below is None:
            return above
        return self.node(name, "ND_mix_bsdf", bg=below, fg=above, mix=amount)

    def weight(self, merge: int) -> UsdShade.Output:
        return self.node(
            _weight_node(merge), "ND_geompropvalue_float", geomprop=names.weight_primvar(merge)
        )

    def end(self, bsdf: UsdShade.Output, **opacity: Value) -> None:
        """Makes a BSDF the material's surface for MaterialX, cut out where its opacity is 0."""
        surface = self.node("MaterialX", "ND_surface", bsdf=bsdf, **opacity)
        self._material.CreateSurfaceOutput(mtlx.CONTEXT).ConnectToSource(surface)
        # UsdMtlx's schema, which usd-core lacks. Without it the nodes pass for version 1.38.
        prim = self._material.GetPrim()
        prim.AddAppliedSchema("MaterialXConfigAPI")
        prim.CreateAttribute("config:mtlx:version", TYPES.String, custom=False).Set(mtlx.VERSION)


class _Layer:
    """One material's part of a network; the names of its own nodes begin with a prefix."""

    def __init__(
        self, network: _Network, prefix: str, material: Material, files: dict[str, str]
    ) -> None:
        self._network = network
        self._prefix = prefix
        self._material = material
        self._files = files

    def bsdf(self) -> UsdShade.Output:
        """The whole surface, lobes that have no part in it left out."""
        material, mix = self._material, self._network.mix
        mapped = "metallic" in self._files
        metallic = self._picture("metallic", "ND_image_float") if mapped else material.metallic
        color = self._color()
        normal = {"normal": self._normal()} if "normal" in self._files else {}
        surface: UsdShade.Output | None = None
        if mapped or material.metallic < 1.0:
            surface = self._dielectric(color, normal)
        if mapped or material.metallic > 0.0:
            metal = self._ggx("metal", color, normal)
            surface = mix(f"{self._prefix}metallic", surface, metal, metallic)
        return surface

    def mask(self) -> dict[str, Value]:
        """The surface's opacity, 1 or 0, where a picture cuts it out."""
        cutout = None if self._material.maps is None else self._material.maps.cutout
        if cutout is None or "opacity" not in self._files:
            return {}
        modes = [{"repeat": "periodic"}.get(wrap, wrap) for wrap in cutout.wrap]
        place = self._network.node("st", "ND_geompropvalue_vector2", geomprop=names.PRIMVAR_UV)
        alpha = self._node(
            "opacity_map", "ND_image_float", file=Sdf.AssetPath(self._files["opacity"]),
            texcoord=place, uaddressmode=modes[0], vaddressmode=modes[1],
        )  # fmt: skip
        kept = self._node(
            "opacity", "ND_ifgreatereq_float",
            value1=alpha, value2=cutout.threshold, in1=1.0, in2=0.0,
        )  # fmt: skip
        return {"opacity": kept}

    def _node(self, name: str, node_id: str, **inputs: Value) -> UsdShade.Output:
        return self._network.node(f"{self._prefix}{name}", node_id, **inputs)

    def _dielectric(self, color: Value, normal: dict[str, Value]) -> UsdShade.Output:
        """(1-s) * Lambert(color), a share of it on the far side, + s * GGX(white).

        The share is the color of the lobe, not its weight: MaterialX then gives back energy in
        proportion to the square of s, next to nothing, where a white lobe's would be far off.
        """
        specular = self._material.specular
        weight = {"weight": 1.0 - specular} if specular > 0.0 else {}
        diffuse = self._node(
            "diffuse", "ND_oren_nayar_diffuse_bsdf", color=color, **weight, **normal
        )
        through = self._material.diffuse_transmission
        if through > 0.0:
            passed = self._node("through", "ND_translucent_bsdf", color=color, **weight, **normal)
            diffuse = self._network.mix(f"{self._prefix}sheet", diffuse, passed, through)
        if specular == 0.0:
            return diffuse
        gloss = self._ggx("gloss", Gf.Vec3f(specular), normal)
        return self._node("glossy", "ND_add_bsdf", in1=diffuse, in2=gloss)

    def _ggx(self, name: str, color: Value, normal: dict[str, Value]) -> UsdShade.Output:
        roughness = self._roughness()
        alpha: Value
        if isinstance(roughness, UsdShade.Output):
            alpha = self._node("alpha", "ND_roughness_anisotropy", roughness=roughness)
        else:
            alpha = Gf.Vec2f(roughness * roughness)
        return self._node(
            name,
            "ND_generalized_schlick_bsdf",
            color0=color,
            color90=color,
            roughness=alpha,
            **normal,
        )

    def _roughness(self) -> UsdShade.Output | float:
        """Number or map * (1 + roughness_variation * v), clipped if it can pass 1."""
        material = self._material
        roughness: UsdShade.Output | float = material.roughness
        mapped = "roughness" in self._files
        if mapped:
            roughness = self._picture("roughness", "ND_image_float")
        amount = material.roughness_variation
        if amount == 0.0:
            return roughness
        part = self._node("rough_part", "ND_multiply_float", in1=self._variation(), in2=amount)
        factor = self._node("rough_factor", "ND_add_float", in1=part, in2=1.0)
        varied = self._node("rough_varied", "ND_multiply_float", in1=factor, in2=roughness)
        if mapped or material.roughness * (1.0 + abs(amount)) > 1.0:
            varied = self._node("rough_clipped", "ND_clamp_float", in_=varied)
        return varied

    def _variation(self) -> UsdShade.Output:
        """v, on the vertices."""
        return self._network.node(
            "variation", "ND_geompropvalue_float", geomprop=names.PRIMVAR_VARIATION
        )

    def _color(self) -> Value:
        """base_color * map * (1 + variation * v), clipped to [0, 1] if it can leave that."""
        material, file = self._material, self._files.get("base_color")
        color: Value = Gf.Vec3f(*material.base_color)
        if file is not None:
            picture = self._picture("base_color", "ND_image_color3")
            if material.base_color != (1.0, 1.0, 1.0):
                picture = self._node("tinted", "ND_multiply_color3", in1=picture, in2=color)
            color = picture
        if material.variation > 0.0:
            part = self._node(
                "part", "ND_multiply_float", in1=self._variation(), in2=material.variation
            )
            factor = self._node("factor", "ND_add_float", in1=part, in2=1.0)
            color = self._node("varied", "ND_multiply_color3FA", in1=color, in2=factor)
        floating = file is not None and not is_encoded("base_color", file)
        if floating or max(material.base_color) * (1.0 + material.variation) > 1.0:
            color = self._node("clipped", "ND_clamp_color3", in_=color)
        return color

    def _picture(self, kind: str, node_id: str) -> UsdShade.Output:
        """A map's value, by the material's projection."""
        assert self._material.maps is not None
        projection = self._material.maps.projection
        if projection == "uv":
            place = self._network.node("st", "ND_geompropvalue_vector2", geomprop=names.PRIMVAR_UV)
            return self._image(kind, node_id, "", place)
        if projection == "above":
            return self._image(kind, node_id, "", self._place("xy", 0, 1))
        kind_of = node_id.removeprefix("ND_image_")
        times = "ND_multiply_float" if kind_of == "float" else f"ND_multiply_{kind_of}FA"
        total: UsdShade.Output | None = None
        for index, (axis, u, v) in enumerate(_PLANES):
            image = self._image(kind, node_id, f"_{axis}", self._place(axis, u, v))
            part = self._node(f"{kind}_part_{axis}", times, in1=image, in2=self._share(index))
            total = self._sum(f"{kind}_sum_{axis}", f"ND_add_{kind_of}", total, part)
        assert total is not None
        return total

    def _sum(
        self, name: str, node_id: str, total: UsdShade.Output | None, part: UsdShade.Output
    ) -> UsdShade.Output:
        return part if total is None else self._node(name, node_id, in1=total, in2=part)

    def _image(
        self, kind: str, node_id: str, suffix: str, place: UsdShade.Output
    ) -> UsdShade.Output:
        file = self._files[kind]
        output = self._node(
            f"{kind}_map{suffix}", node_id, file=Sdf.AssetPath(file), texcoord=place
        )
        if kind == "base_color":
            attribute = UsdShade.Shader(output.GetPrim()).GetInput("file").GetAttr()
            attribute.SetColorSpace(mtlx.SRGB if is_encoded(kind, file) else mtlx.LINEAR)
        return output

    def _place(self, name: str, u: int, v: int) -> UsdShade.Output:
        """Two axes of the world / size."""
        assert self._material.maps is not None
        node = self._network.node
        position = node("position", "ND_position_vector3", space="world")
        size = self._material.maps.size_m
        if name == "xy":
            flat = node("xy", "ND_convert_vector3_vector2", in_=position)
            return self._node("uv", "ND_divide_vector2FA", in1=flat, in2=size)
        parts = [node(f"position_{a}", "ND_extract_vector3", in_=position, index=a) for a in (u, v)]
        flat = node(f"across_{name}", "ND_combine2_vector2", in1=parts[0], in2=parts[1])
        return self._node(f"uv_{name}", "ND_divide_vector2FA", in1=flat, in2=size)

    def _share(self, axis: int) -> UsdShade.Output:
        """Weight of the plane across an axis: the normal's fourth powers over their sum."""
        node = self._network.node
        normal = node("normal", "ND_normal_vector3", space="world")
        squares = node("normal_2", "ND_multiply_vector3", in1=normal, in2=normal)
        fourth = node("normal_4", "ND_multiply_vector3", in1=squares, in2=squares)
        total = node("normal_4_sum", "ND_dotproduct_vector3", in1=fourth, in2=Gf.Vec3f(1.0))
        shares = node("shares", "ND_divide_vector3FA", in1=fourth, in2=total)
        return node(f"share_{axis}", "ND_extract_vector3", in_=shares, index=axis)

    def _normal(self) -> UsdShade.Output:
        """Normal of the map, in the world."""
        assert self._material.maps is not None
        flip = self._material.maps.normal_convention == "directx"
        if self._material.maps.projection == "triplanar":
            return self._triplanar_normal(-1.0 if flip else 1.0)
        frame: dict[str, Value] = {"scale": Gf.Vec2f(1.0, -1.0)} if flip else {}
        if self._material.maps.projection == "above":
            frame |= self._level_frame()
        # By texture coordinates the frame is the viewer's own.
        picture = self._picture("normal", "ND_image_vector3")
        return self._node("bumped", "ND_normalmap_vector2", in_=picture, **frame)

    def _level_frame(self) -> dict[str, Value]:
        """A frame of the surface whose tangent is the world's x axis in it."""
        node = self._network.node
        up = node("normal", "ND_normal_vector3", space="world")
        along = node("normal_x", "ND_dotproduct_vector3", in1=up, in2=_X_AXIS)
        lift = node("normal_part", "ND_multiply_vector3FA", in1=up, in2=along)
        flat = node("tangent_part", "ND_subtract_vector3", in1=_X_AXIS, in2=lift)
        tangent = node("tangent", "ND_normalize_vector3", in_=flat)
        bitangent = node("bitangent", "ND_crossproduct_vector3", in1=up, in2=tangent)
        return {"normal": up, "tangent": tangent, "bitangent": bitangent}

    def _triplanar_normal(self, up: float) -> UsdShade.Output:
        """The whiteout blend of three planes (Golus 2017); ``up``: sign of the picture's y."""
        node, own = self._network.node, self._node
        normal = node("normal", "ND_normal_vector3", space="world")
        total: UsdShade.Output | None = None
        for index, (axis, u, v) in enumerate(_PLANES):
            image = self._image("normal", "ND_image_vector3", f"_{axis}", self._place(axis, u, v))
            doubled = own(
                f"lean_2_{axis}", "ND_multiply_vector3", in1=image, in2=Gf.Vec3f(2.0, 2.0 * up, 2.0)
            )
            mapped = own(
                f"lean_{axis}", "ND_subtract_vector3", in1=doubled, in2=Gf.Vec3f(1.0, up, 1.0)
            )
            x, y, z = (
                own(f"lean_{axis}_{i}", "ND_extract_vector3", in_=mapped, index=i) for i in range(3)
            )
            more: list[Value] = [0.0, 0.0, 0.0]
            more[u], more[v] = x, y
            scale: list[Value] = [1.0, 1.0, 1.0]
            scale[index] = z
            factors = own(f"lean_scale_{axis}", "ND_combine3_vector3", **_inputs(scale))
            added = own(f"lean_more_{axis}", "ND_combine3_vector3", **_inputs(more))
            scaled = own(f"lean_up_{axis}", "ND_multiply_vector3", in1=normal, in2=factors)
            whole = own(f"lean_whole_{axis}", "ND_add_vector3", in1=scaled, in2=added)
            part = own(
                f"lean_part_{axis}", "ND_multiply_vector3FA", in1=whole, in2=self._share(index)
            )
            total = self._sum(f"lean_sum_{axis}", "ND_add_vector3", total, part)
        assert total is not None
        return own("bumped", "ND_normalize_vector3", in_=total)


def _inputs(values: list[Value]) -> dict[str, Value]:
    return {f"in{i}": value for i, value in enumerate(values, start=1)}
