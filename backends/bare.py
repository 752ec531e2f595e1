"""A scene without what only pictures show, for renderers that are asked for annotation alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenec.backends.render_scene import Lighting, Mesh, RenderScene


def bare(scene: RenderScene) -> RenderScene:
    """The same geometry and rows without materials, pictures, shading and light.

    What a ray meets first does not depend on them; building textures and light is most of what a
    renderer's scene costs.

    Args:
        scene: As it was read.
    """
    dark = Lighting((), ())
    return replace(
        scene,
        meshes=tuple(_bare_mesh(mesh) for mesh in scene.meshes),
        surfaces=(),
        lighting=(dark,) * len(scene.lighting),
        haze=(),
    )


def _bare_mesh(mesh: Mesh) -> Mesh:
    return replace(
        mesh,
        normals=None,
        layers=(),
        weights=np.zeros((0, len(mesh.points)), np.float32),
        variation=None,
        uv=None,
        height_blends=(),
    )
