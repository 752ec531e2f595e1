"""MaterialX nodes that stand in our stages: what the compiler writes and the check accepts.

usd-core has no MaterialX library, so neither the compiler nor ``scenec check`` can ask one what a
node takes. This table is that knowledge; a test holds it against the node definitions of a real
MaterialX library.
"""

from __future__ import annotations

from dataclasses import dataclass

#: MaterialX version that the nodes are meant in.
VERSION = "1.39"
#: Name of the render context, as in ``outputs:mtlx:surface``.
CONTEXT = "mtlx"
#: What names of layers end in that hold MaterialX nodes, and nothing else does.
LAYER_SUFFIX = ".mtlx.usda"
#: Output of every node below.
OUTPUT = "out"
#: MaterialX's names of color spaces; it does not know all of USD's.
LINEAR = "lin_rec709"
SRGB = "srgb_texture"


@dataclass(frozen=True)
class NodeType:
    """A node definition: USD type names of the inputs that are used, and of the output."""

    inputs: dict[str, str]
    output: str


#: By ``info:id``. USD has no type for BSDFs and shaders: they are tokens, as in UsdMtlx.
NODES: dict[str, NodeType] = {
    "ND_surface": NodeType({"bsdf": "token", "opacity": "float"}, "token"),
    "ND_ifgreatereq_float": NodeType(
        {"value1": "float", "value2": "float", "in1": "float", "in2": "float"}, "float"
    ),
    "ND_mix_bsdf": NodeType({"fg": "token", "bg": "token", "mix": "float"}, "token"),
    "ND_add_bsdf": NodeType({"in1": "token", "in2": "token"}, "token"),
    "ND_oren_nayar_diffuse_bsdf": NodeType(
        {"weight": "float", "color": "color3f", "normal": "float3"}, "token"
    ),
    "ND_translucent_bsdf": NodeType(
        {"weight": "float", "color": "color3f", "normal": "float3"}, "token"
    ),
    "ND_generalized_schlick_bsdf": NodeType(
        {"color0": "color3f", "color90": "color3f", "roughness": "float2", "normal": "float3"},
        "token",
    ),
    "ND_roughness_anisotropy": NodeType({"roughness": "float"}, "float2"),
    "ND_geompropvalue_float": NodeType({"geomprop": "string", "default": "float"}, "float"),
    "ND_image_color3": NodeType({"file": "asset", "texcoord": "float2"}, "color3f"),
    "ND_image_float": NodeType(
        {"file": "asset", "texcoord": "float2", "uaddressmode": "string", "vaddressmode": "string"},
        "float",
    ),
    "ND_image_vector3": NodeType({"file": "asset", "texcoord": "float2"}, "float3"),
    "ND_position_vector3": NodeType({"space": "string"}, "float3"),
    "ND_normal_vector3": NodeType({"space": "string"}, "float3"),
    "ND_geompropvalue_vector2": NodeType({"geomprop": "string"}, "float2"),
    "ND_extract_vector3": NodeType({"in": "float3", "index": "int"}, "float"),
    "ND_combine2_vector2": NodeType({"in1": "float", "in2": "float"}, "float2"),
    "ND_combine3_vector3": NodeType({"in1": "float", "in2": "float", "in3": "float"}, "float3"),
    "ND_convert_vector3_vector2": NodeType({"in": "float3"}, "float2"),
    "ND_divide_vector2FA": NodeType({"in1": "float2", "in2": "float"}, "float2"),
    "ND_multiply_float": NodeType({"in1": "float", "in2": "float"}, "float"),
    "ND_add_float": NodeType({"in1": "float", "in2": "float"}, "float"),
    "ND_add_color3": NodeType({"in1": "color3f", "in2": "color3f"}, "color3f"),
    "ND_add_vector3": NodeType({"in1": "float3", "in2": "float3"}, "float3"),
    "ND_multiply_color3": NodeType({"in1": "color3f", "in2": "color3f"}, "color3f"),
    "ND_multiply_color3FA": NodeType({"in1": "color3f", "in2": "float"}, "color3f"),
    "ND_clamp_float": NodeType({"in": "float"}, "float"),
    "ND_clamp_color3": NodeType({"in": "color3f"}, "color3f"),
    "ND_dotproduct_vector3": NodeType({"in1": "float3", "in2": "float3"}, "float"),
    "ND_multiply_vector3": NodeType({"in1": "float3", "in2": "float3"}, "float3"),
    "ND_divide_vector3FA": NodeType({"in1": "float3", "in2": "float"}, "float3"),
    "ND_multiply_vector3FA": NodeType({"in1": "float3", "in2": "float"}, "float3"),
    "ND_subtract_vector3": NodeType({"in1": "float3", "in2": "float3"}, "float3"),
    "ND_normalize_vector3": NodeType({"in": "float3"}, "float3"),
    "ND_crossproduct_vector3": NodeType({"in1": "float3", "in2": "float3"}, "float3"),
    "ND_normalmap_vector2": NodeType(
        {"in": "float3", "scale": "float2", "normal": "float3", "tangent": "float3",
         "bitangent": "float3"},
        "float3",
    ),
}  # fmt: skip
