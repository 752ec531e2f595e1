"""Each fault of the robustness study in what exporters read ends in one error, or a sound dataset.

The study itself (``lab/robustness/fuzz.py --kinds export``) makes hundreds of each format.
"""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.registry import format_names
from scenec.datasets.verify import verify
from scenec.schemas.errors import ScenecError
from scenec.testing import exports


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    exports.write(folder)
    return folder / "out"


@pytest.mark.parametrize("name", exports.FAULTS)
def test_a_fault_is_refused_in_one_line_or_the_dataset_is_sound(sound, tmp_path, name):
    at = list(exports.FAULTS).index(name)
    # Each fault in its turn with two of the formats.
    for step in (0, 7):
        form = format_names()[(at + step) % len(format_names())]
        out = tmp_path / form / "out"
        shutil.copytree(sound, out)
        stem = out / "batch_0000/frames/mitsuba/rover_left/000001"
        exports.FAULTS[name](exports.Frame(stem, np.random.default_rng(at)))
        target = tmp_path / form / "dataset"
        told = ""
        try:
            export(out, form, target, Choice(options=exports.OPTIONS.get(form, {})))
        except ScenecError as error:
            told = str(error)
        assert "\n" not in told
        assert target.exists() == (not told)
        assert told or (name not in exports.REFUSED and verify(target) == []), form


def test_the_sound_output_is_in_every_format(sound, tmp_path):
    for form in format_names():
        choice = Choice(options=exports.OPTIONS.get(form, {}))
        assert export(sound, form, tmp_path / form, choice).frames == 4
        assert verify(tmp_path / form) == []
