"""Outputs and datasets that tests read, and none of them changes."""

from __future__ import annotations

import pytest
from tiny_format import install

from scenec.datasets.export import export
from scenec.testing.made_output import make_output


@pytest.fixture(scope="session")
def output(tmp_path_factory):
    """Two batches, cameras and samples each."""
    return make_output(tmp_path_factory.mktemp("made") / "out")


@pytest.fixture(scope="module")
def plugin(tmp_path_factory):
    """A package that offers the format "tiny"; a folder for PYTHONPATH."""
    with pytest.MonkeyPatch.context() as patch:
        yield install(patch, tmp_path_factory.mktemp("plugin"))


@pytest.fixture(scope="module")
def dataset(output, plugin, tmp_path_factory):
    """``output`` in the format "tiny"."""
    return export(output, "tiny", tmp_path_factory.mktemp("whole") / "ds").folder
