"""The experiments with networks: what they make, learn and score."""

from __future__ import annotations

import copy
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.compiler.cfg.load import load
from scenec.lab.experiments import terrains, torch_modules, tracking
from scenec.schemas.errors import OutputError


@pytest.mark.parametrize("name", terrains.SETTINGS)
def test_every_setting_is_a_cfg_that_differs_by_what_it_is_called_after(
    name: str, tmp_path: Path
) -> None:
    whole = terrains.cfg((96, 72), 2, 1)
    made = copy.deepcopy(whole)
    if change := terrains.SETTINGS[name].change:
        change(made)
    (tmp_path / "cfg.json").write_text(json.dumps(made))
    load(tmp_path / "cfg.json")
    assert {key for key in whole if made[key] != whole[key]} == {
        "no sensor model": {"rigs"},
        "no displacement": {"materials"},
        "no sky": {"light"},
    }.get(name, set())


def test_without_pytorch_the_message_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "scenec.lab.experiments.networks", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(OutputError, match=r"torch: pip install 'scenec\[networks\]'"):
        torch_modules.needing_torch("networks")


def _moving() -> list[tracking.Shown]:
    """Two squares that cross a picture in opposite directions, 3 pixels a step."""
    found = []
    for step in range(5):
        masks = np.zeros((2, 12, 24), bool)
        for mask, left, top in zip(masks, (3 * step, 18 - 3 * step), (1, 7), strict=True):
            mask[top : top + 4, left : left + 4] = True
        boxes = np.array([[3 * step, 1, 3 * step + 4, 5], [18 - 3 * step, 7, 22 - 3 * step, 11]])
        found.append(tracking.Shown(np.array([70, 9]), masks, boxes.astype(np.float64)))
    return found


def test_ids_that_last_score_one_and_numbers_given_anew_do_not() -> None:
    pytest.importorskip("trackeval")
    truth = _moving()
    last = tracking.scores(truth, truth, [one.ids for one in truth])
    assert {last[name] for name in ("HOTA", "DetA", "AssA", "MOTA", "IDF1")} == {1.0}
    assert last["switches"] == 0
    anew = tracking.scores(truth, truth, tracking.numbered_anew(truth))
    assert anew["DetA"] == 1
    # Five pictures: one in five of a track's pictures has the track's best number.
    assert anew["IDF1"] == pytest.approx(0.2)
    assert anew["switches"] == 8


def test_boxes_are_linked_where_they_overlap_and_begin_anew_where_they_do_not() -> None:
    frames = _moving()
    # 4 pixels wide and moved by 3: an overlap of a seventh, less than the least.
    assert [ids.tolist() for ids in tracking.linked_by_boxes(frames)[:2]] == [[0, 1], [2, 3]]
    slow = [frames[0], tracking.Shown(frames[0].ids, frames[0].masks, frames[0].boxes + 1)]
    assert [ids.tolist() for ids in tracking.linked_by_boxes(slow)] == [[0, 1], [0, 1]]


@pytest.mark.slow
def test_a_network_learns_colors_and_the_same_seed_the_same_weights(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("torchvision")
    import torch

    from scenec.lab.experiments import networks

    labels = torch.from_numpy(_patches())
    colors = torch.linspace(0.1, 0.9, len(terrains.CLASSES))
    pictures = colors[labels][:, None].repeat(1, 3, 1, 1)
    monkeypatch.setattr(networks, "_loaded", lambda frames: (pictures, labels))
    recipe = networks.Recipe("small", steps=60)
    nets = [networks.trained(None, recipe, seed) for seed in (1, 1)]
    for a, b in zip(*(net.parameters() for net in nets), strict=True):
        assert torch.equal(a, b)
    with torch.no_grad():
        answer = nets[0].eval()(networks._centered(pictures))["out"].argmax(1)
    assert (answer == labels).float().mean() > 0.6


def _patches() -> NDArray[Any]:
    """Classes in patches of 16 x 16 pixels, [8, 48, 64]."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, len(terrains.CLASSES), (8, 3, 4))
    return coarse.repeat(16, axis=1).repeat(16, axis=2)
