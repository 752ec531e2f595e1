"""Pictures in a terminal: by the protocols of kitty and iTerm2, or as colored half blocks."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping

import numpy as np
from PIL import Image

#: Most base64 characters of one escape sequence of kitty's protocol.
_CHUNK = 4096
_KITTY_PROGRAMS = ("ghostty", "wezterm", "konsole")
_ITERM_PROGRAMS = ("iTerm.app", "mintty", "WarpTerminal", "vscode")
#: Terminals within terminals pass no pictures on unless asked in ways of their own.
_NESTED = ("TMUX", "STY", "ZELLIJ")


def protocol_of(environment: Mapping[str, str]) -> str | None:
    """The graphics protocol that a terminal is known to speak: ``kitty``, ``iterm2`` or None."""
    if any(environment.get(name) for name in _NESTED):
        return None
    term, program = environment.get("TERM", ""), environment.get("TERM_PROGRAM", "")
    if environment.get("KITTY_WINDOW_ID") or "kitty" in term or "ghostty" in term:
        return "kitty"
    if program.lower() in _KITTY_PROGRAMS or environment.get("KONSOLE_VERSION"):
        return "kitty"
    if program in _ITERM_PROGRAMS or environment.get("LC_TERMINAL") == "iTerm2":
        return "iterm2"
    return None


def shown(picture: Image.Image, protocol: str, columns: int) -> str:
    """The text that makes a terminal show a picture, as wide as the terminal at most.

    Args:
        picture: RGB.
        protocol: ``kitty``, ``iterm2`` or ``blocks``.
        columns: Width of the terminal in characters.
    """
    if protocol == "blocks":
        return _blocks(picture, columns)
    file = io.BytesIO()
    picture.save(file, format="PNG")
    data = file.getvalue()
    return _kitty(data, columns) if protocol == "kitty" else _iterm2(data)


def _kitty(png: bytes, columns: int) -> str:
    """a=T: transmit and show; f=100: PNG; m=1: more follows (kitty's graphics protocol)."""
    text = base64.b64encode(png).decode("ascii")
    parts = [text[i : i + _CHUNK] for i in range(0, len(text), _CHUNK)]
    out = []
    for number, part in enumerate(parts):
        keys = f"a=T,f=100,c={columns},q=2," if number == 0 else ""
        out.append(f"\x1b_G{keys}m={int(number < len(parts) - 1)};{part}\x1b\\")
    return "".join(out) + "\n"


def _iterm2(png: bytes) -> str:
    """OSC 1337, an inline file (iTerm2's inline images protocol)."""
    text = base64.b64encode(png).decode("ascii")
    return f"\x1b]1337;File=inline=1;size={len(png)};width=100%;preserveAspectRatio=1:{text}\x07\n"


def _blocks(picture: Image.Image, columns: int) -> str:
    """Two pixels a character: upper half block, its color above, the background's below."""
    width = max(1, min(columns, picture.width))
    height = max(2, round(picture.height * width / picture.width))
    height += height % 2
    small = picture.convert("RGB").resize((width, height), Image.Resampling.BOX)
    pixels = np.asarray(small)
    lines = []
    for upper, lower in zip(pixels[0::2].tolist(), pixels[1::2].tolist(), strict=True):
        cells = [
            f"\x1b[38;2;{a[0]};{a[1]};{a[2]};48;2;{b[0]};{b[1]};{b[2]}m▀"
            for a, b in zip(upper, lower, strict=True)
        ]
        lines.append("".join(cells) + "\x1b[0m")
    return "\n".join(lines) + "\n"
