"""Annotation of pictures through lenses: the same whoever saw, and what geometry says it is."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdRender

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.instances import Instances
from scenec.backends.camera.lens import ray_table
from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.lens import Lens, project, to_pixels
from scenec.testing.lens_scenes import BROWN, CAMERAS, FISHEYE, PANORAMA, around, with_lens
from scenec.testing.scenes import SKY, scene

PASSES = ("depth", "range", "label", "instance", "normal", "position", "face")


def stones(cameras: list[Camera] | None = None) -> RenderScene:
    """Stones of all sizes around the camera, on a floor."""
    meshes, rows = around()
    return scene(meshes, rows, cameras=cameras or [])


@pytest.fixture(scope="module")
def world() -> RenderScene:
    return stones()


@pytest.fixture(scope="module")
def caster(world: RenderScene) -> ExactCaster:
    return ExactCaster(world)


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_lead_to_their_pixels(name: str) -> None:
    """To 1e-9 pixels; one of z = 1 or of length 1, whose depth is said."""
    camera = CAMERAS[name]
    rays = camera_rays(camera)
    local = rays.directions @ camera.camera_to_world[:3, :3]
    plane, shown = project(camera.lens, local)
    at = to_pixels(camera.intrinsics, plane)
    known = np.ones(len(at), bool) if rays.known is None else rays.known
    v, u = np.divmod(np.arange(len(at)), camera.width)
    assert shown[known].all()
    assert np.abs(at - np.stack([u + 0.5, v + 0.5], axis=1))[known].max() < 1e-9
    if rays.depth is None:
        assert np.abs(local[:, 2] - 1.0).max() < 1e-14
    else:
        assert np.abs(np.linalg.norm(local, axis=1) - 1.0).max() < 1e-14
        assert np.abs(local[:, 2] - rays.depth).max() < 1e-14


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_and_pose_lead_back_to_the_pixel(
    name: str, world: RenderScene, caster: ExactCaster
) -> None:
    """Range along the ray is position, whose z is depth; it projects to the pixel, to 1e-6."""
    camera = CAMERAS[name]
    rays = camera_rays(camera)
    found = annotate(world, caster, camera, PASSES, 0).arrays
    depth, far = found["depth"].ravel(), found["range"].ravel()
    hit = np.isfinite(far)
    assert np.array_equal(hit, np.isfinite(depth))
    unit = rays.directions / np.linalg.norm(rays.directions, axis=1)[:, None]
    point = camera.camera_to_world[:3, 3] + far[hit, None] * unit[hit]
    assert np.abs(point - found["position"].reshape(-1, 3)[hit]).max() < 1e-9
    local = (point - camera.camera_to_world[:3, 3]) @ camera.camera_to_world[:3, :3]
    assert np.abs(local[:, 2] - depth[hit]).max() < 1e-9
    if name != "brown_conrady":
        assert (depth[hit] < 0.0).any()
    plane, shown = project(camera.lens, local)
    v, u = np.divmod(np.flatnonzero(hit), camera.width)
    assert shown.all()
    at = to_pixels(camera.intrinsics, plane)
    assert np.abs(at - np.stack([u + 0.5, v + 0.5], axis=1)).max() < 1e-6


def test_what_lies_outside_of_the_image_circle_shows_nothing(
    world: RenderScene, caster: ExactCaster
) -> None:
    """Label 0 (not the sky's), no instance, no distance; the circle is where it should be."""
    camera = CAMERAS["kannala_brandt"]
    rays = camera_rays(camera)
    assert rays.known is not None
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(72) + 0.5)
    k = camera.intrinsics
    b = (y - k[1, 2]) / k[1, 1]
    a = (x - k[0, 2] - k[0, 1] * b) / k[0, 0]
    t = FISHEYE.max_angle
    c = FISHEYE.coefficients
    edge = t * (1 + c[0] * t**2 + c[1] * t**4 + c[2] * t**6 + c[3] * t**8)
    assert np.array_equal(rays.known, (np.hypot(a, b) <= edge).ravel())
    found = annotate(world, caster, camera, PASSES, 0).arrays
    out = ~rays.known.reshape(72, 96)
    assert (found["label.class"][out] == 0).all()
    assert (found["label.class"][~out] >= SKY).all()
    assert (found["instance"][out] == 0).all()
    assert np.isposinf(found["depth"][out]).all()
    assert np.isposinf(found["range"][out]).all()
    assert np.isnan(found["position"][out]).all()
    assert (found["normal"][out] == 0.0).all()
    assert (found["face"][out] == 0xFFFFFFFF).all()


def test_a_panorama_is_six_pinhole_views(world: RenderScene, caster: ExactCaster) -> None:
    """Its pixels show what the nearest pixel of a cube's fine face does, but at edges."""
    camera = with_lens(PANORAMA, 128, 64)
    found = annotate(world, caster, camera, ("label", "range"), 0).arrays
    rays = camera_rays(camera).directions
    local = rays @ camera.camera_to_world[:3, :3]
    size, agree, counted = 256, 0, 0
    for axis in range(3):
        for sign in (1.0, -1.0):
            forward = sign * np.eye(3)[axis]
            right = np.eye(3)[(axis + 1) % 3]
            basis = np.stack([right, np.cross(forward, right), forward], axis=1)
            pose = np.array(camera.camera_to_world)
            pose[:3, :3] = pose[:3, :3] @ basis
            k = np.array([[size / 2, 0, size / 2], [0, size / 2, size / 2], [0, 0, 1.0]])
            face = Camera("f", "/F", size, size, k, pose)
            view = annotate(world, caster, face, ("label", "range"), 0).arrays
            own = np.flatnonzero(np.argmax(np.abs(local), axis=1) * sign == axis * sign)
            own = own[local[own, axis] * sign > 0.0]
            seen = local[own] @ basis
            u, v = (np.clip((seen[:, i] / seen[:, 2] + 1.0) * size / 2, 0, size - 1).astype(int)
                    for i in range(2))  # fmt: skip
            agree += (view["label.class"][v, u] == found["label.class"].ravel()[own]).sum()
            counted += len(own)
            hit = np.isfinite(view["range"][v, u]) & np.isfinite(found["range"].ravel()[own])
            near = np.isclose(view["range"][v, u][hit], found["range"].ravel()[own][hit], rtol=0.1)
            assert near.mean() > 0.9
    assert counted == 128 * 64
    assert agree / counted > 0.98


@pytest.mark.parametrize("name", CAMERAS)
def test_amodal_areas_are_those_of_each_instance_alone(
    name: str, world: RenderScene, caster: ExactCaster
) -> None:
    """Against scenes that hold nothing else; pixels that show it are among them."""
    camera = CAMERAS[name]
    rays = camera_rays(camera)
    exact = caster.hits(rays)
    listed = Instances(world).seen(exact.row, exact.t, camera, 0, caster.geometry, True, rays)
    assert listed.amodal is not None
    meshes, rows = around()
    chosen = list(range(0, len(listed.table["id"]), max(1, len(listed.table["id"]) // 12)))
    for at in chosen:
        row = int(listed.table["id"][at]) - 1
        alone = ExactCaster(scene(meshes, [rows[row]])).hits(rays)
        assert listed.table["amodal"][at] == (alone.row == 0).sum()
        assert listed.table["amodal_full"][at] == listed.table["amodal"][at]
        mask = listed.amodal.mask(at)
        assert np.array_equal(mask.ravel(), alone.row == 0)
        border = np.ones(rays.shape, bool)
        border[1:-1, 1:-1] = False
        if listed.table["amodal_bounded"][at]:
            assert not (mask & border).any()
        assert listed.table["depth_min"][at] <= listed.table["depth_max"][at]
    # The floor reaches the border of any picture.
    assert listed.table["amodal_bounded"][list(listed.table["id"]).index(1)] == 0


@pytest.mark.parametrize("fov", [0.1, 1.0, 179.0])
def test_a_lens_without_distortion_is_a_pinhole(
    fov: float, world: RenderScene, caster: ExactCaster
) -> None:
    """Of any field of view: rays to rounding, annotation the same."""
    plain = with_lens(None, 33, 21, 16.5 / np.tan(np.radians(fov / 2)))
    bent = dataclasses.replace(plain, lens=Lens("brown_conrady", (0.0,) * 8))
    expected, rays = camera_rays(plain), camera_rays(bent)
    assert (
        np.abs(rays.directions - expected.directions).max()
        < 1e-13 * np.abs(expected.directions).max()
    )
    one = annotate(world, caster, plain, ("label", "depth"), 0).arrays
    two = annotate(world, caster, bent, ("label", "depth"), 0).arrays
    assert np.array_equal(one["label.class"], two["label.class"])
    assert np.allclose(one["depth"], two["depth"], rtol=1e-9)


@pytest.mark.parametrize("lens", [BROWN, FISHEYE, PANORAMA])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1)])
def test_pictures_of_a_pixel_or_a_line(
    lens: Lens, size: tuple[int, int], world: RenderScene, caster: ExactCaster
) -> None:
    """They are annotated like any other."""
    camera = with_lens(lens, *size)
    found = annotate(world, caster, camera, PASSES, 0)
    assert np.array_equal(found.hits.row, caster.hits(camera_rays(camera)).row)
    assert found.arrays["range"].shape == (size[1], size[0])
    assert ray_table(camera).directions.ndim == 3


@pytest.mark.slow
def test_tables_of_8192_columns_need_little_beside_themselves() -> None:
    """What is made on the way does not grow with the picture: a seventh of the table at most."""
    import tracemalloc

    camera = with_lens(PANORAMA, 8192, 4096)
    camera_rays(with_lens(PANORAMA, 64, 32))
    tracemalloc.start()
    rays = camera_rays(camera)
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rays.directions.shape == (8192 * 4096, 3)
    assert (peak - held) < held / 7.0
    sample = np.random.default_rng(0).integers(0, 8192 * 4096, 5000)
    local = rays.directions[sample] @ camera.camera_to_world[:3, :3]
    plane, _ = project(PANORAMA, local)
    v, u = np.divmod(sample, 8192)
    at = to_pixels(camera.intrinsics, plane)
    assert np.abs(at - np.stack([u + 0.5, v + 0.5], axis=1)).max() < 1e-9


def stage_with(folder: Path, **attributes: object) -> Path:
    """A stage with one camera of these attributes of a lens."""
    path = folder / "stage.usda"
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    camera = UsdGeom.Camera.Define(stage, "/World/C")
    product = UsdRender.Product.Define(stage, "/Render/P")
    product.CreateResolutionAttr(Gf.Vec2i(64, 48))
    product.CreateCameraRel().SetTargets([camera.GetPath()])
    types = {"model": Sdf.ValueTypeNames.Token, "coefficients": Sdf.ValueTypeNames.DoubleArray,
             "maxAngle": Sdf.ValueTypeNames.Double}  # fmt: skip
    for key, value in attributes.items():
        camera.GetPrim().CreateAttribute(f"scenec:lens:{key}", types[key]).Set(value)
    stage.GetRootLayer().Save()
    return path


def test_a_stages_lens_is_read(tmp_path: Path) -> None:
    """Without a largest angle a fisheye goes all the way round."""
    read = read_stage(stage_with(tmp_path, model="kannala_brandt", coefficients=[0.1, 0, 0, 0]))
    assert read.cameras[0][0].lens == Lens("kannala_brandt", (0.1, 0.0, 0.0, 0.0), np.pi)
    assert names.ATTR_LENS_MODEL == "scenec:lens:model"


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        ({"model": "kannala_brant"}, 'did you mean "kannala_brandt"'),
        ({"model": "brown_conrady", "coefficients": [0.1]}, "holds 1 numbers, expected 8"),
        ({"model": "kannala_brandt", "coefficients": [0.0, 0, 0, np.nan]}, "4 finite numbers"),
        ({"model": "kannala_brandt", "coefficients": [0.0] * 4, "maxAngle": 4.0}, "at most pi"),
    ],
)
def test_a_stages_broken_lens_is_one_message(
    tmp_path: Path, attributes: dict[str, object], said: str
) -> None:
    """With the camera's path."""
    with pytest.raises(StageError, match="/World/C") as error:
        read_stage(stage_with(tmp_path, **attributes))
    assert said in str(error.value)
