"""``scenec sheet``: one picture of all passes of some frames."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from pathlib import Path

from scenec.cli.output import say, say_next
from scenec.datasets.sheet import write_sheet
from scenec.schemas.errors import OutputError


def run(options: argparse.Namespace) -> int:
    """Writes the sheet and says where everything lies."""
    out = Path(options.out)
    folder = out if out.is_dir() else out.parent
    output = Path(options.output) if options.output else folder / "contact_sheet.png"
    if output.suffix.lower() != ".png":
        raise OutputError(f"{output}: the sheet is a PNG picture; end its name in .png")
    sheet = write_sheet(out, output, backend=options.backend, count=options.frames)
    for line in sheet.left_out:
        say(f"not shown: {line}")
    say(f"frames (EXR with all passes, PNG picture, JSON sidecar): {sheet.folder}/")
    print(f"contact sheet: {sheet.path}")
    _show(sheet.path, options.terminal)
    say_next(("view", out))
    return 0


def _show(path: Path, requested: str | None) -> None:
    """Shows the sheet in the terminal, where that was asked for or can do it."""
    from PIL import Image

    from scenec.datasets.terminal import protocol_of, shown

    known = protocol_of(os.environ) if requested == "auto" or sys.stdout.isatty() else None
    # Asked for, it is shown as well as the terminal is known to; otherwise only if it is known.
    protocol = known or ("blocks" if requested == "auto" else None)
    if requested in ("kitty", "iterm2", "blocks"):
        protocol = requested
    if protocol is None or requested == "none":
        return
    with Image.open(path) as picture:
        sys.stdout.write(
            shown(picture.convert("RGB"), protocol, shutil.get_terminal_size().columns)
        )
