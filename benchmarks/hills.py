"""What benchmarks of memory, of many rocks and of pruning have in common: cfg, commands, tables."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SCENEC = [sys.executable, "-c", "from scenec.cli.main import main; raise SystemExit(main())"]
ROOT = Path(__file__).resolve().parents[1]


def cfg(
    side: float,
    spacing: float,
    rocks: dict[str, Any],
    relief: tuple[float, float] = (3.0, 60.0),
    **change: Any,
) -> dict[str, Any]:
    """Rocks on rolling ground, and a camera among them.

    Args:
        side: Of the ground, meters.
        spacing: Of its samples, meters.
        rocks: Keys of the only class of objects: count, sizes.
        relief: Amplitude and scale of the hills, meters.
        change: Keys of the cfg that are others, or more.
    """
    amplitude, scale = relief
    common = {"type": "rocks", "family": "angular", "material": "stone"}
    return {
        "version": 1,
        "name": "hills",
        "labels": {"class": {"sky": 1, "ground": 2, "rock": 3}},
        "terrain": {
            "size_m": [side, side],
            "spacing_m": spacing,
            "relief": [
                {"type": "plane"},
                {
                    "type": "multifractal",
                    "amplitude_m": amplitude,
                    "scale_m": scale,
                    "octaves": 8,
                },
            ],
            "ground": [{"material": "sand", "labels": {"class": "ground"}}],
        },
        "materials": {
            "sand": {"base_color": [0.4, 0.25, 0.15]},
            "stone": {"base_color": [0.2, 0.14, 0.1], "variation": 0.3},
        },
        "objects": {"rocks": {"labels": {"class": "rock"}} | common | rocks},
        "light": {
            "sun": {"elevation_deg": 35, "azimuth_deg": 200},
            "sky": {"type": "clear", "labels": {"class": "sky"}},
        },
        "rigs": {
            "rover": {
                "pose": {
                    "type": "random_target",
                    "position": {"x_m": 0, "y_m": -0.2 * side, "height_m": 2},
                    "target": {"distance_m": 12, "bearing_deg": 0, "height_m": 0.5},
                },
                "sensors": {"mast": {"resolution": [640, 480], "fov_deg": 60}},
            }
        },
    } | change


def run(words: Sequence[str | Path]) -> int:
    """Runs a command of scenec in silence; its peak memory, bytes (Linux).

    Raises:
        SystemExit: It failed; what it said last.
    """
    command = [*SCENEC, *map(str, words)]
    with tempfile.TemporaryFile() as said:
        pid = os.posix_spawn(
            command[0], command, os.environ,
            file_actions=[(os.POSIX_SPAWN_DUP2, said.fileno(), number) for number in (1, 2)],
        )  # fmt: skip
        _, status, usage = os.wait4(pid, 0)
        if status:
            said.seek(0)
            lines = said.read().decode(errors="replace").splitlines()
            raise SystemExit(f"scenec {' '.join(map(str, words))}: {' '.join(lines[-3:])}")
    return 1024 * usage.ru_maxrss


def table(*columns: str) -> None:
    """Begins a table."""
    row(*columns)
    row(*["---"] * len(columns))


def row(*cells: str) -> None:
    """A line of a table."""
    print(f"| {' | '.join(cells)} |", flush=True)
