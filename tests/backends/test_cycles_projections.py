"""Maps on objects in Cycles, against float64: from three sides, and by texture coordinates."""

from __future__ import annotations

import numpy as np
import projection_scenes as ps
import pytest

from scenec.backends.cycles import Cycles

SPP = 64
#: Root mean square and mean of the relative differences.
SPREAD, OFFSET = 0.004, 6e-4


@pytest.fixture(scope="module")
def backend():
    return Cycles()


def picture(backend, scene):
    backend.load(scene)
    light = backend.radiance(scene.cameras[0][0], 0, SPP, 2)
    return light.halves.astype(float).mean(axis=0)


def agrees(backend, scene, at_least):
    spread, offset, pixels = ps.differences(picture(backend, scene), scene)
    assert pixels >= at_least
    assert spread < SPREAD
    assert abs(offset) < OFFSET


@pytest.mark.parametrize(("kind", "pose", "smooth"), ps.TRIPLANAR)
def test_a_triplanar_map_lies_in_the_world_on_any_object(tmp_path, backend, kind, pose, smooth):
    agrees(backend, ps.scene(tmp_path, "triplanar", kind, pose, smooth), 80)


@pytest.mark.parametrize(("kind", "pose", "coordinates", "flip_green"), ps.BY_UV)
def test_a_map_by_texture_coordinates_lies_on_the_mesh(
    tmp_path, backend, kind, pose, coordinates, flip_green
):
    smooth = pose != "stretched"
    scene = ps.scene(tmp_path, "uv", kind, pose, smooth, coordinates, flip_green)
    agrees(backend, scene, 80)


@pytest.mark.parametrize("projection", ["triplanar", "uv"])
def test_normals_seen_from_behind_are_mirrored_in_the_surface(tmp_path, backend, projection):
    agrees(backend, ps.sheet_scene(tmp_path, projection), 900)


@pytest.mark.parametrize("projection", ["triplanar", "uv"])
def test_maps_of_roughness_and_metal_take_the_place_of_the_numbers(tmp_path, backend, projection):
    mapped, plain = (picture(backend, ps.metal_scene(tmp_path, p)) for p in (projection, None))
    covered = plain[..., 0] > 0.2 * plain[..., 0].max()
    np.testing.assert_allclose(mapped[covered].mean(), plain[covered].mean(), rtol=5e-3)


def test_layers_of_different_projections_mix(tmp_path, backend):
    got = picture(backend, ps.mixed_scene(tmp_path))
    wanted = ps.mixed_expected(tmp_path)
    np.testing.assert_allclose(got[3:-3, 3:-3], wanted[3:-3, 3:-3], rtol=0.03)
    np.testing.assert_allclose(got.mean(), wanted.mean(), rtol=3e-3)
