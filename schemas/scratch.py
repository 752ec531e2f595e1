"""Makes temporary folders that end with the command, however it ends.

The process that supervises a command (``cli/supervise.py``) marks it by a variable that all of its
workers inherit. Each temporary folder has the mark in its name, so that the supervisor removes what
a killed process has left. Without a supervisor (as a library) the folder's own end must do.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

#: Environment variable with the mark of the command that this process works for.
_VARIABLE = "SCENEC_COMMAND"


def mark() -> None:
    """Begins a command: marks this process and those that it will start."""
    os.environ[_VARIABLE] = os.urandom(4).hex()


def scratch_folder() -> tempfile.TemporaryDirectory[str]:
    """Makes a temporary folder that is removed at the end of its ``with`` block or of the command.

    Raises:
        OSError: There is no place for it.
    """
    return tempfile.TemporaryDirectory(prefix=_prefix(), ignore_cleanup_errors=True)


def remove_left() -> None:
    """Removes the temporary folders of the marked command, whose processes have ended."""
    try:
        left = [*Path(tempfile.gettempdir()).glob(f"{_prefix()}*")]
    except OSError:
        # There is no folder for temporary files (any more), hence nothing of ours in it.
        return
    for folder in left:
        shutil.rmtree(folder, ignore_errors=True)


def _prefix() -> str:
    name = os.environ.get(_VARIABLE)
    return f"scenec-{name}-" if name else "scenec-"
