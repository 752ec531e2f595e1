"""Depth of field: circles of confusion against their formula and against renderers' own lenses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.exact import ExactCaster
from scenec.backends.picture.blur import measure
from scenec.backends.picture.subframes import moved_eye
from scenec.backends.run.session import Session
from scenec.backends.stage.scene import Camera, Focus, Haze, Lighting, RenderScene, Sun
from scenec.backends.testing.scenes import dome, mesh, scene, surface
from scenec.schemas.lens import to_pixels
from scenec.testing.blur_scenes import Flat, ahead, disk, of_plates, picture, plate, session

#: A plate whose picture is 4 by 4 pixels, right of the middle: 4 m away, 40 pixels of focal length.
SMALL = (4.0, 0.1, 0.5, -0.2, 0.2)


def focused(distance: float, radius: float, camera: Camera | None = None) -> Camera:
    camera = ahead(32, 24, 40.0) if camera is None else camera
    return replace(camera, focus=Focus(distance, radius))


def moments(values: NDArray[np.floating]) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Total, mean (u, v) and variances of a picture taken as a density."""
    v, u = np.mgrid[: values.shape[0], : values.shape[1]] + 0.5
    total = float(values.sum())
    mean = np.array([(values * u).sum(), (values * v).sum()]) / total
    spread = [(values * (u - mean[0]) ** 2).sum(), (values * (v - mean[1]) ** 2).sum()]
    return total, mean, np.array(spread) / total


def projected(camera: Camera, point: NDArray[np.float64]) -> NDArray[np.float64]:
    pose = camera.camera_to_world
    x, y, z = pose[:3, :3].T @ (point - pose[:3, 3])
    return np.asarray(to_pixels(camera.intrinsics, np.array([[x / z, y / z]]))[0])


def test_what_is_in_focus_stays_and_what_is_not_moves_as_the_formula_says() -> None:
    rng = np.random.default_rng(2)
    camera = ahead(64, 48, 80.0, skew=7.0)
    focus = Focus(3.0, 0.1)
    for _ in range(20):
        x, y, depth = rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.uniform(0.5, 20.0)
        dx, dy = rng.uniform(-0.1, 0.1, 2)
        moved = moved_eye(camera, focus, dx, dy)
        sharp = np.array([3.0, -x, -y])
        assert projected(moved, sharp) == pytest.approx(projected(camera, sharp), abs=1e-10)
        point = np.array([depth, -x, -y])
        away = projected(moved, point) - projected(camera, point)
        share = 1.0 / 3.0 - 1.0 / depth
        wanted = np.array([80.0 * dx + 7.0 * dy, 80.0 * dy]) * share
        assert away == pytest.approx(wanted, abs=1e-10)


@pytest.mark.parametrize("distance", [1.6, 40.0], ids=["behind focus", "before it"])
def test_a_blurred_plate_is_as_wide_as_the_circle_of_confusion_makes_it(distance: float) -> None:
    """Variances add up: of the plate, of the pixels' box, and c^2 / 16 of a disk of diameter c."""
    camera = focused(distance, 0.15)
    made = session(of_plates([SMALL]))
    shown = picture(made, camera, 240, (1, 2))
    total, mean, variance = moments(shown)
    c = disk(0.15, 40.0, 4.0, distance)
    assert total == pytest.approx(16.0, rel=0.02)
    assert mean == pytest.approx([16.0 + 3.0, 12.0], abs=0.05)
    assert variance == pytest.approx([(16.0 + 1.0) / 12.0 + c * c / 16.0] * 2, rel=0.04)
    v, u = np.mgrid[:24, :32] + 0.5
    beyond = np.hypot(np.maximum(abs(u - 19.0) - 2.5, 0), np.maximum(abs(v - 12.0) - 2.5, 0))
    assert shown[beyond > 0.5 * c + 0.01].max(initial=0.0) == 0.0
    facts = made.render(camera, 0, ("rgb",), 64, 1).record.blur
    sky = 2.0 * 0.15 * 40.0 / distance
    assert facts.circle_of_confusion_px == pytest.approx(max(c, sky), rel=1e-6)
    assert facts.sub_frames_per_row == 2 * min(16, facts.sub_frames_wanted_per_row // 2)


def test_what_is_in_focus_is_as_sharp_as_through_a_pinhole() -> None:
    made = session(of_plates([(4.0, -0.333, 0.517, -0.41, 0.273)]))
    plain = picture(made, ahead(32, 24, 40.0), 240, (1, 2))
    sharp = picture(made, focused(4.0, 0.15), 240, (3, 4))
    assert sharp == pytest.approx(plain, abs=0.12)
    assert np.abs(sharp - plain).mean() < 0.004


def test_an_aperture_of_no_size_is_the_plain_frame_bit_for_bit() -> None:
    made = session(of_plates([SMALL]))
    plain = made.render(ahead(32, 24, 40.0), 0, ("rgb",), 8, 5).arrays
    result = made.render(focused(2.0, 0.0), 0, ("rgb",), 8, 5)
    arrays, record = result.arrays, result.record
    assert record.blur is None
    assert arrays["rgb"].tobytes() == plain["rgb"].tobytes()


def test_a_suns_disc_out_of_focus_is_a_disk_of_confusion_of_the_same_light() -> None:
    """At infinity c is 2 r f / d; the sun's own disc has the variance of one of its width."""
    of = of_plates([(1.0, 50.0, 51.0, -0.2, 0.2)])
    sun = Sun(np.array([1.0, 0.0, 0.0]), np.full(3, 2.0), 0.05)
    of = replace(of, lighting=(Lighting((sun,), ()),))
    made = session(of)
    plain = moments(picture(made, ahead(32, 24, 40.0), 2))
    total, mean, variance = moments(picture(made, focused(2.0, 0.15), 200, (1, 2)))
    c = 2.0 * 0.15 * 40.0 / 2.0
    assert total == pytest.approx(plain[0], rel=0.01)
    assert mean == pytest.approx(plain[1], abs=0.1)
    assert variance - plain[2] == pytest.approx([c * c / 16.0] * 2, rel=0.06)


def hazy() -> RenderScene:
    near, far = mesh(*plate(1.0, -0.3, 0.05, -0.3, 0.2)), mesh(*plate(8.0, -9.0, 9.0, -9.0, 9.0))
    of = scene([near, replace(far, layers=(1,))], [surface((1.0,) * 3), surface((0.2,) * 3)])
    veil = Haze(np.full(3, 0.2), 1e9, np.full(3, 0.6))
    return replace(of, haze=(veil,))


def test_haze_lies_before_what_each_point_of_the_aperture_sees() -> None:
    """Near light spread over far haze is not dimmed by it: the mean of hazy stills."""
    of, focus = hazy(), Focus(8.0, 0.1)
    made = session(of)
    camera = ahead(16, 12, 20.0)
    shown = picture(made, replace(camera, focus=focus), 64, (1, 2))
    # Points of the aperture by their own pattern, a sunflower of a fixed turn.
    stills = []
    for i in range(48):
        r, angle = 0.1 * np.sqrt((i + 0.5) / 48.0), 2.399963 * i
        eye = moved_eye(camera, focus, r * np.cos(angle), r * np.sin(angle))
        stills.append(picture(made, eye, 4, (i,)))
    assert shown == pytest.approx(np.mean(stills, axis=0), abs=0.06)
    # Deep within the near plate and far beside it, exactly what haze leaves of each.
    near, far = np.exp(-0.2), np.exp(-1.6)
    assert shown.max() == pytest.approx(near + (1.0 - near) * 0.6, abs=5e-3)
    assert shown[:, -1] == pytest.approx(far * 0.2 + (1.0 - far) * 0.6, abs=0.02)


def test_annotation_is_that_of_the_pinhole() -> None:
    made = Session(of_plates([SMALL]), Flat())
    plain = made.render(ahead(32, 24, 40.0), 0, ("depth", "instance"), 1, 1).arrays
    through = made.render(focused(1.0, 0.3), 0, ("rgb", "depth", "instance"), 4, 1).arrays
    for name in ("depth", "instance"):
        assert through[name].tobytes() == plain[name].tobytes()


#: For renderers: a plate off the middle, under light that makes it white.
CAMERA = focused(2.0, 0.1, ahead(32, 24, 40.0))


def lit() -> RenderScene:
    # The second is behind the camera, far away: Blender's unit follows from the scene's size, and
    # it knows no apertures of thousands of units.
    made = of_plates([(4.0, -0.3, 0.55, -0.5, 0.2), (-400.0, -1.0, 1.0, -1.0, 1.0)])
    return scene(list(made.meshes), [surface((1.0,) * 3)], lights=[dome(1.0)])


def blurred(backend: Any, of: RenderScene, spp: int) -> NDArray[np.float32]:
    """What surfaces cover of each pixel."""
    from scenec.backends.picture.subframes import Drawing

    backend.load(of)
    caster = ExactCaster(of)
    blur = measure(CAMERA, caster)
    assert blur is not None
    return Drawing(blur, backend, of, 0, caster).draw(spp, 7).coverage


@pytest.mark.slow
def test_mitsubas_own_thin_lens_makes_the_same_picture() -> None:
    from scenec.backends.mitsuba.adapter import Mitsuba

    ours = blurred(Mitsuba(), lit(), 104)
    import mitsuba as mi

    to_world = mi.ScalarTransform4f().look_at([0, 0, 0], [1, 0, 0], [0, 0, 1])
    points, faces = plate(4.0, -0.3, 0.55, -0.5, 0.2)
    panel = mi.Mesh("panel", len(points), len(faces))
    params = mi.traverse(panel)
    params["vertex_positions"] = points.astype(np.float32).ravel()
    params["faces"] = faces.astype(np.uint32).ravel()
    params.update()
    of = mi.load_dict(
        {
            "type": "scene",
            "light": {"type": "constant", "radiance": 1.0},
            "panel": panel,
            "integrator": {"type": "path", "hide_emitters": True},
            "sensor": {
                "type": "thinlens", "to_world": to_world, "aperture_radius": 0.1,
                "focus_distance": 2.0, "fov": float(np.degrees(2.0 * np.arctan(0.4))),
                "fov_axis": "x", "film": {"type": "hdrfilm", "width": 32, "height": 24,
                "rfilter": {"type": "box"}, "pixel_format": "rgba"},
                "sampler": {"type": "independent", "sample_count": 1024},
            },
        }
    )  # fmt: skip
    alpha = np.array(mi.render(of))[..., 3]
    assert alpha.sum() == pytest.approx(ours.sum(), rel=0.02)
    assert ours == pytest.approx(alpha, abs=0.08)
    assert np.sqrt(np.mean((ours - alpha) ** 2)) < 0.015


@pytest.mark.slow
def test_cycles_own_lens_makes_the_same_picture() -> None:
    from scenec.backends.cycles.adapter import Cycles

    backend = Cycles()
    ours = blurred(backend, lit(), 52)
    loaded = backend._loaded
    assert loaded is not None
    plain = replace(CAMERA, focus=None)
    data = loaded.camera.data
    backend.radiance(plain, 0, 2, 1)
    scale = loaded.frame.scale
    data.dof.use_dof = True
    data.dof.focus_distance = 2.0 * scale
    # Blender's focal lengths are in thousandths of its unit.
    data.dof.aperture_fstop = data.lens * 1e-3 / (2.0 * 0.1 * scale)
    own = backend.radiance(plain, 0, 512, 1).coverage
    data.dof.use_dof = False
    assert own.sum() == pytest.approx(ours.sum(), rel=0.02)
    assert np.sqrt(np.mean((ours - own) ** 2)) < 0.02


@pytest.mark.slow
def test_pyrender_blurs_as_the_exact_caster_does() -> None:
    from scenec.backends.pyrender.adapter import Pyrender

    ours = blurred(Pyrender(), lit(), 32)
    exact = blurred(Flat(), lit(), 512)
    assert np.sqrt(np.mean((ours - exact) ** 2)) < 0.03
