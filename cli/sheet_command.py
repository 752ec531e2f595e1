"""``scenec sheet``: one picture of all passes of some frames."""

from __future__ import annotations

import argparse
from pathlib import Path

from scenec.cli.output import say
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
    say(f"frames (EXR with all passes, PNG picture, JSON sidecar): {sheet.folder}/")
    stages = f"{out}/batch_*/stage.usda" if out.is_dir() else str(out)
    say(f"stages for any USD viewer: {stages}")
    print(f"contact sheet: {sheet.path}")
    return 0
