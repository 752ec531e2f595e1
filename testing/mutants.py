"""Files with faults of every kind, and processes in which reading one harms nothing else."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from scenec.schemas.errors import ScenecError
from scenec.schemas.native import CRASHES, read_note

#: What reading may take: seconds of the processor, and bytes (in use; address space is more).
SECONDS, MEMORY = 20.0, 2 << 30
#: Seconds that pass at the most: other work takes some of them.
_WAITED = 120.0
_ADDRESSES = 12 << 30
#: What stands in the place of a number of four bytes.
_EXTREMES = (0, 1, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7F800000, 0x7FC00000)
#: What stands in the place of a word.
_WORDS = (
    b"", b"0", b"-1", b"nan", b"inf", b"-inf", b"1e308", b"1e-320", b"4294967296", b"2147483648",
    b"99999999999999999999", b"null", b"true", b'"', b"[", b"]", b"{", b"}", b"\xff\xfe", b"\0",
    b"../../canary", b"/canary", b"%s%n", b"\xe2\x80\xae", b"[" * 5000, b"{" * 5000,
)  # fmt: skip
_WORD = re.compile(rb"[^\s,:;=()\[\]{}\"]+|[\[\]{}(),:;=\"]")
#: Bytes that a line that is repeated comes to, but for two of any length.
_GROWN = 1 << 20
_TAKEN, _REFUSED, _TRACEBACK = 0, 3, 4


def mutant(data: bytes, text: bool, rng: np.random.Generator) -> bytes:
    """A file with one to four faults.

    Args:
        data: The sound file.
        text: Whether it is made of words.
        rng: Which faults.
    """
    for _ in range(int(rng.integers(1, 5))):
        data = _fault(data, text, rng)
    return data


def _fault(data: bytes, text: bool, rng: np.random.Generator) -> bytes:
    size = len(data)
    if not size:
        return data
    # Faults near the beginning meet headers; elsewhere most bytes are those of arrays.
    at = int(rng.integers(size if rng.random() < 0.5 else min(size, 512)))
    length = int(min(size - at, 1 << int(rng.integers(0, 12))))
    changed = bytearray(data)
    if text and rng.random() < 0.6:
        return _reworded(data, rng)
    match int(rng.integers(8)):
        case 0:
            changed[at] ^= 1 << int(rng.integers(8))
        case 1:
            changed[at : at + length] = rng.bytes(length)
        case 2:
            changed[at : at + length] = bytes([int(rng.choice([0, 0x20, 0xFF]))]) * length
        case 3:
            del changed[at : at + length]
        case 4:
            changed[at:at] = data[at : at + length] * int(rng.choice([1, 2, 50]))
        case 5:
            del changed[at:]
        case 6:
            at -= at % 4
            order = "little" if rng.random() < 0.7 else "big"
            changed[at : at + 4] = int(rng.choice(_EXTREMES)).to_bytes(4, order)  # type: ignore[arg-type]
        case 7:
            other = int(rng.integers(size))
            changed[at : at + length] = data[other : other + length]
    return bytes(changed)


def _reworded(data: bytes, rng: np.random.Generator) -> bytes:
    """One word in place of another, or a line gone, or there many times."""
    if rng.random() < 0.2:
        lines = data.splitlines(keepends=True)
        at = int(rng.integers(len(lines)))
        # A file of one line alone would grow beyond all that a disk holds.
        times = min(int(rng.choice([0, 2, 1000])), 2 + _GROWN // len(lines[at]))
        lines[at : at + 1] = [lines[at]] * times
        return b"".join(lines)
    words = [found.span() for found in _WORD.finditer(data)]
    if not words:
        return data
    begin, end = words[int(rng.integers(len(words)))]
    if rng.random() < 0.5:
        word = _WORDS[int(rng.integers(len(_WORDS)))]
    else:
        first, last = words[int(rng.integers(len(words)))]
        word = data[first:last]
    return data[:begin] + word + data[end:]


@dataclass(frozen=True)
class Outcome:
    """What reading a mutant came to.

    Attributes:
        kind: ``taken``, ``refused`` (one error that names the file), ``crash told`` (native code
            died, and it is known over which file), or a fault: ``unnamed`` (an error that names no
            file), ``traceback``, ``died``, ``hang``, ``memory``, ``left behind``.
        text: The error.
        seconds, peak: Of the processor; bytes beyond what the parent had.
    """

    kind: str
    text: str
    seconds: float
    peak: int

    @property
    def fault(self) -> bool:
        """Whether a user would call it one."""
        return self.kind not in ("taken", "refused", "crash told")


def tried(read: Callable[[], object], name: str, jail: Path) -> Outcome:
    """Reads in a process of its own, which has an empty folder for all it might write.

    Args:
        read: Reads.
        name: Of the file that an error must name.
        jail: Does not exist.
    """
    aside = {each: jail / each for each in ("work", "home", "tmp")}
    for folder in aside.values():
        folder.mkdir(parents=True)
    said = jail / "said"
    # A child begins with all that its parent has in memory, and that counts as its own.
    held = psutil.Process().memory_info().rss
    child = os.fork()
    if not child:
        os._exit(_child(read, name, aside, said))
    _, status, used = os.wait4(child, 0)
    seconds, peak = used.ru_utime + used.ru_stime, max(used.ru_maxrss * 1024 - held, 0)
    text = said.read_text(encoding="utf-8", errors="replace") if said.exists() else ""
    ended = os.waitstatus_to_exitcode(status)
    left = [path for folder in aside.values() for path in folder.rglob("*")]
    if ended in (-signal.SIGALRM, -signal.SIGPROF):
        kind = "hang"
    elif ended < 0:
        told = -ended in CRASHES and Path(read_note()).name.startswith(Path(name).stem)
        kind, text = ("crash told" if told else "died"), f"signal {-ended}: {text[-300:]}"
    elif ended == _TRACEBACK:
        kind = "traceback"
    elif ended == _REFUSED and name not in text:
        kind = "unnamed"
    elif peak > MEMORY:
        kind = "memory"
    elif left:
        kind, text = "left behind", " ".join(map(str, left))[:300]
    else:
        kind = "taken" if ended == _TAKEN else "refused"
    shutil.rmtree(jail)
    return Outcome(kind, text, seconds, peak)


def _child(read: Callable[[], object], name: str, aside: dict[str, Path], said: Path) -> int:
    """Exit status of reading."""
    for timer, limit, number in (
        (signal.ITIMER_PROF, SECONDS, signal.SIGPROF),
        (signal.ITIMER_REAL, _WAITED, signal.SIGALRM),
    ):
        signal.signal(number, signal.SIG_DFL)
        signal.setitimer(timer, limit)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    # Compiled kernels stay where they are.
    caches = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    os.environ |= {
        "XDG_CACHE_HOME": caches,
        "HOME": str(aside["home"]),
        "TMPDIR": str(aside["tmp"]),
    }
    tempfile.tempdir = None
    os.chdir(aside["work"])
    file = os.open(said, os.O_WRONLY | os.O_CREAT)
    os.dup2(file, 1)
    os.dup2(file, 2)
    try:
        read()
    except ScenecError as error:
        os.write(file, f"{error}\n".encode("utf-8", "replace"))
        return _REFUSED
    except MemoryError as error:
        # The command says that, and ends as for other bad input.
        os.write(file, f"{name}: not enough memory: {error}\n".encode("utf-8", "replace"))
        return _REFUSED
    except BaseException as error:  # noqa: BLE001 (whatever it is, it is looked for)
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}:{last.lineno}"
        os.write(file, f"{type(error).__name__} {place}: {error}\n".encode("utf-8", "replace"))
        return _TRACEBACK
    return _TAKEN
