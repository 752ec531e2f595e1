"""A batch in three dimensions on the page: what is stored is what was given, to a stated error."""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np
import pytest

from scenec.api.listener import Listener
from scenec.api.view import ground_of, rooms_of
from scenec.cli.main import main
from scenec.cli.terminal import Terminal
from scenec.datasets.view.space import space_text, three
from scenec.schemas.manifest import find_batches
from scenec.schemas.model import Look, Model, Part, Placement, View
from scenec.testing.small import small_cfg, write_cfg


def some_model() -> Model:
    """A triangle as ground, and 50 tetrahedra of two looks."""
    rng = np.random.default_rng(3)
    ground = Part("", np.array([[0, 0, 0], [9, 0, 1], [0, 9, 2]], np.float32),
                  np.array([[0, 1, 2]], np.int32), None,
                  np.array([[0, 0, 0], [1, 1, 1], [0.5, 0.2, 0.1]], np.float32), None,
                  {"surface": np.array([3], np.uint32)}, 0)  # fmt: skip
    stone = Part("/World/Rocks/a", rng.normal(size=(4, 3)).astype(np.float32),
                 np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], np.int32), None, None, None,
                 {"surface": np.array([4, 4, 5, 4], np.uint32)}, 1)  # fmt: skip
    matrices = rng.normal(size=(50, 3, 4)) * [1, 1, 1, 1000]
    placements = (
        Placement("", (0,), np.eye(4)[None, :3], np.zeros(1, np.uint32), np.zeros(1, np.float32)),
        Placement("/World/Rocks", (1,), matrices, np.arange(1, 51, dtype=np.uint32) << 20,
                  rng.uniform(-1, 1, 50).astype(np.float32)),
    )  # fmt: skip
    poses = np.eye(4) + rng.normal(size=(1200, 1, 4))
    view = View("rover_front", 64, 48, np.array([[50, 0, 32], [0, 51, 24], [0, 0, 1.0]]), poses)
    suns = (((np.array([0.0, 0.6, 0.8]), np.ones(3)),),) * 1200
    looks = (Look("ground", (1, 1, 1), 1.0), Look("stone", (0.2, 0.3, 0.4), 0.5))
    return Model("batch_0000", np.array([1000.0, -2000, 3]), (ground, stone), looks, placements,
                 (view,), suns, np.arange(1200.0), {"surface": {3: "soil"}},
                 ("sky: <left> out",))  # fmt: skip


def opened(text: bytes) -> tuple[dict, bytes]:
    line, _, rest = text.partition(b"\n")
    return json.loads(line), zlib.decompress(base64.b64decode(rest))


def array(raw: bytes, told: list) -> np.ndarray:
    kind, at, count = told
    assert at % 4 == 0
    return np.frombuffer(raw, f"<{kind}", count, at)


def test_geometry_and_ids_are_exact_and_matrices_within_their_steps():
    model = some_model()
    facts, raw = opened(space_text(model))
    for told, part in zip(facts["parts"], model.parts, strict=True):
        assert np.array_equal(array(raw, told["points"]), part.points.ravel())
        assert np.array_equal(array(raw, told["faces"]), part.faces.ravel())
    assert facts["parts"][0]["labels"] == {"surface": 3}
    assert array(raw, facts["parts"][1]["labels"]["surface"]).tolist() == [4, 4, 5, 4]
    told, place = facts["placements"][1], model.placements[1]
    assert np.array_equal(array(raw, told["ids"]), place.ids)
    positions = array(raw, told["positions"]).reshape(-1, 3)
    assert np.array_equal(positions, place.to_world[:, :, 3].astype(np.float32))
    linear = array(raw, told["linear"]).reshape(-1, 3, 3) * (told["scale"] / 32767)
    off = np.abs(linear - place.to_world[:, :, :3]).max()
    assert off <= 0.500001 * told["scale"] / 32767


def test_long_tracks_are_thinned_and_the_text_cannot_end_its_element():
    facts, raw = opened(space_text(some_model()))
    (camera,) = facts["cameras"]
    poses = array(raw, camera["poses"]).reshape(-1, 3, 4)
    assert len(poses) <= 500
    model = some_model()
    for place, pose in enumerate(poses):
        assert np.allclose(pose, model.views[0].poses[place * camera["every"], :3], rtol=1e-6)
    assert facts["left_out"] == ["sky: <left> out"]
    assert b"<" not in space_text(model)


def test_the_library_goes_along_with_its_license_and_alone():
    code = three()
    assert code is not None
    assert code.startswith(b"/**")
    assert b"SPDX-License-Identifier: MIT" in code[:200]
    assert b"InstancedMesh" in code
    assert b"GLTFLoader" not in code
    assert b"</script" not in code


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("space")
    cfg = write_cfg(folder, small_cfg(samples=1, outputs=["depth"]) | {"batches": 2})
    assert main(["compile", str(cfg), "-o", str(folder / "out"), "--no-cache"]) == 0
    return folder / "out"


def test_the_budget_of_a_page_goes_to_as_many_batches_as_are_worth_it(out, capsys):
    assert rooms_of(out, 200.0, Terminal()) == dict.fromkeys((0, 1), (8_000_000 - 650_000) // 2)
    assert list(rooms_of(out, 4.0, Terminal())) == [0]
    assert "the first 1 of 2 batches" in capsys.readouterr().err
    assert rooms_of(out, 1.0, Terminal()) == {}


def test_what_is_stored_of_a_stage_fits_its_room(out):
    batch = find_batches(out)[1]
    for room in (60_000, 200_000):
        ground = ground_of(batch, {1: room}, 50, Listener())
        assert ground is not None
        assert ground.model is not None
        text = space_text(ground.model)
        assert len(text) < room
        facts, _ = opened(text)
        assert facts["name"] == "batch_0001"
        assert {place["owner"] for place in facts["placements"]} > {""}
    above_alone = ground_of(batch, {0: room}, 50, Listener())
    assert above_alone is not None
    assert above_alone.model is None
