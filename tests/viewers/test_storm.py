"""Hydra Storm shows our stages as they are meant, MaterialX networks included."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import shading
import storm_render
import viewer_scene
from numpy.typing import NDArray

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not all(importlib.util.find_spec(name) for name in ("bpy", "moderngl")),
        reason="needs bpy (its USD has Storm) and moderngl",
    ),
]
FACTOR = 2


def session(scene: RenderScene, more: str = "") -> str:
    """A layer that leaves the sun alone, without exposure, and makes Storm's picture as ours.

    Storm's recorder takes the height from the apertures and rounds it down; a little more of the
    vertical one makes it ours.
    """
    views = "".join(
        f'over "{camera.path.split("/")[-1]}" {{\n float exposure = 0\n '
        f"float verticalAperture = {0.36 * camera.height / camera.width * (1 + 1e-6):.9g}\n}}\n"
        for camera in scene.cameras[0]
    )
    return (
        '#usda 1.0\nover "World" {\n'
        'over "Lights" {\nover "Dome" (\n active = false\n)\n{\n}\n'
        'over "Sun" {\n float inputs:angle = 0\n}\n}\n'
        f'over "Rigs" {{\nover "rover" {{\n{views}}}\n}}\n{more}}}\n'
    )


def storm(
    stage: Path,
    scene: RenderScene,
    shots: list[tuple[Camera, int]],
    more: str = "",
    mute: tuple[Path, ...] = (),
) -> list[NDArray[np.float64]]:
    """Pictures of cameras at samples, RGBA, each [n, 4], at FACTOR times their resolution."""
    folder = stage.parent.parent
    files = [folder / f"storm_{i}.exr" for i in range(len(shots))]
    job = {
        "stage": str(stage),
        "session": session(scene, more),
        "mute": [str(path) for path in mute],
        "shots": [
            (camera.path, sample, camera.width * FACTOR, str(file))
            for (camera, sample), file in zip(shots, files, strict=True)
        ],
    }
    (folder / "job.json").write_text(json.dumps(job))
    script = Path(storm_render.__file__)
    done = viewer_scene.run_apart(script, folder / "job.json")
    if done.returncode == storm_render.NO_EGL:
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stderr
    # A node or color space that its MaterialX does not know, a shader that does not compile.
    assert "Unsupported" not in done.stderr, done.stderr
    assert "Failed" not in done.stderr, done.stderr
    pictures = []
    for (camera, _), file in zip(shots, files, strict=True):
        with OpenEXR.File(str(file), separate_channels=True) as picture:
            channels = [np.array(picture.channels()[c].pixels, float) for c in "RGBA"]
        assert channels[0].shape == (camera.height * FACTOR, camera.width * FACTOR)
        pictures.append(np.stack([channel.ravel() for channel in channels], axis=-1))
    return pictures


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    return viewer_scene.compiled(folder, viewer_scene.viewer_cfg())


@pytest.fixture(scope="module")
def scene(stage) -> RenderScene:
    return read_stage(stage)


@pytest.fixture(scope="module")
def shots(scene) -> list[tuple[Camera, int]]:
    return [(camera, sample) for sample in range(2) for camera in scene.cameras[sample]]


@pytest.fixture(scope="module")
def pictures(stage, scene, shots):
    return storm(stage, scene, shots)


def ratios(picture, expected, mask):
    """Storm's radiance over the expected one where there is enough of it, [k, 3].

    Args:
        picture: Storm's, [n, 4].
        expected: [n, 3].
        mask: Which pixels, [n].
    """
    least = expected.min(axis=1)
    lit = mask & (least > 0.1 * np.quantile(least[mask], 0.95))
    assert lit.sum() > 80
    return picture[lit, :3] / expected[lit]


def on_ground(scene, shaded):
    return (shaded.row >= 0) & (scene.rows.instance_id[np.maximum(shaded.row, 0)] == 0)


def labeled_layer(scene, seen):
    """Index of the ground layer that names each pixel's face, [n]; 0 off the ground."""
    ground = on_ground(scene, seen)
    mesh = scene.meshes[scene.rows.mesh[seen.row[ground][0]]]
    layers = [scene.surfaces[i].path.split("/")[-1] for i in mesh.layers]
    labels = mesh.labels["surface"][seen.face[ground]]
    layer = np.zeros(len(seen.row), int)
    layer[ground] = [layers.index(scene.label_names["surface"][label]) for label in labels]
    assert (np.bincount(layer[ground], minlength=3) > 200).all()
    return layer


def test_storm_covers_the_pixels_that_the_exact_caster_hits(scene, shots, pictures):
    for (camera, _), picture in zip(shots, pictures, strict=True):
        ours = viewer_scene.classes(scene, shading.enlarged(camera, FACTOR)).ravel()
        assert (np.bincount(ours, minlength=3) > 200).all()
        # Float32 and rasterization rules, at the edges of some hundred rocks.
        assert ((picture[:, 3] > 0.5) != (ours != viewer_scene.SKY)).sum() <= 5


def test_the_ground_is_the_mix_of_its_layers_by_their_weights(scene, shots, pictures):
    for (camera, sample), picture in zip(shots, pictures, strict=True):
        expected = shading.shade(scene, shading.enlarged(camera, FACTOR), sample)
        found = ratios(picture, expected.radiance, on_ground(scene, expected))
        # MaterialX gives back the energy that rough lobes lose between facets: a little brighter.
        low, middle, high = np.quantile(found, [0.01, 0.5, 0.99], axis=0)
        assert low.min() > 0.995
        assert middle.max() < 1.02
        assert high.max() < 1.04


def test_rocks_are_of_their_material_but_for_what_varies_from_rock_to_rock(scene, shots, pictures):
    found = []
    for (camera, sample), picture in zip(shots, pictures, strict=True):
        expected = shading.shade(scene, shading.enlarged(camera, FACTOR), sample)
        rock = (expected.row >= 0) & ~on_ground(scene, expected)
        found.append(ratios(picture, expected.radiance, rock))
    # Some pixels' rays pass an edge of a rock on the other side.
    assert np.abs(np.median(np.concatenate(found), axis=0) - 1).max() < 0.01
    assert np.abs(np.quantile(np.concatenate(found), [0.2, 0.8], axis=0) - 1).max() < 0.05


def test_a_ground_material_without_weights_shows_itself(stage, scene, shots):
    (camera, sample), *_ = shots
    without = "".join(f" float[] primvars:scenec_weight_{i} = None\n" for i in (1, 2))
    tile = f'over "Terrain" {{\nover "tile_000_000" {{\n{without}}}\n}}\n'
    (picture,) = storm(stage, scene, [(camera, sample)], tile)
    larger = shading.enlarged(camera, FACTOR)
    layer = labeled_layer(scene, viewer_scene.first_hits(scene, larger))
    expected = shading.shade(scene, larger, sample, layer)
    for index in range(3):
        mask = on_ground(scene, expected) & (layer == index)
        found = ratios(picture, expected.radiance, mask)
        assert np.abs(np.median(found, axis=0) - 1).max() < 0.01


def test_a_viewer_without_materialx_shows_the_blended_colors_of_the_preview(stage, scene, shots):
    (camera, sample), *_ = shots
    networks = tuple(stage.parent.rglob("*.mtlx.usda"))
    assert len(networks) == 2
    (picture,) = storm(stage, scene, [(camera, sample)], mute=networks)
    larger = shading.enlarged(camera, FACTOR)
    # displayColor blends the albedos, also of what passes sheets; what is of metal, of the labeled
    # material, takes from it.
    without = {"specular": 0.0, "metallic": 0.0, "diffuse_transmission": 0.0}
    dull = tuple(dataclasses.replace(s, **without) for s in scene.surfaces)
    expected = shading.shade(dataclasses.replace(scene, surfaces=dull), larger, sample)
    ground = on_ground(scene, expected)
    layers = scene.meshes[scene.rows.mesh[expected.row[ground][0]]].layers
    metal = np.array([scene.surfaces[i].metallic for i in layers])[labeled_layer(scene, expected)]
    found = ratios(picture, expected.radiance * (1 - metal)[:, None], ground)
    # Its gloss is UsdPreviewSurface's own.
    assert np.abs(np.median(found, axis=0) - 1).max() < 0.08
    assert np.abs(np.quantile(found, [0.1, 0.9], axis=0) - 1).max() < 0.25


def test_maps_lie_where_they_are_defined_to_lie(tmp_path):
    stage = viewer_scene.compiled(tmp_path, viewer_scene.mapped_cfg(tmp_path))
    scene = read_stage(stage)
    camera = scene.cameras[0][0]
    (picture,) = storm(stage, scene, [(camera, 0)])
    larger = shading.enlarged(camera, FACTOR)
    expected = shading.shade(scene, larger, 0)
    whole = on_ground(scene, expected) & shading.whole_quads(expected, larger)
    found = ratios(picture, expected.radiance, whole)
    # sRGB is decoded after filtering in MaterialX, before it in our definition.
    assert np.abs(np.median(found, axis=0) - 1).max() < 0.015
    assert np.abs(np.quantile(found, [0.1, 0.9], axis=0) - 1).max() < 0.08
