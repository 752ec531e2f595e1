"""Arguments of ``scenec import``."""

from __future__ import annotations

import argparse

from scenec.cli.arguments import add_json

#: Formats, and what is given of each.
FORMATS = {
    "oaisys": "a cfg of OAISYS, of any generation",
    "usd": "a stage of USD with its meshes, lights and cameras",
    "blenderproc": "a folder of a BOP scene, or of BlenderProc's HDF5 files with camera and "
    "object states",
}
#: As in ``scenec.importers.usd.scene``, which would cost the import of USD; a test compares them.
KEEP = ("cameras", "light")


def kept(text: str) -> tuple[str, ...]:
    """Some of ``KEEP``, separated by commas."""
    chosen = tuple(part.strip() for part in text.split(",") if part.strip())
    for name in chosen:
        if name not in KEEP:
            raise argparse.ArgumentTypeError(f"{name!r}: expected some of {','.join(KEEP)}")
    return chosen


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
    parser.add_argument(
        "--assets",
        action="append",
        default=[],
        metavar="DIR",
        help="look here first for the files that are named (repeatable; default: the source's "
        "folder and three above it)",
    )
    parser.add_argument(
        "--stand-ins",
        action="store_true",
        help="put procedural rocks, grounds and skies in the place of files that are missing",
    )
    parser.add_argument(
        "--ground",
        default="",
        metavar="PRIM",
        help="of usd: the mesh that is the ground, a path or a name (default: the widest)",
    )
    parser.add_argument(
        "--keep",
        type=kept,
        default=(),
        metavar="A,B",
        help="of usd: leave cameras, light or both as they are, in place of varying them",
    )
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
