"""Models, layers, materials and lamps that show nowhere go; what stays keeps its meaning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.emit.terrain import blended_color
from scenec.compiler.scene.ground import Ground, GroundLayer, MeshTile
from scenec.compiler.scene.light import Lamp
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.views.lamps import without_idle
from scenec.compiler.views.needed import Needs, with_color, without_unused
from scenec.testing.examples import examples

SEEN = Needs(True, True, True)


def material(color: float) -> Material:
    return Material((color, color, color), 1.0, 0.0, 0.2)


def ground(weights: list[list[float]], layer: list[int]) -> Ground:
    """One tile of two triangles; ``weights`` of each merge at its four vertices."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    tile = MeshTile(
        "tile_000_000",
        np.zeros(3),
        points,
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        np.tile(np.float32([0, 0, 1]), (4, 1)),
        np.array(layer, np.int32),
        np.array(weights, np.float32).reshape(-1, 4),
        np.array([0.1, -0.5, 0.3, 1.0], np.float32),
    )
    names = [GroundLayer(f"m{i}", {"class": 10 + i}) for i in range(len(weights) + 1)]
    return Ground(tuple(names), (tile,))


def materials(count: int) -> dict[str, Material]:
    return {f"m{i}": material(0.1 + 0.2 * i) for i in range(count)}


def test_a_layer_that_shows_nowhere_goes_with_its_material():
    whole = ground([[0, 0, 0, 0], [0.5, 1, 0, 0]], [0, 2])
    used = without_unused(materials(3), whole, (), SEEN)
    assert [layer.material for layer in used.ground.layers] == ["m0", "m2"]
    assert set(used.materials) == {"m0", "m2"}
    assert [one["what"] for one in used.left_out] == [
        "terrain/ground/1: the layer of m1",
        "materials/m1",
    ]
    assert used.left_out[0]["bytes"] == 16


weight = st.sampled_from([0.0, 0.0, 0.25, 1.0])


@given(st.lists(st.lists(weight, min_size=4, max_size=4), max_size=4), st.data())
def test_colors_and_labels_stay_as_they_are(weights, data):
    layer = [data.draw(st.integers(0, len(weights))) for _ in range(2)]
    whole = ground(weights, layer)
    named = materials(len(weights) + 1)
    used = without_unused(named, whole, (), SEEN)
    tile, before = used.ground.tiles[0], whole.tiles[0]
    np.testing.assert_array_equal(
        blended_color(tile, used.ground, used.materials), blended_color(before, whole, named)
    )
    for face in range(2):
        now = used.ground.layers[tile.layer[face]]
        assert now == whole.layers[before.layer[face]]
    assert len(tile.weights) == len(used.ground.layers) - 1


def test_without_color_layers_and_weights_are_left_alone():
    whole = ground([[0, 0, 0, 0]], [0, 0])
    assert without_unused({}, whole, (), Needs(False, True, True)).ground is whole


def test_only_sensors_with_color_say_how_fine_pictures_are():
    def sensor(name: str, *outputs: str) -> Sensor:
        return Sensor(name, (4, 4), (4, 4, 2, 2, 0), np.eye(4), np.zeros(1), outputs)

    poses = np.eye(4)[None]
    both = Rig("a", poses, (sensor("x", "rgb", "depth"), sensor("y", "depth")))
    other = Rig("b", poses, (sensor("z", "label"),))
    found = with_color((both, other))
    assert [[s.name for s in rig.sensors] for rig in found] == [["x"]]
    every = (replace(both, sensors=both.sensors[:1]),)
    assert with_color(every) is every


def lamp(direction: np.ndarray, at: np.ndarray, cone_deg: float, radius: float) -> Lamp:
    """A lamp that shines along a direction."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross(z, [0.3, 0.7, 0.2])
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    matrix[:3, 3] = at
    one = np.ones(1)
    return Lamp(
        name="spot", to_world=matrix[None], intensity=np.ones((1, 3)), radius_m=radius * one,
        cone_deg=cone_deg * one, softness=0.0 * one,
    )  # fmt: skip


coordinate = st.floats(-4, 4)
vector = st.tuples(coordinate, coordinate, coordinate).map(np.array)


@examples(300)
@given(vector, vector, st.floats(0.1, 179), st.floats(0, 0.5))
def test_no_lamp_goes_that_shines_on_a_point_of_the_ground(direction, at, cone_deg, radius):
    if np.linalg.norm(direction) < 0.1:
        return
    whole = ground([], [0, 0])
    made = lamp(direction, at, cone_deg, radius)
    kept, left_out = without_idle([made], whole, ())
    # Points of the square, seen from the lamp's middle.
    u, v = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    way = np.stack([u.ravel(), v.ravel(), np.zeros(441)], axis=1) - at
    length = np.linalg.norm(way, axis=1)
    cosine = (way @ direction) / np.maximum(length * np.linalg.norm(direction), 1e-12)
    lit = (cosine > np.cos(np.radians(cone_deg))) & (length > 1e-9)
    if lit.any():
        assert kept == (made,)
    assert len(left_out) == 1 - len(kept)


@pytest.mark.parametrize(("up", "gone"), [(1.0, True), (-1.0, False)])
def test_a_lamp_that_shines_at_the_sky_goes(up, gone):
    made = lamp(np.array([0.0, 0.0, up]), np.array([0.5, 0.5, 10.0]), 30.0, 0.1)
    kept, left_out = without_idle([made], ground([], [0, 0]), ())
    assert (len(kept) == 0) == gone
    assert [one["what"] for one in left_out] == (["light/lamps/spot"] if gone else [])
