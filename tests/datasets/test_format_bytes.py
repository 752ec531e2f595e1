"""Every format writes the same bytes, wherever it writes and however many processes do."""

from __future__ import annotations

import pytest

from scenec.backends.run.executors import Processes
from scenec.datasets.export import export
from scenec.datasets.formats.registry import format_names
from scenec.testing.made_frames import LEFT, RIGHT, make_out


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, RIGHT), 3, batches=2).out


@pytest.fixture(scope="module")
def two():
    with Processes(2) as executor:
        yield executor


# Not of Sintel, which needs flow: these frames have none.
@pytest.mark.parametrize("name", sorted({*format_names()} - {"sintel"}))
def test_the_same_frames_give_the_same_bytes(out, two, tmp_path, name):
    export(out, name, tmp_path / "one")
    export(out, name, tmp_path / "ä b" / "two", executor=two)
    sums = [(tmp_path / place / "SHA256SUMS").read_text() for place in ("one", "ä b/two")]
    assert sums[0] == sums[1]
    assert len(sums[0].splitlines()) > 3
