"""The commands as calls: one declaration of each option, the same values, errors and results."""

from __future__ import annotations

import argparse
import inspect
import json
import re
from dataclasses import fields
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import scenec
from scenec.api import make, measure, options, outputs
from scenec.api.check import CheckReport
from scenec.api.declare import Spread, declared
from scenec.api.sweep import _lists
from scenec.backends.check.compare import Agreement, Comparison
from scenec.backends.run.plan import RenderPlan
from scenec.cli.main import main, parser
from scenec.compiler.cfg import builder
from scenec.compiler.compile import FAULTS
from scenec.compiler.views.needed import Keep
from scenec.datasets import verify
from scenec.schemas.errors import ScenecError, StageError
from scenec.testing.small import small_cfg, write_cfg

RECORDS = {
    "compile": options.CompileOptions, "render": options.RenderOptions, "scan": options.ScanOptions,
    "run": options.RunOptions, "sweep": options.SweepOptions, "check": options.CheckOptions,
    "export": options.ExportOptions, "evaluate": options.EvaluateOptions,
    "view": options.ViewOptions, "preview": options.PreviewOptions,
    "converge": measure.ConvergeOptions, "ladder": measure.LadderOptions,
    "settle_objects": make.SettleOptions, "import_scene": make.ImportOptions,
}  # fmt: skip
#: Of the command line alone: where it prints to, how much, in a window or not.
OF_COMMANDS = {
    "help", "json", "verbose", "out", "cfg", "format", "list", "predictions", "open",
    "watch", "rerun", "rerun_save", "port", "no_browser", "once", "source", "output", "report",
    "why", "ladder", "csv", "plot",
}  # fmt: skip
#: Where a call is named otherwise than its command.
COMMANDS = {"import_scene": "import", "settle_objects": "settle", "ladder": "explain"}


def actions(command: str) -> dict[str, argparse.Action]:
    found = (a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    own = next(found).choices[command]._actions
    # The first of a name is the option; further ones are other words for a value of it.
    return {action.dest: action for action in reversed(own)}


@pytest.mark.parametrize("name", RECORDS)
def test_a_call_takes_the_options_of_its_command_with_the_same_defaults(name):
    record, there = RECORDS[name], actions(COMMANDS.get(name, name))
    known = {field.name: field.default for field in fields(record)}
    assert set(declared(record)) <= set(there)
    further = set(there) - set(known) - OF_COMMANDS
    assert further <= ({"against"} if name == "evaluate" else set())
    for dest in set(there) & set(known):
        assert (there[dest].default or None) == (known[dest] or None), dest
    keywords = inspect.signature(getattr(scenec, name)).parameters
    assert set(known) <= set(keywords)


def test_a_call_says_its_options_as_the_command_does():
    text = " ".join((scenec.render.__doc__ or "").split())
    said = (action.help for action in actions("render").values() if action.dest == "device")
    assert f"device: {next(said)}" in text


def test_what_is_named_again_so_that_nothing_is_imported_is_the_same():
    assert options.FAULTS == FAULTS
    keep = declared(options.CompileOptions)["keep"]
    assert set(keep.metadata["choices"]) == {str(one.value) for one in Keep}
    plan = {field.name: field.default for field in fields(RenderPlan) if field.name != "backend"}
    ours = {field.name: field.default for field in fields(options.RenderOptions)}
    assert plan.items() <= ours.items()


@pytest.mark.parametrize(
    ("record", "name", "value", "words"),
    [
        (options.RenderOptions, "spp", 0, ["render", "OUT", "--spp", "0"]),
        (options.RenderOptions, "error", -1.0, ["render", "OUT", "--error=-1.0"]),
        (options.RenderOptions, "passes", "dept", ["render", "OUT", "--passes", "dept"]),
        (options.CompileOptions, "seed", 2**64, ["compile", "A", "-o", "B", "--seed", f"{2**64}"]),
    ],
)
def test_a_value_is_refused_in_the_words_of_the_command_line(record, name, value, words, capsys):
    with pytest.raises(ScenecError) as caught:
        record(**{name: value})
    with pytest.raises(SystemExit):
        main(words)
    assert str(caught.value).removeprefix(f"{name}: ") in capsys.readouterr().err


def test_an_option_that_is_a_text_is_read_as_the_command_line_reads_it():
    asked = options.RenderOptions(samples="0:3", passes="rgb,depth")  # type: ignore[arg-type]
    assert (asked.samples, asked.passes) == (range(3), ("rgb", "depth"))
    with pytest.raises(ScenecError, match="keep: 'sen': expected one of seen, unpruned, all"):
        options.CompileOptions(keep="sen")


def test_one_value_stands_for_a_list_of_one():
    asked = options.RunOptions(settings="a.b=1", samples=3)  # type: ignore[arg-type]
    assert (asked.settings, asked.samples) == (("a.b=1",), range(3, 4))
    assert options.ExportOptions(keep="area>=40").keep == ("area>=40",)


def test_an_array_of_samples_is_taken_as_it_is():
    samples = np.arange(3)
    assert options.RenderOptions(samples=samples).samples is samples  # type: ignore[arg-type]


def test_fields_that_are_no_option_are_read_as_texts_too():
    assert options.RenderOptions(cameras="eye").cameras == ["eye"]
    preview = options.PreviewOptions(settings="a.b=1", seed="7")  # type: ignore[arg-type]
    assert (preview.settings, preview.seed) == (("a.b=1",), 7)
    with pytest.raises(ScenecError, match="seed: '-1': expected a whole number"):
        options.PreviewOptions(seed=-1)


@pytest.mark.parametrize("record", RECORDS.values())
def test_none_stands_for_the_default_of_any_field(record):
    usual = record()
    assert vars(record(**dict.fromkeys(vars(usual)))) == vars(usual)


CALLS = [name for name in scenec.__all__ if not inspect.isclass(getattr(scenec, name))]


@pytest.mark.parametrize("name", CALLS)
def test_a_value_of_another_type_is_refused_by_its_name(name):
    call = getattr(scenec, name)
    parameters = inspect.signature(call).parameters
    needed = {p.name: "no_such" for p in parameters.values() if p.default is p.empty}
    for argument, wrong in product(parameters, (object(), b"3", [object()], 0.5j)):
        with pytest.raises(ScenecError, match=rf"^{argument}: .*expected"):
            call(**needed | {argument: wrong})


@pytest.mark.parametrize("call", [scenec.export, scenec.evaluate, scenec.compile])
def test_arguments_are_given_by_place_or_by_name(call, tmp_path):
    first, second = list(inspect.signature(call).parameters)[:2]
    values = {first: tmp_path / "none.json", second: "tum"}
    faults = []
    for args, given in (
        (tuple(values.values()), {}),
        ((values[first],), {second: values[second]}),
        ((), values),
    ):
        with pytest.raises(ScenecError) as caught:
            call(*args, **given)
        faults.append(str(caught.value))
    assert len(set(faults)) == 1
    for args, given in (((), {second: "tum"}), (("a", "b", "c"), {}), (("a", "b"), {first: "a"})):
        with pytest.raises(TypeError):
            call(*args, **given)


@pytest.mark.parametrize("kind", [scenec.OutputFolder, scenec.StageView.of])
def test_an_output_and_a_stage_are_named_by_paths(kind):
    with pytest.raises(ScenecError, match=r"^path: 3: expected a path$"):
        kind(3)


@pytest.mark.parametrize(
    ("cfg", "why"),
    [(3, "3: expected a file, a dict"), (None, "None: expected"), ({"a": {1}}, "set")],
)
def test_what_is_no_cfg_is_refused_by_its_name(cfg, why, tmp_path):
    for call in (scenec.compile, scenec.run, scenec.sweep):
        with pytest.raises(ScenecError, match=f"^cfg: .*{why}"):
            call(cfg, tmp_path / "out")
    with pytest.raises(ScenecError, match=f"^cfg: .*{why}"):
        scenec.preview(cfg)


def test_seeds_of_an_array_are_seeds():
    assert json.dumps(options.SweepOptions(seeds=np.arange(2)).seeds) == "[0, 1]"  # type: ignore[arg-type]
    for seeds, wrong in (([0.5], "0.5"), (range(-1, 3), "'-1'")):
        with pytest.raises(ScenecError, match=f"seeds: {wrong}: expected a whole number"):
            options.SweepOptions(seeds=seeds)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("record", "wrong", "why"),
    [
        (options.RenderOptions, {"spp": [1, 2]}, r"spp: \[1, 2\]: expected a whole number"),
        (options.RenderOptions, {"backend": ["mitsuba"]}, "backend: .*: expected a str"),
        (options.CompileOptions, {"cache": 3}, "cache: 3: expected a bool or a path"),
    ],
)
def test_one_value_is_no_list_and_a_path_no_number(record, wrong, why):
    with pytest.raises(ScenecError, match=why):
        record(**wrong)


def test_faults_of_a_cfg_in_no_file_have_no_lines(tmp_path):
    cfg = small_cfg(samples=1)
    cfg["terrain"]["spacng_m"] = 1
    with pytest.raises(ScenecError, match=r"^cfg: /terrain/spacng_m: unknown key"):
        scenec.compile(cfg, tmp_path / "out")
    with pytest.raises(ScenecError, match=r"^cfg: /terrain/spacng_m: unknown key"):
        scenec.sweep(cfg, tmp_path / "sweep", seeds=[1, 2])


def test_numbers_and_arrays_of_numpy_are_values_of_a_cfg(tmp_path):
    cfg = small_cfg(samples=1, outputs=["depth"])
    scenec.compile(cfg, tmp_path / "plain", seed=1)
    size = np.array(cfg["terrain"]["size_m"])
    of_numpy = {**cfg, "samples": np.int64(1), "terrain": {**cfg["terrain"], "size_m": size}}
    scenec.compile(of_numpy, tmp_path / "numpy", seed=1)
    stage = "batch_0000/stage.usda"
    assert (tmp_path / "numpy" / stage).read_bytes() == (tmp_path / "plain" / stage).read_bytes()


def test_batches_that_are_compiled_are_a_range():
    with pytest.raises(ScenecError, match=r"batches: \[0, 2\]: expected a range, A:B"):
        options.CompileOptions(batches=[0, 2])  # type: ignore[arg-type]


def test_arguments_that_are_missing_are_named():
    with pytest.raises(TypeError, match="'out'"):
        scenec.compile("cfg.json")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="'out'"):
        scenec.render(spp=4)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="has no argument 'sed'; did you mean"):
        scenec.compile("cfg.json", "OUT", sed=1)  # type: ignore[call-arg]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calls")
    cfg = small_cfg(samples=2, outputs=["label", "instance", "depth"])
    made = scenec.run(cfg, folder / "out", seed=3, workers=0)
    assert made.compiled is not None
    assert made.compiled.batches == (0,)
    assert made.rendered is not None
    assert made.rendered.rendered == 2
    return folder / "out"


def test_a_call_makes_what_its_command_makes(out, tmp_path):
    cfg = write_cfg(tmp_path, small_cfg(samples=2, outputs=["label", "instance", "depth"]))
    assert main(["compile", str(cfg), "--seed", "3", "-o", str(tmp_path / "out")]) == 0
    stages = list((tmp_path / "out" / "batch_0000").glob("*.usd?"))
    assert len(stages) > 3
    for stage in stages:
        assert (out / "batch_0000" / stage.name).read_bytes() == stage.read_bytes()


def test_frames_are_read_when_they_are_looked_at(out):
    frames = scenec.open_frames(out)
    assert ["loaded" in vars(frame) for frame in frames] == [False, False]
    assert frames[1]["depth"].shape == frames[1]["label.class"].shape
    assert ["loaded" in vars(frame) for frame in frames] == [False, True]


def test_answers_print_and_show_what_the_command_prints(out, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["explain", str(out), "--why", "rocks/1"]) == 0
    answer = scenec.why(out, "rocks/1")
    assert str(answer) == capsys.readouterr().out.strip()
    assert answer._repr_html_().startswith("<pre>rocks/1 ")
    found = scenec.explain(out)
    assert main(["explain", str(out)]) == 0
    assert str(found) == capsys.readouterr().out.strip()
    assert "left out" in found._repr_html_()


def test_a_message_names_an_option_as_its_caller_does(out, tmp_path, capsys):
    truth, given = tmp_path / "truth.txt", tmp_path / "given.txt"
    truth.touch()
    given.touch()
    with pytest.raises(ScenecError, match=r"^max_detections: is about instances.*\(task\)$"):
        scenec.evaluate(given, truth, max_detections=3)
    words = ["evaluate", str(given), "--against", str(truth), "--max-detections", "3"]
    assert main(words) == 2
    assert "--max-detections: is about instances" in capsys.readouterr().err
    scenec.render(out, backend="annotation", passes="depth", folder=tmp_path, workers=0)
    again = {"backend": "annotation", "passes": "normal", "folder": tmp_path, "workers": 0}
    with pytest.raises(ScenecError, match=r"; replace renders it again"):
        scenec.render(out, **again)
    with pytest.raises(ScenecError, match=r"; replace renders it again"):
        scenec.OutputFolder(out).render(**again)
    with pytest.raises(ScenecError, match=r"^settings 'a': expected NAME=VALUE"):
        scenec.export(out, "coco", settings="a", workers=0)


def test_a_listener_hears_of_options_as_their_caller_names_them():
    class Noting(scenec.Listener):
        """Counts what it hears, and keeps it."""

        lines = ()

        def say(self, line: str) -> None:
            """Keeps a line."""
            self.lines += (line,)

    @Spread(options.RenderOptions).one
    def warned(out: str, options: options.RenderOptions) -> None:
        options.listener.warn(f"{out}: --noise-seed or --replace, not --other")

    heard, flagged = Noting(), Noting()
    flagged.flags = True
    warned("a", listener=heard)
    warned("a", listener=flagged)
    assert heard.lines == ("warning: a: noise_seed or replace, not --other",)
    assert flagged.lines == ("warning: a: --noise-seed or --replace, not --other",)


def test_no_batch_is_no_stage_to_render(out):
    with pytest.raises(StageError, match="no batch is asked for"):
        scenec.render(out, backend="annotation", batches=[], workers=0)


def test_frames_go_to_a_folder_that_is_named_by_a_text(out, tmp_path):
    made = scenec.render(
        out, backend="annotation", samples=np.arange(2), folder=str(tmp_path), workers=0
    )
    assert made.rendered is not None
    assert made.rendered.rendered == 2
    assert len(list(tmp_path.glob("frames/annotation/*/*.exr"))) == 2


def test_a_check_tells_a_sound_output_from_a_damaged_one(out, tmp_path):
    cfg = small_cfg(samples=1, outputs=["depth"])
    made = Path(scenec.compile(cfg, tmp_path / "out").path)
    assert scenec.check(made).errors == scenec.check(out).errors == 0
    next(iter(made.glob("batch_0000/*.usdc"))).write_bytes(b"")
    damaged = scenec.check(made)
    assert damaged.errors > 0
    assert not damaged.sound


def test_an_output_renders_itself_as_the_call_does(out, monkeypatch):
    asked, lost = [], SimpleNamespace(failed=["batch_0000/eye/000000: out of memory"])

    def note(_: object, options: object) -> object:
        asked.append(options)
        return lost

    monkeypatch.setattr(outputs, "render_output", note)
    assert scenec.OutputFolder(out).render().rendered is lost
    scenec.OutputFolder(out).render("annotation", workers=0)
    assert asked == [
        options.RenderOptions(),
        options.RenderOptions(backend="annotation", workers=0),
    ]


def test_a_check_that_is_not_sound_says_why(out, capsys):
    exact = Agreement((Comparison("depth", "mitsuba", 64, 3),), (), {}, 2)
    found = CheckReport(exact=exact)
    assert not found.sound
    assert "annotation of 2 frames" in str(found)
    assert re.search(r"mitsuba +depth +3 +64$", str(found), re.MULTILINE)
    other = CheckReport(compared=verify.Comparison(2, ["batch_0000/eye/000000"]), is_dataset=True)
    assert not other.sound
    assert str(other).endswith("\nnot the same dataset")
    assert main(["check", str(out), "--exact"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(str(scenec.check(out, exact=True)) + "\n")


def test_a_check_of_a_dataset_tells_its_flaws(out, tmp_path, capsys):
    folder = tmp_path / "coco"
    scenec.export(out, "coco", folder=folder, workers=0)
    assert scenec.check(folder, against=folder).as_json()["against"]["same"]
    next(iter(folder.rglob("*.json"))).write_text("{}")
    found = scenec.check(folder)
    assert found.as_json()["flaws"]
    assert main(["check", str(folder), "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == found.as_json()


def test_a_listener_hears_what_is_done(tmp_path):
    class Noting(scenec.Listener):
        """Keeps what it hears."""

        def __init__(self) -> None:
            self.lines: list[str] = []

        def say(self, line: str) -> None:
            """Keeps a line."""
            self.lines.append(line)

        def compiled(self, report: object, cache: object) -> None:
            """Keeps that it was told."""
            self.lines.append(type(report).__name__)

    heard = Noting()
    cfg = small_cfg(samples=1, outputs=["depth"])
    scenec.compile(cfg, tmp_path / "out", listener=heard)
    assert heard.lines[-1] == "CompileReport"


@pytest.mark.usefixtures("worker_here")
def test_a_sweep_of_values_is_that_of_their_texts(tmp_path):
    cfg = small_cfg(samples=1)
    cfg["terrain"]["spacing_m"] = 0.5
    path = write_cfg(tmp_path, cfg)
    table = scenec.sweep(
        path, tmp_path / "a", values={"objects.rocks.count": [3, 4]}, compile_only=True
    )
    words = ["sweep", str(path), "--set", "objects.rocks.count=3,4", "--compile-only"]
    assert main([*words, "-o", str(tmp_path / "b")]) == 0
    assert [made.name for made in table.made] == ["count=3", "count=4"]
    assert (tmp_path / "a/sweep.csv").read_bytes() == (tmp_path / "b/sweep.csv").read_bytes()
    assert table._repr_html_().count("<tr>") == 3
    for i, given in enumerate((cfg, builder.read(path))):
        scenec.sweep(given, tmp_path / f"{i}", values=words[3], compile_only=True)
        assert (tmp_path / f"{i}/sweep.csv").read_bytes() == (tmp_path / "a/sweep.csv").read_bytes()


def test_values_of_a_sweep_are_json_and_one_stands_for_a_list_of_one():
    lists = _lists({"a": "low", "b": 3, "c": np.linspace(0, 1, 3), "d": [[1, 2]]})
    assert lists == ['a="low"', "b=3", "c=0.0,0.5,1.0", "d=[1, 2]"]
    with pytest.raises(ScenecError, match=r"values: a: .*set"):
        _lists({"a": [{1}]})
