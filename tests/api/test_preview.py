"""``scenec preview``: the page, and that it follows the file."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.parse
import urllib.request
from typing import Any

import numpy as np
import psutil
import pytest
from PIL import Image

from scenec.api.preview import PreviewState, _served, coarse, shaded
from scenec.cli.main import main
from scenec.compiler.cfg.load import load
from scenec.testing.small import small_cfg, write_cfg


def facts_in(page: str) -> dict[str, Any]:
    """What a page shows first."""
    return json.loads(re.search(r"^let facts = (.*);$", page, re.MULTILINE)[1])


def size_of(png: str) -> tuple[int, int]:
    return Image.open(io.BytesIO(base64.b64decode(png))).size


@pytest.mark.usefixtures("workers_here")
def test_once_writes_a_page_that_asks_nobody(tmp_path):
    cfg = small_cfg(samples=6)
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [96, 64]
    path = write_cfg(tmp_path, cfg)
    page = tmp_path / "page.html"
    words = ["preview", path, "--once", page, "--width", "48", "--spp", "1", "--no-cache"]
    assert main([str(word) for word in words]) == 0
    facts = facts_in(page.read_text())
    assert not facts["live"]
    assert facts["faults"] == []
    assert [p["sample"] for p in facts["pictures"]] == [0, 1, 3, 4]
    assert {size_of(p["png"]) for p in facts["pictures"]} == {(48, 32)}
    assert size_of(facts["map"])[0] > 100
    site = facts["site"]
    nx, ny = site["size"]
    # 20 m x 16 m, no finer than a fourteenth of the wheelbase: slope, class, heights.
    assert (nx, ny) == (200, 160)
    assert len(base64.b64decode(site["codes"])) == (1 + 1 + 2) * nx * ny
    assert "function siteOf" in page.read_text()
    assert "%FIRST%" not in page.read_text()


def test_large_pictures_alone_become_smaller(tmp_path):
    cfg = small_cfg(batches=3)
    sensors = cfg["rigs"]["rover"]["sensors"]
    sensors["wide"] = {"resolution": [1000, 500], "fov_deg": 90}
    given = {"fx": 900, "fy": 900, "cx": 500, "cy": 250}
    sensors["given"] = {"resolution": [1000, 500], "intrinsics": given}
    path = write_cfg(tmp_path, cfg)
    settings = coarse(load(path), 480)
    assert settings == ["batches=1", "rigs.rover.sensors.wide.resolution=[480, 240]"]
    made = load(path, settings).cfg
    assert made["batches"] == 1
    assert made["rigs"]["rover"]["sensors"]["wide"]["resolution"] == [480, 240]


def test_a_map_is_lit_from_the_northwest_with_north_up():
    y, x = np.mgrid[0:40, 0:60]
    hill = np.maximum(0.0, 10.0 - np.hypot(x - 30, y - 20))
    light = shaded(hill).sum(axis=-1).astype(float)
    assert light.shape == (40, 60)
    # Rows begin in the north.
    assert light[14, 24] > light[26, 36]
    assert not np.isnan(shaded(np.where(hill > 5, np.nan, hill)).astype(float)).any()


@pytest.mark.slow
def test_the_page_follows_the_file(tmp_path):
    path = write_cfg(tmp_path, small_cfg(samples=1))
    words = ["preview", str(path), "--no-browser", "--spp", "1", "--no-cache"]
    command = [sys.executable, "-m", "scenec.cli.main", *words]
    with (
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server,
        contextlib.ExitStack() as stack,
    ):
        # Before what waits for its end.
        stack.callback(server.kill)
        assert server.stderr is not None
        # A line before it says what draws.
        said = (re.search(r"http://127\.0\.0\.1:\d+/\S+/", line) for line in server.stderr)
        address = next(found[0] for found in said if found)

        def until(fits: Any) -> dict[str, Any]:
            facts = facts_in(urllib.request.urlopen(address).read().decode())
            while not fits(facts):
                asked = urllib.request.urlopen(f"{address}state?{facts['version']}")
                facts = json.loads(asked.read())
            return facts

        def drawn(facts: dict[str, Any]) -> bool:
            pictures = facts["pictures"]
            return bool(pictures) and not facts["doing"] and "sketch" not in pictures[0]

        first = until(drawn)
        text = path.read_text()
        path.write_text(text.replace('"count"', '"cuont"'))
        wrong = until(lambda facts: facts["faults"])
        assert any("did you mean" in line for line in wrong["faults"])
        assert wrong["pictures"] == first["pictures"]
        path.write_text(text.replace("300", "900"))
        again = until(lambda facts: not facts["faults"] and drawn(facts))
        assert again["pictures"] != first["pictures"]
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{address}etc/passwd")
        server.send_signal(signal.SIGINT)
        assert server.wait() == 130


def asked(address: str, host: str | None = None) -> tuple[int, str]:
    """Status and text of an answer to who calls the machine by this name."""
    headers = {} if host is None else {"Host": host}
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers)) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_the_page_answers_to_its_own_names_and_to_its_token_alone(capfd):
    state = PreviewState()
    state.set(doing="a secret")
    with _served(state, 0) as address:
        port = urllib.parse.urlsplit(address).port
        bare = f"http://127.0.0.1:{port}/"
        assert asked(address)[0] == asked(address, f"LocalHost:{port}")[0] == 200
        assert asked(f"{address}state?0")[0] == 200
        # Browsers leave port 80 out.
        assert asked(address, "localhost")[0] == 200
        strangers = ["evil.example", f"evil.example:{port}", f"127.0.0.1.evil.example:{port}", ""]
        strangers += [f"localhost:{port}@evil", f"localhost.evil:{port}"]
        for host in strangers:
            for place in ("", "state?0"):
                status, text = asked(address + place, host)
                assert status == 403
                assert "secret" not in text
        for place in ("", "state?0", "x/state?0", f"x{address.split('/')[3]}/", "//"):
            status, text = asked(bare + place)
            assert status == 403
            assert "secret" not in text
        for place in ("etc/passwd", "state", "state?", "state?-1", f"state?{'9' * 5000}"):
            assert asked(address + place)[0] == 404
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_preview_that_is_ended_leaves_no_folder(tmp_path, number):
    if signal.getsignal(number) == signal.SIG_IGN:
        pytest.skip("this signal is ignored here, as under nohup")
    path = write_cfg(tmp_path, small_cfg(samples=1))
    place = tmp_path / "tmp"
    place.mkdir()
    words = ["preview", str(path), "--no-browser", "--backend", "mitsuba"]
    with subprocess.Popen(
        [sys.executable, "-m", "scenec.cli.main", *words],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(place)},
    ) as server:
        assert server.stderr is not None
        assert "http://127.0.0.1:" in server.stderr.readline()
        assert [*place.glob("scenec-*")]
        # SIGKILL ends what does the work; who supervises it can only tidy up after that one.
        target = psutil.Process(server.pid).children()[0].pid if number == 9 else server.pid
        os.kill(target, number)
        server.wait()
    assert not [*place.iterdir()]
