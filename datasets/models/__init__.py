"""Batches as files of 3D formats: what ``export`` makes of stages, not of frames."""

#: Name -> what it is.
MODEL_FORMATS = {
    "gltf": "stages: a .glb a batch, instances by EXT_mesh_gpu_instancing, ids and labels",
    "usdz": "stages: a .usdz a batch, with looks that viewers without MaterialX show",
}
#: Texels of the ground's pictures of a batch, together.
TEXELS = 1 << 21
