"""Progress: a bar on a terminal, lines elsewhere; speed and time left from the last steps."""

from __future__ import annotations

import io
import re

import pytest

from scenec.backends.run.render import RenderReport
from scenec.cli import output
from scenec.cli.main import main
from scenec.cli.output import Progress, say
from scenec.cli.terminal import Terminal as Listening


class Terminal(io.StringIO):
    """Standard error that says it is a terminal."""

    def isatty(self) -> bool:
        """It is."""
        return True


class Clock:
    """A clock that tests turn."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        """Seconds."""
        return self.now


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(output.time, "perf_counter", made.perf_counter)
    return made


def test_lines_say_speed_and_time_left(clock, capsys):
    progress = Progress("frame")
    for done in (1, 2, 3):
        clock.now += 0.5
        progress(done, 11, f"number {done}")
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == "frame 3/11, 2 frames/s, 4 s left: number 3"


def test_slow_steps_are_told_in_seconds_each(clock, capsys):
    progress = Progress("compiled", unit="batch", units="batches")
    clock.now += 200.0
    progress(1, 3, "batch_0000")
    assert "200 s a batch, 6:40 min left" in capsys.readouterr().err


def test_what_was_there_before_the_first_report_is_not_speed(clock, capsys):
    progress = Progress("exported", unit="step")
    for done in (901, 902, 903):
        assert "left" not in capsys.readouterr().err
        clock.now += 1.0
        progress(done, 1000, "x")
    assert "1 steps/s, 97 s left" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("folders", "told"),
    [
        (["batch_0000/frames/m/rover_left"], "batch_0000/frames/m/rover_left/"),
        (["b_0/frames/m/rover_left", "b_1/frames/m/rover_right"], "b_*/frames/m/rover_*/"),
        (["b_0/frames/m/rover_left", "b_0/frames/m/uav_down"], "b_0/frames/m/*/"),
    ],
)
def test_all_folders_of_frames_are_named(folders, told, tmp_path, capsys):
    for folder in folders:
        (tmp_path / folder).mkdir(parents=True)
    stems = [tmp_path / folder / f"{sample:06d}" for folder in folders for sample in range(2)]
    Listening().rendered(RenderReport(stems=stems, made=len(stems)))
    assert capsys.readouterr().err == f"{len(stems)} frames rendered: {tmp_path}/{told}\n"


def test_what_is_there_already_is_no_speed(clock, capsys):
    progress = Progress("frame")
    clock.now += 9.0
    for done in range(1, 11):
        progress(done, 20, f"batch_0000/rover/{done:06d}: there already")
    for done in range(11, 14):
        assert "left" not in capsys.readouterr().err
        clock.now += 2.0
        progress(done, 20, "rendered")
    assert "frame 13/20, 2 s a frame, 14 s left: rendered" in capsys.readouterr().err


def test_speed_follows_a_change_of_speed(clock, capsys):
    progress = Progress("frame")
    for done in range(1, 101):
        clock.now += 0.001
        progress(done, 1000, "there already")
    for done in range(101, 141):
        clock.now += 10.0
        progress(done, 1000, "rendered")
    assert "10 s a frame, 2:23 h left" in capsys.readouterr().err


def test_a_terminal_gets_one_line_that_fills_up(clock, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    progress = Progress("frame")
    for done in (1, 2, 3, 4):
        clock.now += 1.0
        progress(done, 4, f"name {done}")
    drawn = terminal.getvalue().split("\r")[1:]
    assert [re.sub(r"[^█]", "", line) for line in drawn] == ["█" * n for n in (6, 12, 18, 24)]
    assert terminal.getvalue().count("\n") == 1
    assert terminal.getvalue().endswith("\n")


def test_a_line_amid_a_bar_takes_the_bars_place(clock, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    progress = Progress("frame")
    clock.now += 1.0
    progress(1, 4, "one")
    say("warning: a line")
    assert "\r\x1b[Kwarning: a line\n" in terminal.getvalue()
    say("another")
    assert terminal.getvalue().endswith("warning: a line\nanother\n")
    assert "\x1b[K" not in terminal.getvalue().split("a line\n")[1]


def test_steps_between_are_shown_on_a_terminal_and_once_a_second_elsewhere(
    clock, monkeypatch, capsys
):
    progress = Progress("compiled")
    progress.now(0, 2, "relief")
    assert capsys.readouterr().err == ""
    clock.now += 1.5
    progress.now(0, 2, "objects")
    progress.now(0, 2, "ground")
    assert capsys.readouterr().err == "objects\n"
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    Progress("compiled").now(0, 2, "relief")
    assert "0/2: relief" in terminal.getvalue()
    say("done")


def test_many_quick_steps_are_told_now_and_then(clock, capsys):
    progress = Progress("exported", unit="step", every_s=2.0)
    for done in range(1, 101):
        clock.now += 0.1
        progress(done, 100, "x")
    told = [int(line.split()[1].split("/")[0]) for line in capsys.readouterr().err.splitlines()]
    assert told[0] == 1
    assert told[-1] == 100
    assert len(told) <= 7


def test_a_status_is_on_a_terminal_alone_and_goes_before_the_next_line(monkeypatch, capsys):
    output.status("reading a.json")
    assert capsys.readouterr().err == ""
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    output.status("reading a.json")
    assert terminal.getvalue() == "\rreading a.json"
    assert main(["compile", "none.json", "--seed", "1", "-o", "OUT"]) == 2
    assert "\r\x1b[Knone.json:1:1: /: No such file or directory\n" in terminal.getvalue()


def test_lines_are_ten_seconds_apart_unless_each_is_asked_for(clock, capsys):
    for verbose, told in ((False, [1, 81, 161, 200]), (True, [*range(1, 201)])):
        progress = Listening(verbose).steps("frame")
        for done in range(1, 201):
            clock.now += 0.125
            progress(done, 200, "x")
        lines = capsys.readouterr().err.splitlines()
        assert [int(line.split()[1].split("/")[0]) for line in lines] == told
