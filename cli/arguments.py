"""Arguments that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from scenec.schemas.passes import PASSES, is_pass, pass_names
from scenec.schemas.spelling import nearest, shown

#: As in ``scenec.compiler.compile``, which would cost the import of NumPy; a test compares them.
FAULTS = ("stop", "skip", "redraw")


def whole(low: int, high: float, expected: str) -> Callable[[str], int]:
    """What reads a whole number between two bounds."""

    def read(text: str) -> int:
        try:
            value = int(text, 10)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {expected}")
        return value

    return read


seed = whole(0, 2**64 - 1, "a whole number from 0 to 2^64 - 1")
#: Far beyond what converges, and short of what overflows.
positive = whole(1, 2**20, f"a whole number from 1 to {2**20}")
#: A batch, a sample, an attempt: as many as a stage can number.
counted = whole(0, 2**31 - 1, f"a whole number from 0 to {2**31 - 1}")
#: Seconds, meters, megabytes, shares: far beyond what there is, and short of what overflows.
_MOST = 1e12


def add_cfg(parser: argparse.ArgumentParser) -> None:
    """The cfg."""
    parser.add_argument(
        "cfg", metavar="CFG", help="a file of JSON or YAML, or package:configs/NAME of ours"
    )


def add_seed(parser: argparse.ArgumentParser) -> None:
    """``--seed``."""
    parser.add_argument(
        "--seed", type=seed, default=0, help="whole number from 0 to 2^64 - 1 (default: 0)"
    )


def add_preview_options(parser: argparse.ArgumentParser) -> None:
    """What ``preview`` shows, and where."""
    parser.add_argument(
        "--backend", default="pyrender", help="who draws (default: pyrender, the quickest)"
    )
    parser.add_argument("--spp", type=positive, default=8, help="samples a pixel (default: 8)")
    parser.add_argument(
        "--width", type=positive, default=480, metavar="PX", help="of pictures (default: 480)"
    )
    parser.add_argument(
        "--port",
        type=whole(0, 65535, "a port from 1 to 65535, or 0 for a free one"),
        default=0,
        metavar="N",
        help="of the page (default: a free one)",
    )
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    parser.add_argument("--once", metavar="HTML", help="write the page to a file, and end")


def add_settings(parser: argparse.ArgumentParser) -> None:
    """``--set``."""
    parser.add_argument(
        "--set",
        dest="settings",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="put a value, JSON or a bare word, at a place of the cfg: terrain.spacing_m=0.2, "
        "'terrain.relief[0].amplitude_m=3', objects.rocks=null to take a key away (repeatable)",
    )


#: More are asked for by a slip, and are listed somewhere.
_LONGEST_SPAN = 1_000_000


def span(text: str) -> range:
    """``A:B`` as the range A to B - 1; ``A`` alone is A:A+1."""
    first, colon, last = text.partition(":")
    try:
        start = int(first, 10)
        stop = int(last, 10) if colon else start + 1
    except ValueError:
        start, stop = 0, -1
    if start < 0 or stop <= start:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected A:B with 0 <= A < B (it holds A to B-1), or one number"
        )
    if stop > 2**64 or stop - start > _LONGEST_SPAN:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected numbers below 2^64, {_LONGEST_SPAN:,} of them at most"
        )
    return range(start, stop)


def amount(text: str) -> float:
    """Parses a number above 0, at most 1e12."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= _MOST:
        most = f", at most {_MOST:g}" if value > _MOST else ""
        raise argparse.ArgumentTypeError(f"{text!r}: expected a number above 0{most}")
    return value


def passes(text: str) -> tuple[str, ...]:
    """A list such as ``rgb,depth``."""
    chosen = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    for name in chosen:
        if not (is_pass(name) or _is_level(name)):
            raise argparse.ArgumentTypeError(f"no pass {shown(name)}{nearest(name, pass_names())}")
    if not chosen:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected some of {','.join(pass_names())}, separated by commas "
            "(label.NAME is one level of labels)"
        )
    return chosen


def _is_level(name: str) -> bool:
    return name.startswith("label.") and name.removeprefix("label.").isidentifier()


def add_render_options(parser: argparse.ArgumentParser) -> None:
    """What ``run`` and ``render`` share."""
    parser.epilog = (
        "A camera that the renderer cannot draw costs its own frames and no other's. Exit status: "
        "0 all frames are there; 1 some were given up or refused, and said; 2 it cannot be done."
    )
    parser.add_argument(
        "--backend",
        default="mitsuba",
        help="renderer of rgb (default: mitsuba); auto is the first that works here, the most "
        "efficient first where scenec converge has measured; without rgb none is needed",
    )
    parser.add_argument(
        "--spp",
        type=positive,
        help="samples per pixel of rgb (default: 64); with --error or --seconds the most there may "
        "be (default: 4096)",
    )
    parser.add_argument(
        "--error",
        type=amount,
        metavar="E",
        help="render rgb in rounds until its relative rms error is below E (0.05 is 5 %%), by its "
        "95 %% bound",
    )
    parser.add_argument(
        "--seconds",
        type=amount,
        metavar="S",
        help="render rgb in rounds for S seconds a frame; not reproducible, since machines differ",
    )
    parser.add_argument(
        "--passes",
        type=passes,
        metavar="A,B,…",
        help=f"of {','.join(PASSES)}; default: the cfg's, with --backend annotation all of these "
        "but rgb",
    )
    parser.add_argument(
        "--samples", type=span, metavar="A:B", help="only these samples of each batch"
    )
    parser.add_argument(
        "--noise-seed", type=seed, default=0, help="seed of the renderer's noise (default: 0)"
    )
    parser.add_argument(
        "--device",
        metavar="NAME",
        default="auto",
        help="where the renderer runs: cpu, cuda, or what else it has (default: auto, the fastest "
        "that works here)",
    )
    parser.add_argument(
        "--denoise",
        action="store_true",
        help="denoise rgb, if the renderer has a denoiser; refused where a camera has an aperture "
        "or moves while its shutter is open",
    )
    add_executor(parser)
    parser.add_argument(
        "--timeout",
        type=amount,
        metavar="SECONDS",
        help="end and retry a frame that takes longer; a fresh process's first one may take 60 s "
        "more (default: only what hangs is ended, after 120 s without progress)",
    )
    parser.add_argument(
        "--memory-limit",
        type=amount,
        metavar="GB",
        help="memory a renderer's process may hold before it is replaced "
        "(default: 80 %% of what there is)",
    )


def add_executor(parser: argparse.ArgumentParser, default: str = "$SCENEC_WORKERS, or 1") -> None:
    """Who works."""
    parser.add_argument(
        "--workers",
        type=whole(0, 1024, "a whole number from 0 to 1024"),
        metavar="N",
        help="processes that work side by side, each with its share of the cores; 0: none but this "
        f"one (default: {default})",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="workers of a dask cluster instead: its scheduler's address or file, or local "
        "(docs/cluster.md)",
    )


def names(text: str) -> list[str]:
    """A list such as ``lander,logs``, each once."""
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def positions(text: str) -> list[str]:
    """Splits a list by position, as ``sky,ground,,rock``: repeated and empty names stay."""
    return [name.strip() for name in text.split(",")]


def add_settle_options(parser: argparse.ArgumentParser) -> None:
    """What falls in ``settle``, and how."""
    parser.add_argument(
        "--objects",
        type=names,
        metavar="CLASS,…",
        required=True,
        help="classes to drop, of type placed or meshes",
    )
    parser.add_argument(
        "--among",
        type=names,
        metavar="CLASS,…",
        help="classes that they may fall onto (default: all of type placed and rocks)",
    )
    parser.add_argument(
        "--batch", type=counted, default=0, metavar="B", help="on whose ground (default: 0)"
    )
    parser.add_argument(
        "--attempt",
        type=counted,
        default=0,
        metavar="N",
        help="how often --faults redraw drew it again: attempt in the manifest (default: 0)",
    )
    parser.add_argument(
        "--drop",
        type=float,
        metavar="METERS",
        help="least height over the ground to fall from (default: a tenth of the object)",
    )
    parser.add_argument("--friction", type=float, default=0.6, help="default: 0.6")
    parser.add_argument(
        "--restitution", type=float, default=0.1, help="speed kept in a bounce (default: 0.1)"
    )
    parser.add_argument(
        "--cells",
        type=positive,
        default=8,
        help="cells of the ground across an object: finer and slower with more (default: 8)",
    )
    parser.add_argument(
        "--max-steps", type=counted, default=20000, help="give up waiting for rest (default: 20000)"
    )


def add_keep(parser: argparse.ArgumentParser) -> None:
    """How much stays in the stages; values as in ``scenec.compiler.views.needed``."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--keep",
        choices=("seen", "unpruned", "all"),
        default="seen",
        help="seen: what cameras can see the effect of (default); unpruned: all, as fine as then; "
        "all: all, as fine out of view as in view, for walking around in a viewer",
    )
    group.add_argument(
        "--no-prune", dest="keep", action="store_const", const="unpruned", help="--keep unpruned"
    )


def add_cache(parser: argparse.ArgumentParser) -> None:
    """Where steps of earlier compilations are."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--cache",
        metavar="DIR",
        help="folder of what earlier compilations made, taken where nothing it depends on has "
        "changed: the same bytes, sooner (default: $SCENEC_CACHE, or scenec in the user's folder "
        "for caches; at most $SCENEC_CACHE_MAX, 4G; safe to delete)",
    )
    group.add_argument("--no-cache", action="store_true", help="make all anew, and keep nothing")


def add_allow_missing(parser: argparse.ArgumentParser) -> None:
    """What to do with a stage that is not whole."""
    parser.add_argument(
        "--allow-missing",
        action="store_true",
        help="read what is there of a stage that lacks layers, prims or pictures, or whose files "
        "are not those of the manifest (default: that is an error)",
    )


def add_batches(parser: argparse.ArgumentParser) -> None:
    """A choice of batches."""
    parser.add_argument("--batches", type=span, metavar="A:B", help="only batches A to B-1")


def add_frames(parser: argparse.ArgumentParser) -> None:
    """A choice among the frames of an output."""
    parser.add_argument("--backend", help="whose frames (default: the first there is)")
    add_batches(parser)
    parser.add_argument("--cameras", type=names, metavar="A,B,…", help="only these cameras")
    parser.add_argument("--samples", type=span, metavar="A:B", help="only these samples")


def add_replace(parser: argparse.ArgumentParser) -> None:
    """What a compilation may do to an output that is there, and about batches that fail."""
    parser.add_argument(
        "--replace",
        action="store_true",
        help="replace what OUT holds of another cfg, seed, --keep or version: its batches go, and "
        "frames and scans of stages that change; run and sweep render frames again, too, that are "
        "there with other options; files of your own stay",
    )
    parser.add_argument(
        "--faults",
        choices=FAULTS,
        default="stop",
        help="at a batch that cannot be built: stop (default), skip it and leave with exit status "
        "1, or redraw it, the same each time, and skip it after 16 attempts",
    )


def add_verbose(parser: argparse.ArgumentParser) -> None:
    """How much is said."""
    parser.add_argument("-v", "--verbose", action="store_true", help="say what took how long, too")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Machine-readable output."""
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON on standard output"
    )
