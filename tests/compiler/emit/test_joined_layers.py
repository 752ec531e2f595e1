"""Many classes and materials share a layer: what is read is the same, in linear time."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf
from test_maps import mapped_cfg

from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.emit import batch
from scenec.schemas.manifest import MANIFEST
from scenec.testing.small import write_cfg

COUNT = 9


def compiled(folder: Path, monkeypatch: pytest.MonkeyPatch, most: int = COUNT - 1) -> Path:
    monkeypatch.setattr(batch, "MOST_LAYERS", most)
    cfg = mapped_cfg(folder) | {"samples": 1}
    cfg["terrain"]["spacing_m"] = 0.5
    rocks = cfg["objects"]["rocks"] | {"count": 1, "prototypes": 1, "subdivisions": 1}
    stone = cfg["materials"].pop("stone")
    maps = {"maps": {"size_m": 1.5, "base_color": "c.PNG"}}
    cfg["objects"] = {}
    for number in range(COUNT):
        cfg["materials"][f"stone_{number}"] = maps if number % 4 == 0 else stone
        cfg["objects"][f"rocks_{number}"] = rocks | {"material": f"stone_{number}"}
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out")
    return folder / "out"


def assert_equal(a: Any, b: Any, folders: tuple[Path, Path], where: str = "scene") -> None:
    """Whatever is in two scenes, files by their place in their folder."""
    assert type(a) is type(b), where
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            if field.name not in ("digest", "source"):
                parts = getattr(a, field.name), getattr(b, field.name)
                assert_equal(*parts, folders, f"{where}.{field.name}")
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), where
        for i, parts in enumerate(zip(a, b, strict=True)):
            assert_equal(*parts, folders, f"{where}[{i}]")
    elif isinstance(a, dict):
        assert list(a) == list(b), where
        for key in a:
            assert_equal(a[key], b[key], folders, f"{where}[{key!r}]")
    elif isinstance(a, Path):
        assert a.relative_to(folders[0]) == b.relative_to(folders[1]), where
    else:
        np.testing.assert_array_equal(a, b, where)


def test_joined_layers_hold_what_single_ones_do(tmp_path, monkeypatch):
    (tmp_path / "joined").mkdir()
    (tmp_path / "single").mkdir()
    joined = compiled(tmp_path / "joined", monkeypatch)
    single = compiled(tmp_path / "single", monkeypatch, 10**6)
    scenes = [read_stage(out / "batch_0000/stage.usda") for out in (joined, single)]
    assert any(s.maps is not None for s in scenes[0].surfaces)
    assert len(scenes[0].instance_paths) == COUNT
    assert_equal(*scenes, (joined, single))


def test_the_number_of_layers_does_not_grow_with_that_of_classes_and_materials(
    tmp_path, monkeypatch
):
    out = compiled(tmp_path, monkeypatch)
    root = Sdf.Layer.FindOrOpen(str(out / "batch_0000/stage.usda"))
    assert len(root.subLayerPaths) < 10
    assert not [*out.glob("batch_0000/objects"), *out.glob("batch_0000/looks")]
    files = json.loads((out / MANIFEST).read_text())["files"]
    what = {name.split("/")[-1]: entry["what"] for name, entry in files.items()}
    assert (what["objects.usdc"], what["looks.usda"]) == ("object classes", "materials")


def test_few_classes_have_a_layer_each(tmp_path):
    compile_cfg(write_cfg(tmp_path), seed=3, out=tmp_path / "out")
    folder = tmp_path / "out/batch_0000"
    assert [file.name for file in (folder / "objects").iterdir()] == ["rocks.usdc"]
    assert (folder / "looks/stone.usda").is_file()
