"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def write_atomically(path: Path, save: Callable[[Path], None]) -> None:
    """Have ``save`` write a temporary file beside ``path``, then rename it into place.

    The temporary keeps the suffix, by which some writers choose a format, and starts with a dot.
    Whatever ``save`` raises is passed on, and the temporary is gone.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        save(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
