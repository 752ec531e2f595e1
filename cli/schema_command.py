"""``scenec schema``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from scenec.compiler.kinds.schema import bundled
from scenec.schemas.files import as_json, write_json


def run(options: argparse.Namespace) -> int:
    """Writes the schema.

    Raises:
        OutputError: The file cannot be written.
    """
    schema = bundled(partial=options.partial)
    if options.output is None:
        sys.stdout.write(as_json(schema))
    else:
        write_json(Path(options.output), schema)
    return 0
