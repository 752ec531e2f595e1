"""What the tests of amodal areas and masks share."""

from __future__ import annotations

from scenec.backends.annotation.instances import Instances
from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import Camera, RenderScene


def look(scene: RenderScene, camera: Camera, sample: int = 0, instances: Instances | None = None):
    """(table, masks, row of each pixel) of a scene, every pixel cast."""
    caster = ExactCaster(scene)
    caster.pose(sample)
    row, _, t = caster.cast(camera_rays(camera))
    found = (instances or Instances(scene)).seen(
        row, t, camera, sample, caster.geometry, masks=True
    )
    assert found.amodal is not None
    return found.table, found.amodal, row
