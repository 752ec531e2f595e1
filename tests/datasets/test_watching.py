"""``scenec view --watch``: the page is written anew when the output has changed, and says so."""

from __future__ import annotations

import argparse
import json
import os
import re
from pathlib import Path

import pytest

from scenec.api.options import ViewOptions
from scenec.cli import view_command
from scenec.cli.main import parser
from scenec.datasets.view.page import write_view
from scenec.datasets.view.watching import sign_of, state_of
from scenec.testing import made_output


def passes(number: int) -> made_output.Passes:
    return made_output.some_passes(number, 24, 16)


@pytest.fixture
def out(tmp_path):
    return made_output.make_output(tmp_path / "out", passes, samples=2)


def options(out: Path, *words: str) -> argparse.Namespace:
    return parser().parse_args(["view", str(out), "--no-ground", "--workers", "1", *words])


def some_sidecar(out: Path) -> Path:
    return sorted(out.glob("batch_*/frames/*/*/*.json"))[0]


def state_in(page: Path) -> str:
    found = re.search(rb'<template id="index">(.*?)</template>', page.read_bytes(), re.DOTALL)
    assert found is not None
    state: str = json.loads(found[1])["watched"]
    return state


def test_the_state_is_that_of_sidecars_and_stages_alone(out):
    before = state_of(out)
    (out / "view.html").write_text("a page")
    (some_sidecar(out).parent / "notes.txt").write_text("mine")
    assert state_of(out) == before
    told = some_sidecar(out).stat()
    os.utime(some_sidecar(out), ns=(told.st_atime_ns, told.st_mtime_ns + 1))
    after = state_of(out)
    assert after != before
    some_sidecar(out).unlink()
    assert state_of(out) not in (before, after)


def test_a_page_that_nobody_watches_loads_no_script(out, tmp_path):
    write_view(out, tmp_path / "view.html")
    text = (tmp_path / "view.html").read_bytes()
    assert b"script-src 'unsafe-inline'" in text
    assert state_in(tmp_path / "view.html") == ""


def test_the_page_is_written_anew_once_the_output_is_at_rest(out, tmp_path):
    page = tmp_path / "view.html"
    seen: list[tuple[str, str]] = []

    def sleep(_: float) -> None:
        """Time passes: the frames go, come back as others, and at last somebody interrupts."""
        moment = len(seen)
        sign = sign_of(page).read_text() if sign_of(page).exists() else ""
        seen.append((state_in(page) if page.exists() else "", sign))
        if moment in (3, 4):
            told = some_sidecar(out).stat()
            os.utime(some_sidecar(out), ns=(told.st_atime_ns, told.st_mtime_ns + 10 + moment))
        if moment == 9:
            raise KeyboardInterrupt

    view_command.watch(out, ViewOptions(page=page, no_ground=True, workers=1), sleep=sleep)
    states = [state for state, _ in seen]
    # Not yet at rest when first looked at; two states in all, though it changed twice.
    assert states[0] == ""
    first, last = states[1], states[9]
    assert first
    assert last == state_of(out)
    assert [s for s in states[1:] if s not in (first, last)] == []
    assert first != last
    assert states.index(last) == 6
    assert all(state in sign for state, sign in seen[1:])
    assert not sign_of(page).exists()


def test_it_waits_for_frames_and_shows_them_when_they_come(out, tmp_path, capsys):
    page = tmp_path / "view.html"
    hidden = tmp_path / "hidden"
    folders = sorted(out.glob("batch_*/frames"))
    for number, folder in enumerate(folders):
        folder.rename(hidden.with_name(f"hidden_{number}"))
    moments = []

    def sleep(_: float) -> None:
        moments.append(page.exists())
        if len(moments) == 3:
            for number, folder in enumerate(folders):
                hidden.with_name(f"hidden_{number}").rename(folder)
        if len(moments) == 6:
            raise KeyboardInterrupt

    view_command.watch(out, ViewOptions(page=page, no_ground=True, workers=1), sleep=sleep)
    assert moments == [False] * 4 + [True] * 2
    assert "waiting: " in capsys.readouterr().err


def test_it_is_opened_once_in_a_browser(out, tmp_path, monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    page = tmp_path / "view.html"
    assert view_command.run(options(out, "--open", "-o", str(page))) == 0
    assert opened == [page.resolve().as_uri()]
