"""``scenec sheet``: one picture of all passes of some frames."""

from __future__ import annotations

import argparse
from pathlib import Path

from scenec.cli.output import say
from scenec.datasets.sheet import write_sheet


def run(options: argparse.Namespace) -> int:
    """Writes the sheet and says where everything lies."""
    out = Path(options.out)
    output = Path(options.output) if options.output else out / "contact_sheet.png"
    sheet = write_sheet(out, output, backend=options.backend, count=options.frames)
    say(f"frames (EXR with all passes, PNG picture, JSON sidecar): {sheet.folder}/")
    say(f"stages for any USD viewer: {out}/batch_*/stage.usda")
    print(f"contact sheet: {sheet.path}")
    return 0
