"""What a terminal gets shows the picture again when the escape sequences are taken apart."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

from scenec.datasets.terminal import protocol_of, shown


@pytest.fixture
def picture():
    rng = np.random.default_rng(3)
    return Image.fromarray(rng.integers(0, 256, (60, 80, 3), dtype=np.uint8))


def same(data: bytes, picture: Image.Image) -> bool:
    return bool((np.asarray(Image.open(io.BytesIO(data))) == np.asarray(picture)).all())


def test_kittys_chunks_join_to_the_png_and_only_the_last_ends_it(picture):
    text = shown(picture, "kitty", 100)
    found = re.fullmatch(r"((?:\x1b_G[^\x1b]*\x1b\\)+)\n", text)
    parts = re.findall(r"\x1b_G([^;]*);([A-Za-z0-9+/=]*)\x1b\\", found.group(1))
    assert len(parts) > 2
    keys = dict(pair.split("=") for pair in parts[0][0].split(","))
    assert keys == {"a": "T", "f": "100", "c": "100", "q": "2", "m": "1"}
    assert [head for head, _ in parts[1:]] == ["m=1"] * (len(parts) - 2) + ["m=0"]
    assert all(len(data) <= 4096 for _, data in parts)
    assert all(len(data) % 4 == 0 for _, data in parts)
    assert same(base64.b64decode("".join(data for _, data in parts)), picture)


def test_iterms_file_is_the_png_with_its_size(picture):
    text = shown(picture, "iterm2", 100)
    head, data = re.fullmatch(r"\x1b\]1337;File=([^:]*):([^\x07]*)\x07\n", text).groups()
    keys = dict(pair.split("=") for pair in head.split(";"))
    png = base64.b64decode(data)
    assert keys["inline"] == "1"
    assert int(keys["size"]) == len(png)
    assert same(png, picture)


@pytest.mark.parametrize("size", [(80, 60), (7, 5), (1, 1), (300, 40)])
def test_half_blocks_carry_the_colors_of_the_picture_shrunk(size):
    rng = np.random.default_rng(4)
    picture = Image.fromarray(rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8))
    lines = shown(picture, "blocks", 40).rstrip("\n").split("\n")
    width = min(40, size[0])
    cell = re.compile(r"\x1b\[38;2;(\d+);(\d+);(\d+);48;2;(\d+);(\d+);(\d+)m▀")
    rows = []
    for line in lines:
        assert line.endswith("\x1b[0m")
        cells = np.array(cell.findall(line), int)
        assert len(cells) == width
        assert cell.sub("", line) == "\x1b[0m"
        rows += [cells[:, :3], cells[:, 3:]]
    wanted = picture.resize((width, len(rows)), Image.Resampling.BOX)
    assert (np.array(rows) == np.asarray(wanted)).all()
    assert abs(len(rows) - size[1] * width / size[0]) <= 2


@pytest.mark.parametrize(
    ("environment", "protocol"),
    [
        ({"TERM": "xterm-kitty"}, "kitty"),
        ({"TERM": "xterm-256color", "KITTY_WINDOW_ID": "1"}, "kitty"),
        ({"TERM_PROGRAM": "ghostty"}, "kitty"),
        ({"TERM_PROGRAM": "WezTerm"}, "kitty"),
        ({"TERM_PROGRAM": "iTerm.app"}, "iterm2"),
        ({"LC_TERMINAL": "iTerm2"}, "iterm2"),
        ({"TERM": "xterm-kitty", "TMUX": "/tmp/tmux-0/default"}, None),
        ({"TERM": "xterm-256color"}, None),
        ({}, None),
    ],
)
def test_a_terminal_is_known_by_what_it_says_of_itself(environment, protocol):
    assert protocol_of(environment) == protocol
