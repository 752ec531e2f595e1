"""MaterialX networks of the looks, in layers of their own, for viewers that know MaterialX.

They are derived from the numbers that backends read and say the same: the shared surface model
(1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c) in nodes of MaterialX's physically based
library, which every generator of MaterialX shaders knows (Storm's, and so usdview's, among them):
its standard surface would have put a Fresnel term of its own on the glossy part. The diffuse node
is Lambert's law at roughness 0; the Schlick node with equal colors at 0 and 90 degrees is a GGX
lobe without Fresnel. What is left between the two is the energy that MaterialX gives back to rough
lobes for light that bounces between facets.

Materials of a mixed ground all show the same network, the mix of all layers by the weights on the
vertices, whichever label a face has. It stands once, as a class that they inherit.
"""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from scenec.compiler.emit.layer import new_layer
from scenec.compiler.emit.looks import LOOKS, look_path, map_asset
from scenec.compiler.scene import Ground, Material
from scenec.schemas import materialx as mtlx
from scenec.schemas import stage as names

#: Class that the ground's materials inherit; no child of LOOKS, where the cfg gives the names.
GROUND_MIX = f"{names.ROOT}/GroundMix"

Value = UsdShade.Output | Gf.Vec2f | Gf.Vec3f | Sdf.AssetPath | float | str


def mixed_materials(ground: Ground) -> tuple[str, ...]:
    """Names of the ground's layers, base first, where there is something to mix."""
    layers = tuple(layer.material for layer in ground.layers)
    return layers if len(layers) > 1 else ()


def write_material(path: Path, name: str, material: Material, maps: dict[str, str]) -> None:
    """Writes ``looks/<material>.mtlx.usda``: the network of one material.

    Args:
        path: The layer, in a folder of the batch's folder.
        name: Of the material.
        material: What to write.
        maps: Its maps by kind, relative to the batch's folder.
    """
    with new_layer(path) as stage:
        UsdGeom.Scope.Define(stage, LOOKS)
        network = _Network(stage, stage.OverridePrim(look_path(name)))
        network.end(_layer(network, "", material, {k: f"../{v}" for k, v in maps.items()}))


def write_ground(
    path: Path,
    layers: tuple[str, ...],
    materials: dict[str, Material],
    maps: dict[str, dict[str, str]],
) -> None:
    """Writes ``terrain.mtlx.usda``: the mix of the ground's layers, for all its materials.

    Args:
        path: The layer, in the batch's folder.
        layers: Materials from the base up, two or more.
        materials: By name.
        maps: By name of the material, its maps by kind, relative to the batch's folder.
    """
    with new_layer(path) as stage:
        UsdGeom.Scope.Define(stage, LOOKS)
        mix = UsdShade.Material.Define(stage, GROUND_MIX).GetPrim()
        stage.GetRootLayer().GetPrimAtPath(GROUND_MIX).specifier = Sdf.SpecifierClass
        network = _Network(stage, mix)
        mixed = None
        for i, name in enumerate(layers):
            layer = _layer(
                network, f"layer{i}_", materials[name], {k: f"./{v}" for k, v in maps[name].items()}
            )
            if mixed is None:
                mixed = layer
                continue
            weight = network.node(
                f"weight{i}", "ND_geompropvalue_float", {"geomprop": names.weight_primvar(i)}
            )
            mixed = network.mix(f"merge{i}", mixed, layer, weight)
        network.end(mixed)
        for name in dict.fromkeys(layers):
            look = stage.OverridePrim(look_path(name))
            look.GetInherits().AddInherit(GROUND_MIX)
            # Where nothing is mixed, on a rock or a viewer's ball, a material shows itself.
            own = max(i for i, layer in enumerate(layers) if layer == name)
            if own > 0:
                weight = UsdShade.Shader(stage.OverridePrim(f"{look_path(name)}/weight{own}"))
                weight.CreateInput("default", Sdf.ValueTypeNames.Float).Set(1.0)


class _Network:
    """Nodes under a Material, each written when first asked for."""

    def __init__(self, stage: Usd.Stage, prim: Usd.Prim) -> None:
        self._stage = stage
        self._prim = prim
        self._made: dict[str, UsdShade.Output] = {}

    def node(self, name: str, node_id: str, inputs: dict[str, Value]) -> UsdShade.Output:
        """The output of a node; the one of that name if there is one."""
        if name in self._made:
            return self._made[name]
        kind = mtlx.NODES[node_id]
        shader = UsdShade.Shader.Define(self._stage, self._prim.GetPath().AppendChild(name))
        shader.CreateIdAttr(node_id)
        for key, value in inputs.items():
            made = shader.CreateInput(key, Sdf.ValueTypeNames.Find(kind.inputs[key]))
            if isinstance(value, UsdShade.Output):
                made.ConnectToSource(value)
            else:
                made.Set(value)
        self._made[name] = shader.CreateOutput(mtlx.OUTPUT, Sdf.ValueTypeNames.Find(kind.output))
        return self._made[name]

    def mix(
        self, name: str, below: UsdShade.Output, above: UsdShade.Output, amount: Value
    ) -> UsdShade.Output:
        """(1 - amount) * below + amount * above."""
        return self.node(name, "ND_mix_bsdf", {"bg": below, "fg": above, "mix": amount})

    def end(self, bsdf: UsdShade.Output) -> None:
        """The surface, as the material's output for MaterialX."""
        surface = self.node("MaterialX", "ND_surface", {"bsdf": bsdf})
        UsdShade.Material(self._prim).CreateSurfaceOutput(mtlx.CONTEXT).ConnectToSource(surface)
        # The schema is UsdMtlx's, which usd-core lacks: its name and its one attribute are enough.
        self._prim.AddAppliedSchema("MaterialXConfigAPI")
        self._prim.CreateAttribute(
            "config:mtlx:version", Sdf.ValueTypeNames.String, custom=False
        ).Set(mtlx.VERSION)


def _layer(
    network: _Network, prefix: str, material: Material, maps: dict[str, str]
) -> UsdShade.Output:
    """BSDF of one material; names of its nodes begin with ``prefix``."""
    shared: dict[str, Value] = {}
    if "normal" in maps:
        shared["normal"] = _normal(network, prefix, material, maps["normal"])
    metallic: Value = material.metallic
    if "metallic" in maps:
        metallic = _picture(network, prefix, "metallic", "ND_image_float", material, maps)
    dielectric = not (isinstance(metallic, float) and metallic == 1.0)
    color = _color(network, prefix, material, maps)
    bsdf: UsdShade.Output | None = None
    if dielectric and material.specular < 1.0:
        inputs = {"color": color, **shared}
        bsdf = network.node(f"{prefix}diffuse", "ND_oren_nayar_diffuse_bsdf", inputs)
    if dielectric and material.specular > 0.0:
        gloss = _ggx(network, prefix, "gloss", Gf.Vec3f(1.0), material, maps, shared)
        bsdf = network.mix(f"{prefix}glossy", bsdf, gloss, material.specular) if bsdf else gloss
    if "metallic" in maps or material.metallic > 0.0:
        metal = _ggx(network, prefix, "metal", color, material, maps, shared)
        bsdf = network.mix(f"{prefix}metallic", bsdf, metal, metallic) if bsdf else metal
    assert bsdf is not None
    return bsdf
