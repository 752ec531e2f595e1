"""The elevation models in assets/dems: what their maker makes, laid where they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

rasterio = pytest.importorskip("rasterio")

from scenec.lab.models import dems  # noqa: E402


@pytest.mark.invariant
@pytest.mark.parametrize("name", dems.RASTERS)
def test_an_elevation_model_is_as_its_maker_makes_it(name: str, tmp_path: Path) -> None:
    dems.write(name, tmp_path / "made.tif")
    with (
        rasterio.open(tmp_path / "made.tif") as made,
        rasterio.open(dems.FOLDER / f"{name}.tif") as file,
    ):
        assert made.profile == file.profile
        assert (made.scales, made.units) == (file.scales, file.units)
        assert np.array_equal(made.read(1), file.read(1))


def test_each_file_has_a_maker_and_all_together_stay_small() -> None:
    files = sorted(dems.FOLDER.glob("*"))
    assert [file.stem for file in files] == sorted(dems.RASTERS)
    assert sum(file.stat().st_size for file in files) < 1_500_000
