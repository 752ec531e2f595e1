"""The errors a user can meet, each with the place, the value and the mend.

Every message is one that can be acted on without reading the code. The command line prints
``str(error)`` and leaves with exit status 2; it never prints a traceback for one of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path


class ScenecError(Exception):
    """Base of every error caused by what scenec was given (not by a fault in scenec)."""


@dataclass(frozen=True, order=True)
class Fault:
    """One thing wrong in a cfg.

    Attributes:
        file: The cfg's path as the user gave it, or that of a file it extends.
        line: Line, from 1; 0 where the value stands in no file, but in the option ``file``.
        column: Column, from 1, in characters.
        pointer: JSON pointer (RFC 6901) of the value; "" is the whole document.
        message: What is wrong with which value, what was expected, and the nearest valid spelling.
    """

    file: str
    line: int
    column: int
    pointer: str
    message: str

    def __str__(self) -> str:
        place = f":{self.line}:{self.column}" if self.line else ""
        return f"{self.file}{place}: {self.pointer or '/'}: {self.message}"


class CfgError(ScenecError):
    """A cfg with at least one fault; carries all of them, in the file's order."""

    def __init__(self, faults: Sequence[Fault]):
        self.faults = tuple(sorted(faults))
        super().__init__("\n".join(str(fault) for fault in self.faults))

    def __reduce__(self) -> tuple[type[CfgError], tuple[tuple[Fault, ...]]]:
        """Between processes it goes with its faults."""
        return CfgError, (self.faults,)

    def unplaced(self, file: str) -> CfgError:
        """Returns it without lines and columns in a text that nobody has seen."""
        return CfgError(
            [f if f.file != file else replace(f, line=0, column=0) for f in self.faults]
        )


class SceneError(ScenecError):
    """A valid cfg that cannot be built: a density that is zero everywhere, a DEM with holes.

    Attributes:
        batches: Those that were compiled before the one that cannot be built.
    """

    batches: tuple[int, ...] = ()


class StageError(ScenecError):
    """A stage that cannot be read: not USD, an unknown schema version, broken arrays."""


class FrameError(ScenecError):
    """A frame on disk that is missing, truncated, or not of this contract."""

    @classmethod
    def none_readable(cls, out: Path, count: int, first: str) -> FrameError:
        """Reports an output whose frames are all faulty; ``first`` is the fault of one."""
        return cls(f"{out}: not one of {count} frames can be read; the first: {first}")


class ForeignFrameError(FrameError):
    """A sound frame that does not belong where it lies: of another stage, or with other labels."""


class BackendError(ScenecError):
    """A renderer that is not installed, cannot start, or failed on a frame."""


class CameraRefusedError(BackendError):
    """A camera that a renderer cannot draw, whatever the sample: others it may."""


class PluginError(ScenecError):
    """Reports a failure in another package's code: whose, and at which line."""


class OutputError(ScenecError):
    """An output folder or file that cannot be written."""
