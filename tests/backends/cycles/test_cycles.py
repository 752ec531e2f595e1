"""What is special to Cycles, and its conformance."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.backends.camera.rays import camera_rays
from scenec.backends.cycles import Cycles, camera, light, render
from scenec.backends.picture.sky import combine, lookup, texel_directions
from scenec.backends.stage.scene import Dome, Maps, RenderScene, Sun
from scenec.backends.testing import Conformance, Lacks, Tolerance, geometry, looks
from scenec.backends.testing import scenes as ms
from scenec.schemas.errors import BackendError
from scenec.schemas.maps import decode
from scenec.testing.extras import needs

pytestmark = needs("cycles", "bpy")

TOLERANCES = {
    "intrinsics[skewed]": Lacks("Blender has no cameras with a skew"),
    "facets_under_a_sky": Tolerance(0.015, 0.015, "a polynomial"),
}


class TestCycles(Conformance):
    """All but skew, within the default tolerance."""

    backend = Cycles
    tolerances = TOLERANCES


def loaded(scene: RenderScene) -> Cycles:
    backend = Cycles()
    backend.load(scene)
    return backend


# Light


@pytest.mark.parametrize("shape", [(7, 12), (64, 128)])
def test_the_sky_of_cycles_is_the_shared_lookup_in_every_direction(tmp_path, shape):
    rng = np.random.default_rng(4)
    file = ms.write_latlong(tmp_path / "sky.exr", rng.uniform(0.1, 5, (*shape, 3)))
    for to_world in (ms.DOME_Z_UP, ms.rotation(rng)):
        dome = Dome(file, np.array([1.0, 2.0, 0.5]), to_world)
        sky = combine((dome,))
        assert sky is not None
        backend = loaded(ms.scene([ms.mesh(*ms.plane(1e-3))], lights=[dome]))
        built = backend._require_loaded()
        built.set_light(0)
        # A GPU's texture units interpolate with weights of eight bits, in both directions.
        off = 2e-3 if backend.device == "cpu" else np.ptp(sky.picture) / 2**8
        # The sky itself, as no picture of ours shows it.
        built.scene.render.film_transparent = False
        for target in ((1, 0, 0), (0.01, 0, 1), (0, 0.01, -1), (-1, 0.3, 0)):
            eye = np.array([0, 0, 5.0])
            view = ms.look_at(eye, eye + target, 48, 36, 90)
            lens = camera.find_lens(view)
            assert not isinstance(lens, str)
            camera.place(built.scene, built.camera, view, lens, built.frame)
            render.for_visibility(built.scene)
            seen = render.draw(backend._bpy, built.scene, [render.COMBINED])[0][..., :3]
            expected = lookup(sky, camera_rays(view).directions).reshape(seen.shape)
            # At a pole itself longitude, and with it the lookup, is undefined.
            assert np.mean(np.abs(seen - expected) > off) < 1e-3
            assert np.median(np.abs(seen - expected)) < off / 20


@pytest.mark.parametrize("suns", [0, 1])
def test_a_sky_is_drawn_where_it_is_bright_and_its_light_is_all_there(tmp_path, monkeypatch, suns):
    height, width = 64, 128
    picture = np.ones((height, width, 3))
    picture[14:18, 30:34] = 400.0
    file = ms.write_latlong(tmp_path / "sky.exr", picture)
    view = ms.look_at((0, 0, 10), (0, 0, 0), 24, 18)
    lights = [Dome(file, np.ones(3), ms.DOME_Z_UP), *[ms.sun(50.0, 200.0, 10.0)] * suns]
    made = ms.scene(
        [ms.mesh(*ms.plane())], [ms.surface((0.5, 0.5, 0.5))], cameras=[view], lights=lights
    )
    sky = combine(made.lighting[0].domes)
    assert sky is not None
    fine = texel_directions(10 * height, 10 * width) @ sky.to_world.T
    solid = (2.0 * np.pi**2 / fine[..., 0].size) * np.sin(
        (np.arange(10 * height) + 0.5)[:, None] * np.pi / (10 * height)
    )
    seen = lookup(sky, fine.reshape(-1, 3)).reshape(fine.shape)[..., 0]
    expected = float((seen * np.maximum(fine[..., 2], 0.0) * solid).sum())
    expected += suns * 10.0 * np.sin(np.radians(50.0))

    def draw(spp: int) -> tuple[float, float]:
        halves = loaded(made).radiance(view, 0, spp, 1).halves.astype(float)
        return float(halves.mean()), float(np.std(halves[0] - halves[1]))

    level, noise = draw(256)
    assert level == pytest.approx(0.5 * expected / np.pi, rel=5e-3)
    monkeypatch.setattr(light, "LEAST_DRAWN", np.inf)
    if suns:
        # Left to chance, the patch is what all noise comes from.
        assert draw(256)[1] > 4.0 * noise


def test_only_what_there_is_to_choose_from_takes_a_tree_of_lights():
    def tree(*lights: Sun | Dome) -> bool:
        made = ms.scene([ms.mesh(*ms.plane())], lights=list(lights))
        built = loaded(made)._require_loaded()
        built.set_light(0)
        return bool(built.scene.cycles.use_light_tree)

    assert not tree(ms.dome(1.0), ms.sun(40.0))
    assert tree(ms.sun(40.0), ms.sun(50.0))


def test_layers_that_do_not_show_are_not_looked_up(tmp_path):
    # A shader of weight 0 or 1 leaves the other one out, and mixes light as colors would.
    file = tmp_path / "gray.png"
    Image.fromarray(np.full((4, 4, 3), 188, np.uint8)).save(file)
    points, faces = ms.plane(half=5.0, cells=2)
    base = dataclasses.replace(
        ms.surface((1.0, 1.0, 1.0)), maps=Maps(base_color=file, projection="above", size_m=1.0)
    )
    top, layers = ms.surface((0.2, 0.2, 0.2)), (0, 1)
    view = ms.look_at((0, 0, 10), (0, 0, 0), 8, 8, 20)
    gray = decode(np.full((1, 1, 3), 188, np.uint8), "base_color", False)[0, 0, 0]
    for weight in (0.0, 0.25, 1.0):
        ground = dataclasses.replace(
            ms.mesh(points, faces, layers), weights=(np.full(len(points), weight, np.float32),)
        )
        made = ms.scene([ground], [base, top], cameras=[view], lights=[ms.sun(90.0, 0.0, np.pi)])
        found = loaded(made).radiance(view, 0, 16, 0).halves.mean()
        assert found == pytest.approx((1 - weight) * gray + weight * 0.2, rel=2e-3)


def test_samples_of_a_pixel_are_counted():
    # Three samples a half: sixths, and nothing between.
    made = geometry.edge(0.3)
    sixths = loaded(made).radiance(made.cameras[0][0], 0, 6, 0)
    assert sixths.spp == 6
    assert set(np.unique(np.round(sixths.coverage * 6, 5))) <= set(range(7))


def test_what_is_not_exact_is_said():
    assert "Hapke" in "".join(Cycles().losses(looks.laws_under_sky()))
    (said,) = Cycles().losses(looks.facets_under_sky(Path()))
    assert "facets" in said
    assert Cycles().losses(looks.metals_under_sky()) == ()


# What it is


def test_a_skew_is_refused_by_name():
    made = geometry.varied_views()
    backend = loaded(made)
    view = made.cameras[list(geometry.INTRINSICS).index("skewed")][0]
    assert backend.witness(camera_rays(view), 0, None) is None
    assert backend.witness(camera_rays(view), 0, view) is None
    with pytest.raises(BackendError, match="skew of 6"):
        backend.radiance(view, 0, 2, 0)


def test_broken_faces_are_said_in_one_line():
    broken = ms.scene([ms.mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))])
    mesh = dataclasses.replace(broken.meshes[0], faces=np.array([[0, 1, 3]], np.int32))
    with pytest.raises(BackendError, match="reach beyond the 3 points"):
        Cycles().load(dataclasses.replace(broken, meshes=(mesh,)))


def test_devices_are_the_cpu_or_gpus_that_are_there():
    assert Cycles(device="cpu").device == "cpu"
    chosen = Cycles(device="auto").device
    assert chosen in Cycles.devices
    assert f" {chosen} " in Cycles().version()
    if chosen == "cpu":
        for gpu in ("cuda", "optix"):
            with pytest.raises(BackendError, match=f"{gpu}.*--device cpu") as raised:
                Cycles(device=gpu)
            assert len(str(raised.value).splitlines()) == 1
    else:
        assert Cycles(device=chosen).device == chosen


ALONE = """
import os
from scenec.backends.testing import scenes as ms
from scenec.backends.cycles import Cycles
camera = ms.look_at((0, 0, 10), (0, 0, 0), 8, 8)
backend = Cycles()
backend.load(ms.scene([ms.mesh(*ms.plane())], cameras=[camera], lights=[ms.sun(90.0)]))
light = backend.radiance(camera, 0, 2, 0, denoise=True).halves
print(round(float(light.mean()), 2), os.environ["OCIO"], flush=True)
os._exit(0)
"""


def test_nothing_of_a_users_blender_is_read_and_nothing_is_left_or_said(tmp_path: Path):
    # Start-up scripts and a broken color configuration of the user's; an end as workers have it.
    scripts, temporary, home = (tmp_path / name for name in ("scripts", "tmp", "home"))
    (scripts / "startup").mkdir(parents=True)
    marker = tmp_path / "ran"
    (scripts / "startup" / "own.py").write_text(f"open({str(marker)!r}, 'w').close()\n")
    temporary.mkdir()
    home.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", ALONE],
        env={
            **os.environ,
            "BLENDER_USER_SCRIPTS": str(scripts),
            "OCIO": "/no/such.ocio",
            "TMPDIR": str(temporary),
            "HOME": str(home),
        },
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout == f"{1000 * 0.5 / np.pi:.2f} /no/such.ocio\n"
    assert not marker.exists()
    assert list(temporary.iterdir()) == []
    assert [path for path in home.rglob("*") if path.is_file()] == []
