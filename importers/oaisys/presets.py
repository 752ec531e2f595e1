"""Presets of the landscape generator A.N.T. that OAISYS names, as far as they are translated.

Lengths are in units of a mesh of ``mesh_size_x``; types of noise by A.N.T.'s names.
"""

from __future__ import annotations

from scenec.schemas.codec import JsonObject

#: What A.N.T. takes where nothing is said.
USUAL: JsonObject = {
    "subdivision_x": 128, "mesh_size_x": 2.0, "mesh_size_y": 2.0, "noise_size_x": 1.0,
    "noise_size_y": 1.0, "noise_size": 1.0, "noise_type": "hetero_terrain",
    "basis_type": "BLENDER", "distortion": 1.0, "hard_noise": "0", "noise_depth": 8,
    "amplitude": 0.5, "frequency": 2.0, "dimension": 1.0, "lacunarity": 2.0, "offset": 1.0,
    "height": 0.5, "height_invert": False, "height_offset": 0.0, "edge_falloff": "3",
    "maximum": 1.0, "minimum": -1.0, "strata": 5.0, "strata_type": "0",
}  # fmt: skip

#: What each preset says otherwise.
PRESETS: dict[str, JsonObject] = {
    "another_noise": {
        "subdivision_x": 160, "noise_size": 1.25, "noise_type": "ant_turbulence",
        "noise_depth": 9, "amplitude": 0.48, "frequency": 1.9, "height_invert": True,
        "height_offset": -0.1, "edge_falloff": "0",
    },
    "canyon": {
        "subdivision_x": 200, "noise_size_y": 1.25, "noise_size": 1.5,
        "noise_type": "marble_noise", "distortion": 2.0, "hard_noise": "1", "noise_depth": 12,
        "height": 0.6, "edge_falloff": "2", "maximum": 0.5, "minimum": -0.2, "strata": 6.0,
        "strata_type": "2",
    },
    "dunes": {
        "noise_size": 0.78, "noise_type": "turbulence_vector", "hard_noise": "1",
        "noise_depth": 2, "amplitude": 0.52, "frequency": 1.85, "height": 0.25,
        "height_invert": True, "height_offset": 0.05,
    },
    "large_terrain": {
        "subdivision_x": 256, "mesh_size_x": 20.0, "mesh_size_y": 20.0, "noise_size": 4.0,
        "noise_type": "double_multiFractal", "distortion": 0.5, "hard_noise": "1",
        "dimension": 1.03, "height": 1.0, "edge_falloff": "0", "maximum": 5.0, "minimum": -0.5,
    },
    "mesa": {
        "noise_type": "shattered_hterrain", "basis_type": "VORONOI_F1", "distortion": 1.15,
        "hard_noise": "1", "height_offset": 0.2, "maximum": 0.25, "minimum": 0.0,
        "strata": 2.25, "strata_type": "2",
    },
    "mounds": {
        "noise_size": 0.3333, "basis_type": "PERLIN_NEW", "dimension": 0.95, "lacunarity": 2.2,
        "offset": 0.5, "height": 0.23, "edge_falloff": "0",
    },
    "mountain_1": {
        "noise_size": 0.75, "noise_type": "ridged_multi_fractal", "noise_depth": 12,
        "offset": 0.88, "height_offset": 0.25,
    },
    "mountain_2": {
        "noise_type": "vl_hTerrain", "hard_noise": "1", "frequency": 1.75, "height": 0.4,
        "minimum": 0.0, "strata": 0.5, "strata_type": "3",
    },
}  # fmt: skip

#: Variant of our multifractal by A.N.T.'s type; whether octaves follow ``dimension`` and
#: ``lacunarity`` (else ``amplitude`` and ``frequency``); whether ``distortion`` warps it.
NOISES: dict[str, tuple[str, bool, bool]] = {
    "multi_fractal": ("hetero", True, False),
    "ridged_multi_fractal": ("ridged", True, False),
    "hybrid_multi_fractal": ("hybrid", True, False),
    "hetero_terrain": ("hetero", True, False),
    "fractal": ("fbm", True, False),
    "turbulence_vector": ("fbm", False, False),
    "variable_lacunarity": ("fbm", False, True),
    "marble_noise": ("ridged", False, True),
    "shattered_hterrain": ("hetero", True, True),
    "strata_hterrain": ("hetero", True, False),
    "ant_turbulence": ("fbm", False, True),
    "vl_noise_turbulence": ("fbm", False, True),
    "vl_hTerrain": ("hetero", True, True),
    "distorted_heteroTerrain": ("hetero", True, True),
    "double_multiFractal": ("hybrid", True, False),
    "rocks_noise": ("billow", True, False),
    "slick_rock": ("ridged", True, False),
    "planet_noise": ("fbm", True, False),
    "blender_texture": ("fbm", True, False),
}

#: Parameters that change nothing that is seen, and others that have no counterpart.
WITHOUT_COUNTERPART: dict[str, str] = {
    "random_seed": "--seed of scenec stands for it: each batch has a relief of its own",
    **dict.fromkeys(
        ("noise_offset_x", "noise_offset_y", "noise_offset_z", "noise_size_z"),
        "which place of the noise is seen is the seed's affair",
    ),
    **dict.fromkeys(
        ("subdivision_y", "mesh_size", "at_cursor", "smooth_mesh", "tri_face", "remove_double",
         "vert_group", "refresh", "auto_refresh", "show_main_settings", "show_noise_settings",
         "show_displace_settings", "ant_terrain_name"),
        "the mesh is as fine as cameras need it, and made otherwise",
    ),
    **dict.fromkeys(
        ("edge_falloff", "falloff_x", "falloff_y", "edge_level"),
        "no falloff: the relief goes on up to the border",
    ),
    **dict.fromkeys(("maximum", "minimum"), "heights are not clipped"),
    **dict.fromkeys(
        ("water_plane", "water_level", "water_material"), "there is no water"
    ),
    **dict.fromkeys(
        ("land_material", "texture_block"), "materials come from assetMaterial"
    ),
    "sphere_mesh": "a terrain is a rectangle",
    **dict.fromkeys(
        ("marble_bias", "marble_sharp", "marble_shape", "vl_basis_type", "gain"),
        "belongs to a type of noise that is approximated by another one",
    ),
    **dict.fromkeys(
        ("fx_mixfactor", "fx_mix_mode", "fx_type", "fx_bias", "fx_turb", "fx_depth",
         "fx_amplitude", "fx_frequency", "fx_size", "fx_loc_x", "fx_loc_y", "fx_height",
         "fx_invert", "fx_offset"),
        "the effect on top of the noise has no counterpart; operators of relief can be added",
    ),
}  # fmt: skip
