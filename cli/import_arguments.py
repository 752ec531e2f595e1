"""Arguments of ``scenec import``."""

from __future__ import annotations

import argparse

from scenec.api.make import FORMATS, ImportOptions
from scenec.cli.arguments import add, add_json


def add_import_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``import``."""
    parser.add_argument(
        "format",
        metavar="FORMAT",
        choices=tuple(FORMATS),
        help="; ".join(f"{name}: {what}" for name, what in FORMATS.items()),
    )
    parser.add_argument("source", metavar="SOURCE", help="what is imported, see FORMAT")
    parser.add_argument("-o", "--output", metavar="CFG", required=True, help="the cfg, .json")
    add(parser, ImportOptions)
    parser.add_argument(
        "--report",
        metavar="FILE",
        help="write what became of every value here, as JSON where the name ends with .json "
        "(default: a table on standard output)",
    )
    add_json(parser)
    parser.epilog = (
        "Files that the cfg needs and nobody has are made beside it, in CFG_files. Example: scenec "
        "import oaisys cfg.json -o mine.json --stand-ins. docs/importing.md tells more. Exit "
        "status: 0 done; 2 a fault, and nothing was written."
    )
