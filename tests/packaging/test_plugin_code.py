"""Code of other packages: what it makes depends on it, and its exceptions name file and line."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from scenec.backends.annotation.registry import find_pass
from scenec.backends.run.executors import make_executor
from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.kinds import schema
from scenec.compiler.output import held
from scenec.compiler.views.needed import Keep
from scenec.datasets.export import export
from scenec.datasets.formats.registry import find_format
from scenec.schemas import plugins
from scenec.schemas.errors import OutputError, PluginError, SceneError
from scenec.testing.small import small_cfg, write_cfg

SOURCE = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from scenec.backends.annotation.contract import Pass
from scenec.backends.annotation.passes import position
from scenec.backends.contract import Radiance
from scenec.datasets.formats.contract import Format, Written

@dataclass(frozen=True)
class Lift:
    SCHEMA: ClassVar = {"properties": {}}
    def apply(self, grid, height):
        return height + 0.5, {}

def up(view):
    return 7.0 * view.once(position)[:, 2]

UP = Pass(name="up", channels=("z",), convention="world z, m", compute=up)

class Lines(Format):
    name = "lines"
    summary = "a line a frame"
    needs = ("depth",)
    def write(self, task, frames, folder, scratch):
        written = Written()
        for frame in frames:
            name = f"{frame.ref.key}.txt"
            (folder / name).write_text("one\\n")
            written.files.append(name)
        return written
    def finish(self, done, folder, scratch):
        return []

class Glow:
    name = "glow"
    devices = ("cpu",)
    denoiser = None
    stochastic = False
    device = "cpu"
    def __init__(self, device="auto"):
        pass
    def version(self):
        return "glow 1"
    def warning(self):
        return None
    def losses(self, scene):
        return ()
    def load(self, scene):
        pass
    def radiance(self, camera, sample, spp, seed, denoise=False):
        shape = (camera.height, camera.width)
        halves = np.ones((2, *shape, 3), np.float32)
        return Radiance(halves, np.ones(shape, np.float32), spp, stochastic=False)
"""
POINTS = {
    "scenec.relief": "lift = odd:Lift",
    "scenec.passes": "up = odd:UP",
    "scenec.exporters": "lines = odd:Lines",
    "scenec.backends": "glow = odd:Glow",
}


class Package:
    """A package that this process and its workers find."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, name: str = "odd") -> None:
        self.file = folder / f"{name}.py"
        self._patch = monkeypatch
        info = folder / f"{name}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        points = "\n".join(f"[{group}]\n{line}" for group, line in POINTS.items())
        (info / "entry_points.txt").write_text(points)
        monkeypatch.syspath_prepend(str(folder))
        monkeypatch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        self.write(SOURCE)

    def write(self, source: str) -> None:
        """Its code; as a process sees it that starts now."""
        self.file.write_text(source)
        self._patch.delitem(sys.modules, self.file.stem, raising=False)
        # Compiled code of the same second and size counts as that of this source.
        shutil.rmtree(self.file.parent / "__pycache__", ignore_errors=True)
        self._patch.setattr(plugins, "_codes", {})
        plugins.load_kind.cache_clear()
        schema.kind_schema.cache_clear()

    def edit(self, old: str, new: str) -> None:
        """Its code with another part."""
        assert old in SOURCE
        self.write(SOURCE.replace(old, new))

    def line(self, text: str) -> int:
        """The line of its code that holds a text."""
        lines = self.file.read_text().splitlines()
        return next(i for i, line in enumerate(lines, 1) if text in line)


@pytest.fixture
def odd(tmp_path, monkeypatch):
    return Package(tmp_path / "site", monkeypatch)


def test_modules_of_an_editable_install_count_though_none_of_its_files_came_with_it(
    odd, tmp_path, monkeypatch
):
    beside = tmp_path / "source" / "odd_numbers.py"
    beside.parent.mkdir()
    beside.write_text("K = 1\n")
    monkeypatch.syspath_prepend(str(beside.parent))
    (tmp_path / "site" / "odd-1.0.dist-info" / "top_level.txt").write_text("odd\nodd_numbers\n")
    odd.write(SOURCE)
    before = plugins.origin("scenec.relief", "lift")
    assert "(code " in before
    beside.write_text("K = 2\n")
    odd.write(SOURCE)
    assert plugins.origin("scenec.relief", "lift") != before


def cfg(folder: Path, **changes: Any) -> Path:
    document = small_cfg(samples=1, outputs=["depth", "up"], **changes)
    document["terrain"] |= {"relief": [{"type": "plane"}, {"type": "lift"}], "spacing_m": 2.0}
    document["objects"]["rocks"]["count"] = 3
    document["rigs"]["rover"]["sensors"] = {"a": {"resolution": [8, 6], "fov_deg": 70}}
    return write_cfg(folder, document)


@pytest.fixture
def out(odd, tmp_path):
    compile_cfg(cfg(tmp_path), seed=1, out=tmp_path / "out")
    return tmp_path / "out"


def test_an_origin_states_package_version_and_code(odd):
    first = plugins.origin("scenec.passes", "up")
    assert first.startswith("odd 1.0 (code ")
    assert "odd" not in sys.modules
    odd.edit("7.0", "8.0")
    second = plugins.origin("scenec.passes", "up")
    assert second.startswith("odd 1.0 (code ")
    assert second != first
    odd.write(SOURCE)
    assert plugins.origin("scenec.passes", "up") == first


def test_code_is_the_whole_package_behind_a_module_and_none_of_its_byte_code(tmp_path, monkeypatch):
    made = Package(tmp_path / "site", monkeypatch)
    folder = made.file.with_suffix("")
    folder.mkdir()
    made.file.rename(folder / "__init__.py")
    made.file = folder / "table.csv"
    found = set()
    for content in ("1", "2"):
        made.write(content)
        found.add(plugins.origin("scenec.passes", "up"))
        (folder / "__pycache__").mkdir(exist_ok=True)
        (folder / "__pycache__" / "a.pyc").write_text(content)
        (folder / ".notes").write_text(content)
    assert len(found) == 2
    made.write("1")
    assert plugins.origin("scenec.passes", "up") in found


@pytest.mark.usefixtures("worker_here")
def test_frames_of_edited_passes_and_backends_are_made_again(odd, out):
    def made(backend: str, *passes: str) -> tuple[int, int]:
        report = render(out, backend, passes=passes, spp=1)
        return report.rendered, report.skipped

    assert made("annotation", "up", "depth") == (1, 0)
    assert made("glow", "rgb") == (1, 0)
    odd.edit("7.0", "8.0")
    assert made("annotation", "up", "depth") == (1, 0)
    assert made("annotation", "up", "depth") == (0, 1)
    assert made("glow", "rgb") == (1, 0)
    assert made("glow", "rgb") == (0, 1)


@pytest.mark.usefixtures("worker_here")
def test_a_dataset_of_an_edited_format_is_made_again(odd, out, tmp_path):
    render(out, "annotation", passes=["depth"])
    data = tmp_path / "data"
    export(out, "lines", data)
    assert export(out, "lines", data).there
    odd.edit('"one', '"two')
    with pytest.raises(OutputError, match="holds another dataset"):
        export(out, "lines", data)
    export(out, "lines", data, replace=True)
    assert {path.read_text() for path in data.glob("*.txt")} == {"two\n"}
    assert json.loads((data / "export.json").read_text())["format_package"].startswith("odd 1.0 (")


def test_batches_of_an_edited_kind_are_of_another_cfg(odd, out, tmp_path):
    odd.edit("0.5", "0.7")
    there, other = held(out, load(cfg(tmp_path)), 1, Keep.SEEN)
    assert there == {0}
    assert other is not None
    assert other.startswith("made with odd 1.0 (code ")


MUTE = "raise type('Mute', (ValueError,), {'__str__': lambda self: 1 / 0})"


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("1 / 0", "ZeroDivisionError: .*"),
        ("raise GeneratorExit", "GeneratorExit"),
        (MUTE, "Mute"),
        *(
            pytest.param(*of, marks=pytest.mark.slow)
            for of in (
                ("np.zeros(2) + np.zeros(3)", "ValueError: .*"),
                ("raise SystemExit(3)", "SystemExit: 3"),
                ("raise type('Own', (BaseException,), {})('its own')", "Own: its own"),
                (MUTE.replace("1 / 0", "exec('raise GeneratorExit')"), "Mute"),
                (MUTE.replace("1 / 0", "None"), "Mute"),
            )
        ),
    ],
)
def test_an_exception_of_an_operator_names_its_file_and_line(fault, said, odd, tmp_path):
    odd.edit("return height + 0.5, {}", fault)
    told = rf"^plug-in odd: {said} \(odd.py, line {odd.line(fault)}\)$"
    with pytest.raises(SceneError, match=told):
        compile_cfg(cfg(tmp_path), seed=1, out=tmp_path / "out")
    with make_executor(1) as executor, pytest.raises(SceneError, match=told):
        compile_cfg(cfg(tmp_path), seed=1, out=tmp_path / "out", executor=executor)
    assert not (tmp_path / "out").exists()


def test_an_exception_of_a_format_is_told_once_in_a_worker_and_out_of_it(
    odd, out, tmp_path, capsys
):
    render(out, "annotation", passes=["depth"], executor=make_executor(0))
    odd.edit("(folder / name).write_text", "int('soil'); (folder / name).write_text")
    line = f"(odd.py, line {odd.line('soil')})"
    for workers in ("0", "1"):
        command = ["export", str(out), "--format", "lines", "--workers", workers]
        capsys.readouterr()
        assert main(command) == 2
        said = capsys.readouterr().err.splitlines()
        assert said[-1].startswith("scenec: ")
        assert said[-1].endswith(
            f"plug-in odd: ValueError: invalid literal for int() with base 10: 'soil' {line}"
        )
        assert sum("soil" in one for one in said) == 1
        assert not any("trying again" in one for one in said)
    odd.edit("return []", "return 1 / 0")
    with pytest.raises(
        PluginError, match=r"format 'lines': plug-in odd: ZeroDivisionError: .*line"
    ):
        export(out, "lines", tmp_path / "data")


def test_a_frame_that_a_backend_fails_at_is_given_up_after_one_try(odd, out):
    odd.edit("shape = (camera", "1 / 0; shape = (camera")
    with make_executor(1) as executor:
        report = render(out, "glow", passes=["rgb"], executor=executor)
    assert report.deaths == 0
    (line,) = report.failed
    assert line.endswith(f"ZeroDivisionError: division by zero (odd.py, line {odd.line('1 / 0')})")


@pytest.mark.parametrize(
    ("made", "told"),
    [
        ("height[:-1], {}", r"heights \[\d+, \d+\]: expected an array \[\d+, \d+\]"),
        ("height.astype('float32'), {}", "heights float32: expected finite ones, float64"),
        ("height * np.nan, {}", "heights that are not finite"),
        ("height", "ndarray: expected heights and a dict"),
        ("(height, {'a': object()})", "for report.json what JSON cannot hold"),
    ],
)
def test_what_an_operator_returns_is_held_against_its_contract(made, told, odd, tmp_path):
    odd.edit("height + 0.5, {}", made)
    with pytest.raises(SceneError, match=rf"\(odd:Lift of odd\): returned {told}"):
        compile_cfg(cfg(tmp_path), seed=1, out=tmp_path / "out")


def test_an_operator_reports_what_it_likes(odd, tmp_path, capsys):
    made = {"scale": [1, 2], "error_rms_m": 2.0, "error_aim_m": 1.0}
    odd.edit("height + 0.5, {}", f"height + 0.5, {made}")
    words = ["-o", str(tmp_path / "out"), "--workers", "0", "--no-cache"]
    assert main(["compile", str(cfg(tmp_path)), *words]) == 0
    assert "errs by" not in capsys.readouterr().err
    report = json.loads((tmp_path / "out/batch_0000/report.json").read_text())
    assert report["relief"][1] == {"type": "lift", **made}


def test_a_sound_package_works_beside_broken_ones(odd, tmp_path, monkeypatch):
    broken = Package(tmp_path / "other", monkeypatch, "broken")
    points = [line.replace("odd:", "broken:") for line in POINTS.values()]
    names = [line.replace(line.split()[0], f"x{line.split()[0]}") for line in points]
    lines = [f"[{group}]\n{line}" for group, line in zip(POINTS, names, strict=True)]
    info = tmp_path / "other" / "broken-1.0.dist-info" / "entry_points.txt"
    info.write_text("\n".join(lines))
    broken.write("raise RuntimeError('of its own')\n")
    plugins._offered.cache_clear()
    compile_cfg(cfg(tmp_path), seed=1, out=tmp_path / "out")
    assert find_pass("up").name == "up"
    assert find_format("lines").name == "lines"
    report = render(tmp_path / "out", "glow", passes=["rgb"], spp=1, executor=make_executor(0))
    assert report.rendered == 1
    # Named where it is used.
    with pytest.raises(
        OutputError, match=r"'xlines' \(broken:Lines of broken\): .*broken.py, line 1"
    ):
        find_format("xlines")
