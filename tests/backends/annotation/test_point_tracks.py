"""Point tracks against projections by hand and by OpenCV, triangles tested one by one, and flow."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import moving_stages as ms
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chisquare

from scenec.backends.annotation.point_tracks import choose_points, follow_points
from scenec.backends.exact import ExactCaster
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, OpenShutter, RenderScene
from scenec.backends.testing.scenes import look_at
from scenec.schemas.correspondence import HIDDEN, NOTHING, OUTSIDE, VISIBLE
from scenec.schemas.errors import OutputError
from scenec.schemas.point_tracks import TrackOptions, TrackPoints, TrackSights
from scenec.schemas.shutter import Shutter
from scenec.testing.lens_scenes import CAMERAS, around
from scenec.testing.scenes import icosphere, mesh, scene

#: What a projection may be off by, pixels.
EXACT = 1e-5
VIEWS = {"pinhole": look_at([0.3, -0.2, 1.4], [4.0, 2.0, 0.4], 61, 46), **CAMERAS}


def tracks(of: RenderScene, asked: TrackOptions, index: int = 0) -> tuple[TrackPoints, TrackSights]:
    """Points of a camera at all samples."""
    caster, cameras = ExactCaster(of), [some[index] for some in of.cameras]
    counts = asked.per_frame(len(cameras))
    points = TrackPoints.joined(
        [
            choose_points(of, caster, camera, sample, count, asked)
            for sample, (camera, count) in enumerate(zip(cameras, counts, strict=True))
        ]
    )
    frames = [follow_points(of, caster, camera, s, points) for s, camera in enumerate(cameras)]
    return points, TrackSights.joined(frames)


def filmed(of: RenderScene, cameras: list[Camera]) -> RenderScene:
    return dataclasses.replace(
        of,
        samples=len(cameras),
        cameras=tuple((camera,) for camera in cameras),
        lighting=of.lighting[:1] * len(cameras),
    )


def driven(camera: Camera, rolls: bool) -> list[Camera]:
    """The camera on its way at three samples; its rows are exposed in turn, or at once."""
    found = []
    for step in range(3):
        times = np.linspace(-0.02, 0.02, 5) if rolls else np.zeros(1)
        poses = np.repeat(camera.camera_to_world[None], len(times), axis=0)
        at = 0.2 * step + times
        poses[:, :3, 3] += at[:, None] * np.array([1.0, -0.6, 0.3])
        turned = Rotation.from_matrix(poses[:, :3, :3]) * Rotation.from_rotvec(
            at[:, None] * np.array([0.2, -0.5, 0.4])
        )
        poses[:, :3, :3] = turned.as_matrix()
        shutter = OpenShutter(Shutter(0.0, 0.03), times, poses) if rolls else None
        pose = poses[len(times) // 2]
        found.append(dataclasses.replace(camera, camera_to_world=pose, shutter=shutter))
    return found


def local(camera: Camera, points: NDArray, rows: NDArray) -> NDArray:
    """Points in the camera's frame when it exposes some rows."""
    turn = np.repeat(camera.camera_to_world[None, :3, :3], len(points), axis=0)
    eye = np.repeat(camera.camera_to_world[None, :3, 3], len(points), axis=0)
    if camera.shutter is not None:
        held = camera.shutter
        at = held.shutter.readout_s * (rows / camera.height - 0.5)
        keys = Rotation.from_matrix(held.camera_to_world[:, :3, :3])
        turn = Slerp(held.times, keys)(np.clip(at, *held.times[[0, -1]])).as_matrix()
        eye = np.stack([np.interp(at, held.times, held.camera_to_world[:, k, 3]) for k in range(3)])
        eye = eye.T
    return np.einsum("nji,nj->ni", turn, points - eye)


def projected(camera: Camera, points: NDArray) -> NDArray:
    """By OpenCV through its lenses; by the formula of a sphere's map; else K alone."""
    cv2 = pytest.importorskip("cv2")
    k, lens = camera.intrinsics, camera.lens
    x, y, z = points.T
    if lens is None:
        flat = np.stack([x / z, y / z], axis=1)
    elif lens.model == "equirectangular":
        flat = np.stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))], axis=1)
    elif lens.model == "brown_conrady":
        c = np.array(lens.coefficients)
        flat = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), c)[0][:, 0]
    else:
        angle = np.arctan2(np.hypot(x, y), z)
        series = sum(c * angle ** (2 * n + 3) for n, c in enumerate(lens.coefficients))
        flat = points[:, :2] / np.hypot(x, y)[:, None] * (angle + series)[:, None]
    return flat @ k[:2, :2].T + k[:2, 2]


@pytest.mark.parametrize("rolls", [False, True], ids=["at once", "rolling"])
@pytest.mark.parametrize("view", VIEWS)
def test_places_are_those_of_a_projection_by_hand(view: str, rolls: bool) -> None:
    of = filmed(scene(*around(200)), driven(VIEWS[view], rolls))
    points, sights = tracks(of, TrackOptions(points=240))
    assert len(points.sample) == 240
    for sample, (camera,) in enumerate(of.cameras):
        own = points.sample == sample
        assert np.abs(sights.pixel[own, sample] - points.pixel[own]).max() < EXACT
        assert (sights.code[own, sample] == VISIBLE).all()
        seen = np.flatnonzero(sights.code[:, sample] <= HIDDEN)
        pixel, world = sights.pixel[seen, sample], sights.position[seen, sample]
        # Nothing moves but the camera.
        assert np.array_equal(world, sights.position[seen, 0])
        there = local(camera, world, pixel[:, 1])
        np.testing.assert_allclose(sights.depth[seen, sample], there[:, 2], rtol=1e-9)
        assert len(seen) > 60
        assert np.abs(projected(camera, there) - pixel).max() < EXACT


@pytest.fixture(scope="module")
def moving(tmp_path_factory) -> RenderScene:
    return read_stage(ms.write_stage(tmp_path_factory.mktemp("tracks") / "stage.usda"))


def test_points_of_a_moving_instance_move_with_it_and_others_stay(moving: RenderScene) -> None:
    points, sights = tracks(moving, TrackOptions(points=400, strata="label.class"))
    ball, world = points.instance == 101, sights.position
    every = np.arange(len(ball))
    chosen = world[every, points.sample]
    still = ~ball & (points.instance != 103)
    assert ball.sum() > 50
    assert np.array_equal(world[still], np.repeat(chosen[still, None], ms.SAMPLES, axis=1))

    def turn(sample: NDArray) -> Rotation:
        return Rotation.from_rotvec(np.radians(25.0) * np.stack([0 * sample, 0 * sample, sample]).T)

    fixed = turn(points.sample[ball]).inv().apply(chosen[ball] - ms.BALL[points.sample[ball]])
    for sample in range(ms.SAMPLES):
        at = turn(np.full(len(fixed), sample)).apply(fixed) + ms.BALL[sample]
        np.testing.assert_allclose(world[ball, sample], at, atol=1e-12)
    gone = points.instance == 103
    assert gone.any()
    assert (points.sample[gone] == 2).all()
    assert (sights.code[gone] == [NOTHING, NOTHING, VISIBLE, NOTHING]).all()
    assert np.isnan(sights.pixel[gone][:, [0, 1, 3]]).all()
    assert np.isnan(world[gone][:, [0, 1, 3]]).all()


def first_triangle(of: RenderScene, sample: int, eye: NDArray, points: NDArray) -> NDArray:
    """The lowest parameter at which any triangle meets the way from the eye to each point."""
    rows = of.rows_at(sample)
    corners = []
    for index, matrix in zip(rows.mesh.tolist(), rows.to_world, strict=True):
        if matrix[:, :3].any():
            one = of.meshes[index]
            corners.append((one.points.astype(float) @ matrix[:, :3].T + matrix[:, 3])[one.faces])
    a, b, c = np.concatenate(corners).transpose(1, 0, 2)
    best = np.full(len(points), np.inf)
    for number, toward in enumerate(points - eye):
        normal = np.cross(toward, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / ((b - a) * normal).sum(axis=1)
            u = scale * ((eye - a) * normal).sum(axis=1)
            across = np.cross(eye - a, b - a)
            v, t = scale * (across @ toward), scale * (across * (c - a)).sum(axis=1)
            met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        best[number] = t[met].min(initial=np.inf)
    return best


def test_what_is_hidden_is_what_a_triangle_stands_before(moving: RenderScene) -> None:
    _, sights = tracks(moving, TrackOptions(points=240, strata="instance", seed=4))
    codes = set()
    for sample, (camera,) in enumerate(moving.cameras):
        shown = np.flatnonzero(sights.code[:, sample] <= HIDDEN)
        eye, places = camera.camera_to_world[:3, 3], sights.position[shown, sample]
        t = first_triangle(moving, sample, eye, places)
        # Nothing stands so close before a point that the tolerance decides.
        assert not ((t > 1 - 1e-5) & (t < 1 - 1e-9)).any()
        assert np.array_equal(sights.code[shown, sample] == HIDDEN, t < 1 - 1e-6)
        codes |= set(sights.code[:, sample].tolist())
    assert codes >= {VISIBLE, HIDDEN}
    assert not sights.undecided.any()


def test_the_next_place_is_where_flow_leads_and_depth_is_the_frames(moving: RenderScene) -> None:
    points, sights = tracks(moving, TrackOptions(points=400, strata="instance", places="centers"))
    session, passes = Session(moving, None), ("flow", "occlusion", "depth", "position", "instance")
    for sample in range(ms.SAMPLES - 1):
        made = session.render(moving.cameras[sample][0], sample, passes, 1, 0).arrays
        own = np.flatnonzero(points.sample == sample)
        column, row = np.floor(points.pixel[own]).astype(int).T
        ahead = sights.pixel[own, sample + 1]
        np.testing.assert_allclose(
            made["flow"][row, column], ahead - points.pixel[own], rtol=1e-6, atol=1e-6
        )
        assert np.array_equal(made["occlusion"][row, column], sights.code[own, sample + 1])
        assert np.array_equal(made["instance"][row, column], points.instance[own])
        np.testing.assert_allclose(made["depth"][row, column], sights.depth[own, sample], rtol=1e-6)
        np.testing.assert_allclose(
            made["position"][row, column], sights.position[own, sample], rtol=1e-6, atol=1e-6
        )


def test_more_points_are_the_same_ones_and_some_beside(moving: RenderScene) -> None:
    for strata in ("none", "instance"):
        few, _ = tracks(moving, TrackOptions(points=50, strata=strata))
        many, _ = tracks(moving, TrackOptions(points=130, strata=strata))
        other, _ = tracks(moving, TrackOptions(points=50, strata=strata, seed=1))
        for name in ("sample", "pixel", "row", "face", "anchor", "instance"):
            assert np.array_equal(getattr(many, name)[:50], getattr(few, name))
        assert not np.array_equal(few.pixel, other.pixel)


def test_strata_have_as_many_points_each_until_they_have_no_more_pixels(
    moving: RenderScene,
) -> None:
    camera = moving.cameras[0][0]
    ids = Session(moving, None).render(camera, 0, ("instance", "depth"), 1, 0).arrays["instance"]
    asked = TrackOptions(strata="instance", places="centers")
    points = choose_points(moving, ExactCaster(moving), camera, 0, 300, asked)
    known, pixels = np.unique(ids, return_counts=True)
    # The sky has the id of the ground, 0, which has more pixels than are asked for here.
    share = {n: int((points.instance == n).sum()) for n in known.tolist()}
    most = max(share.values())
    for number, size in zip(known.tolist(), pixels.tolist(), strict=True):
        assert share[number] in (size, most, most - 1)
    assert len(points.sample) == 300


def test_places_are_spread_evenly_over_a_picture(moving: RenderScene) -> None:
    plate = mesh(np.array([[-9, -9, 5], [9, -9, 5], [0, 9, 5]]), np.array([[0, 1, 2]]))
    camera = dataclasses.replace(moving.cameras[0][0], camera_to_world=np.eye(4))
    of = filmed(scene([plate], [(0, np.eye(4)[:3])]), [camera])
    points, _ = tracks(of, TrackOptions(points=6000))
    inside = points.pixel % 1.0
    for values, bins, high in (
        (points.pixel[:, 0], 16, camera.width), (points.pixel[:, 1], 12, camera.height),
        (inside[:, 0], 10, 1), (inside[:, 1], 10, 1),
    ):  # fmt: skip
        assert chisquare(np.histogram(values, bins, (0, high))[0]).pvalue > 1e-3


def test_points_on_silhouettes_are_visible_where_any_face_of_theirs_looks_here() -> None:
    """All corners of a ball: rays that meet edges, of which half see it edge on."""
    points, faces = icosphere(2)
    points = points.astype(np.float32).astype(float)
    of = scene([mesh(points, faces)], [(0, np.eye(4)[:3])])
    camera = look_at([0.0, -3.0, 0.4], [0.0, 0.0, 0.0], 64, 64)
    a, b, c = points[faces].transpose(1, 0, 2)
    toward = (np.cross(b - a, c - a) * (camera.camera_to_world[:3, 3] - a)).sum(axis=1)
    visible = np.zeros(len(points), bool)
    for k in range(3):
        np.logical_or.at(visible, faces[:, k], toward > 0)
    n = len(points)
    at = TrackPoints(
        sample=np.zeros(n, np.int64), pixel=np.zeros((n, 2)), row=np.zeros(n, np.int32),
        face=np.array([np.flatnonzero((faces == k).any(axis=1))[-1] for k in range(n)], np.int32),
        anchor=points, instance=np.ones(n, np.uint32), labels={},
    )  # fmt: skip
    sights = follow_points(of, ExactCaster(of), camera, 0, at)
    assert np.array_equal(sights.code == VISIBLE, visible)
    assert ((sights.code == VISIBLE) | (sights.code == HIDDEN)).all()
    # Their rays meet another face of the corner, or none.
    assert sights.undecided.sum() > 0.3 * visible.sum()
    assert not sights.undecided[~visible].any()


def far(distance: float) -> RenderScene:
    size = 0.4 * distance
    plate = np.array([[-size, -size, 0], [size, -size, 0], [size, size, 0], [-size, size, 0]])
    of = scene([mesh(plate, np.array([[0, 1, 2], [0, 2, 3]]))], [(0, np.eye(4)[:3])])
    here = look_at([1e-3 * distance, 0.0, distance], [0.0, 0.0, 0.0], 640, 480)
    there = look_at([0.05 * distance, 0.0, 0.9 * distance], [0.0, 0.0, 0.0], 640, 480)
    return filmed(of, [here, there])


@pytest.mark.parametrize("distance", [0.01, 10.0, 1e5])
def test_range_costs_no_exactness(distance: float) -> None:
    of = far(distance)
    points, sights = tracks(of, TrackOptions(points=500))
    assert (sights.code[points.sample == 0, 0] == VISIBLE).all()
    assert (sights.code != HIDDEN).all()
    for sample, (camera,) in enumerate(of.cameras):
        there = local(camera, sights.position[:, sample], np.zeros(500))
        pixel = there[:, :2] / there[:, 2:] @ camera.intrinsics[:2, :2].T + camera.intrinsics[:2, 2]
        assert np.abs(pixel - sights.pixel[:, sample]).max() < EXACT


def test_a_sky_has_no_points_and_what_is_behind_the_camera_no_place() -> None:
    of = far(10.0)
    away = look_at([0.0, 0.0, 10.0], [0.0, 0.0, 20.0], 64, 48)
    points, sights = tracks(filmed(of, [away]), TrackOptions(points=10))
    assert points.pixel.shape == (0, 2)
    assert sights.code.shape == (0, 1)
    points, sights = tracks(filmed(of, [of.cameras[0][0], away]), TrackOptions(points=10))
    # Those of the second frame are not to be had.
    assert len(points.sample) == 5
    assert (sights.code == [VISIBLE, OUTSIDE]).all()
    assert np.isnan(sights.pixel[:, 1]).all()
    assert (sights.depth[:, 1] < 0.0).all()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"points": 0}, "points=0: expected a number from 1 to 1,000,000"),
        ({"strata": "instances"}, "strata=instances: expected none, instance or label.<level>"),
        ({"queries": "frist"}, 'queries=frist: expected all or first; did you mean "first"?'),
        ({"places": "edge"}, "places=edge: expected random or centers"),
        ({"seed": -1}, "seed=-1: expected a number from 0"),
    ],
)
def test_what_makes_no_sense_is_refused(given: dict[str, int | str], told: str) -> None:
    with pytest.raises(OutputError) as error:
        TrackOptions(**given)
    assert told in str(error.value)


def test_a_level_that_the_stage_has_not_is_refused(moving: RenderScene) -> None:
    with pytest.raises(OutputError, match=r"strata=label.clas: .* has label.class; did you mean"):
        TrackOptions(strata="label.clas").require_level(tuple(moving.levels), str(Path("a.usda")))
