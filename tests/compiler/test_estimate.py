"""What cannot fit into memory is refused before work, by its keys; what ships fits into 4 GB."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.estimate import BASE_BYTES, MARGIN, needs_of, require_memory, time_warning
from scenec.schemas.errors import SceneError
from scenec.schemas.memory import GB, available, limit
from scenec.testing.examples import examples
from scenec.testing.small import small_cfg, write_cfg

_SKY = {"class": "sky", "surface": "sky"}
_CFGS = sorted((Path(__file__).parents[2] / "configs").glob("*.json"))


def needs(folder: Path, change) -> dict[str, object]:
    cfg = small_cfg()
    change(cfg)
    return {need.pointer: need for need in needs_of(load(write_cfg(folder, cfg)), 1, 0)}


def rocks(**keys):
    def change(cfg):
        own = cfg["objects"]["rocks"]
        for key in ("count", "per_m2"):
            own.pop(key, None)
        own.update(keys)

    return change


@pytest.mark.parametrize("file", _CFGS, ids=lambda file: file.stem)
def test_no_shipped_cfg_is_refused_with_four_gigabytes(file):
    for package in ("bpy", "matplotlib"):
        if f'"package:{package}/' in file.read_text() and not find_spec(package):
            pytest.skip(f"needs {package}")
    assert require_memory(needs_of(load(file), 1, 0), int(4 * GB)) is None


def test_too_many_objects_are_refused_with_their_number_their_bytes_and_the_key(tmp_path):
    found = needs(tmp_path, rocks(count=100_000_000))
    with pytest.raises(SceneError) as error:
        require_memory(list(found.values()), int(9 * GB))
    said = str(error.value)
    assert said.startswith("objects/rocks/count: 100,000,000 instances, about 25 GB: compiling")
    assert "9 GB are available" in said


@pytest.mark.parametrize(
    ("pointer", "change"),
    [
        ("objects/rocks/count", rocks(count=100_000_000)),
        ("objects/rocks/per_m2", rocks(per_m2=1e5)),
        ("terrain/spacing_m", lambda cfg: cfg["terrain"].update(spacing_m=0.004)),
        (
            "terrain/mesh/tolerance_px",
            lambda cfg: cfg["terrain"].update(
                spacing_m=0.01, mesh={"tolerance_px": 0, "max_triangles": 10**9}
            ),
        ),
        (
            "light/sky/resolution",
            lambda cfg: (
                cfg.update(samples=1000),
                cfg["light"].update(
                    sun={"elevation_deg": {"type": "uniform", "min": 1, "max": 9, "per": "sample"}},
                    sky={"type": "clear", "resolution": 2048, "labels": _SKY},
                ),
            ),
        ),
        (
            "samples",
            lambda cfg: (
                cfg.update(samples=1_000_000),
                cfg["light"]["sun"].update(elevation_deg=30, azimuth_deg=0),
            ),
        ),
    ],
)
def test_each_key_that_multiplies_memory_is_named(tmp_path, pointer, change):
    found = needs(tmp_path, change)
    assert found[pointer].bytes > 0.25 * GB
    with pytest.raises(SceneError, match=pointer):
        require_memory(list(found.values()), int(0.3 * GB))


@examples(20)
@given(st.integers(0, 2**32), st.integers(0, 5))
def test_a_drawn_number_is_the_one_that_is_compiled(tmp_path_factory, seed, batch):
    cfg = small_cfg()
    rocks(count={"type": "uniform", "min": 0, "max": 50})(cfg)
    cfg["batches"] = 6
    spec = load(write_cfg(tmp_path_factory.mktemp("cfg"), cfg))
    said = next(n for n in needs_of(spec, seed, batch) if n.pointer == "objects/rocks/count")
    drawn = next(o for o in draw(spec, seed, batch).objects if o.name == "rocks")
    assert said.what == f"{len(drawn.scale)} instances"


def test_what_is_just_below_the_margin_is_let_through_and_told(tmp_path):
    found = list(needs(tmp_path, rocks(count=10_000_000)).values())
    most = BASE_BYTES + sum(need.bytes for need in found)
    assert "10,000,000 instances" in (require_memory(found, int(most / MARGIN * 1.001)) or "")
    with pytest.raises(SceneError):
        require_memory(found, int(most / MARGIN * 0.999))
    assert require_memory(found, int(2 * most)) is None


def test_long_compilations_are_announced_with_their_causes(tmp_path):
    found = list(needs(tmp_path, rocks(count=20_000_000)).values())
    assert "objects/rocks/count: 20,000,000 instances" in (time_warning(found, 1) or "")
    assert time_warning(list(needs(tmp_path, rocks(count=10)).values()), 1) is None
    assert "for 90,000 batches" in (time_warning(found, 90_000) or "")


def test_long_erosion_is_announced(tmp_path):
    def change(cfg):
        operator = {"type": "stream_power", "erodibility": 1e-5, "duration_a": 1e5}
        cfg["terrain"]["relief"].append(operator | {"steps": 100_000})

    found = list(needs(tmp_path, change).values())
    assert "terrain/relief/3/steps: 818,100,000 steps" in (time_warning(found, 1) or "")


def test_nothing_is_written_where_a_batch_is_refused(tmp_path):
    cfg = small_cfg()
    cfg["samples"] = 1_000_000
    cfg["light"] = {
        "sun": {"elevation_deg": {"type": "uniform", "min": 1, "max": 9, "per": "sample"}},
        "sky": {"type": "clear", "resolution": 4096, "labels": _SKY},
    }
    with pytest.raises(SceneError, match=r"light/sky/resolution: 33,554,432,000,000 pixels"):
        compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_is_available_is_within_what_there_is():
    assert 0 < available() <= limit()
