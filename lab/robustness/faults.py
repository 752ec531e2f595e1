"""Disturbs commands in every way there is, at random moments, and looks at what is left.

    python lab/robustness/faults.py [--runs N] [--seed S] [--commands A,B,...] [--only A,B,...]

Each run takes a command (compile, render, scan, export, view, sweep) and a fault: signals, a full
disk, a quota, a folder that becomes read-only, one that the user may not write to, a clock that
goes back, a folder for temporary files that goes away, no shared memory, few file descriptors,
little memory, a file system that stalls, one that answers errors for a while.
Then the fault is gone, and the same command is given until it succeeds. It is an error if a command
that ends by itself says nothing, shows a traceback, or says what is wrong but not with what; if one
leaves a process; if it does not succeed once nothing disturbs it; if the files then differ from
undisturbed ones; or if anything temporary is left.

Pairs of fault and command are taken in a random order, none twice before all were; ``--runs 0``
takes each once. A fault that cannot be made on this machine (for want of root, a tool, a loop
device, a file system that the kernel has) is left out, with a line that says why.
"""

from __future__ import annotations

import errno
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from scenec.lab.robustness.soak import scanned_cfg
from scenec.lab.runner import SCENEC, Page, names, run
from scenec.lab.runner import command as run_command
from scenec.schemas.errors import ScenecError
from scenec.schemas.files import sha256, tree
from scenec.testing.small import write_cfg

#: Bytes of a disk that is full before anything is finished.
SMALL_DISK = 300_000
#: Bytes of an image of a file system; only what is written takes space.
IMAGE = 512 << 20
#: Seconds for which a file system stalls, or fails.
STALLED_S = 2.0
#: Seconds that no command takes.
LONGEST_S = 300.0
#: Seconds that workers take to see that their parent has gone.
LEAVING_S = 10.0
#: In the environment of all processes of a run.
MARK = "SCENEC_FAULTS_RUN"
#: What the C library says of its errors.
REASONS = {os.strerror(number) for number in errno.errorcode}
#: Nobody's user and group.
NOBODY = 65534


@dataclass
class Disturbed:
    """A command about to be run in a folder.

    Attributes:
        folder: Of its output, which is below.
        words: What to run before the command's own words.
        environment: On top of this process's.
        before: Called in the new process.
        moment: Called with the process while it works.
    """

    folder: Path
    words: list[str] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)
    before: Callable[[], None] | None = None
    moment: Callable[[subprocess.Popen[bytes]], None] = lambda process: None

    def after(self, seconds: float, work: Callable[[subprocess.Popen[bytes]], object]) -> None:
        """Calls something with the process once it has worked for some time, or has ended."""

        def moment(process: subprocess.Popen[bytes]) -> None:
            _sleep(process, seconds)
            work(process)

        self.moment = moment


def _signalled(number: signal.Signals) -> Callable[[Disturbed, float], Iterator[None]]:
    def fault(on: Disturbed, after_s: float) -> Iterator[None]:
        on.after(after_s, lambda process: process.send_signal(number))
        yield

    return fault


def _stopped(on: Disturbed, after_s: float) -> Iterator[None]:
    def stop(process: subprocess.Popen[bytes]) -> None:
        try:
            first = psutil.Process(process.pid)
            of = [first, *first.children(recursive=True)]
        except psutil.NoSuchProcess:
            return
        for number in (signal.SIGSTOP, signal.SIGCONT):
            for each in of:
                with suppress(psutil.Error):
                    each.send_signal(number)
            time.sleep(0.5)

    on.after(after_s, stop)
    yield


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _full(on: Disturbed, after_s: float) -> Iterator[None]:
    size = int(_size(on.folder) * 1.05) + int(SMALL_DISK * after_s)
    with _mounted(on.folder, f"mount -t tmpfs -o size={size} tmpfs"):
        yield


def _quota(on: Disturbed, after_s: float) -> Iterator[None]:
    # Btrfs counts what is written at once, other file systems' quotas need the kernel's support.
    with _imaged(on.folder, "mkfs.btrfs"):
        _tool("btrfs", "quota", "enable", on.folder)
        _tool("btrfs", "quota", "rescan", "-w", on.folder)
        size = int(_size(on.folder) * 1.05) + int(SMALL_DISK * after_s)
        _tool("sync", "-f", on.folder)
        _tool("btrfs", "qgroup", "limit", str(size), "0/5", on.folder)
        yield


def _stalling(on: Disturbed, after_s: float) -> Iterator[None]:
    def freeze(_: object) -> None:
        _tool("fsfreeze", "--freeze", on.folder)
        # Whoever writes waits in the kernel, and not even a signal ends that.
        time.sleep(STALLED_S)
        _tool("fsfreeze", "--unfreeze", on.folder)

    with _imaged(on.folder, "mkfs.ext4"):
        on.after(after_s, freeze)
        yield


def _shimmed(fault: str, for_s: float) -> Callable[[Disturbed, float], Iterator[None]]:
    def begun(on: Disturbed, after_s: float) -> Iterator[None]:
        library, when = on.folder.parent / "shim.so", on.folder.parent / "when"
        source = Path(__file__).with_name("shim.c")
        _tool("cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl")
        on.environment |= {"LD_PRELOAD": str(library), "SHIM": fault, "SHIM_WHEN": str(when)}
        on.environment |= {"SHIM_BELOW": str(on.folder)} if fault == "share" else {}

        def fail(process: subprocess.Popen[bytes]) -> None:
            when.touch()
            _sleep(process, for_s)
            when.unlink()

        on.after(after_s, fail)
        yield

    return begun


def _read_only(on: Disturbed, after_s: float) -> Iterator[None]:
    # What ext4 does after an error of its disk; a usual remount waits for files that are open.
    with _imaged(on.folder, "mkfs.ext4"):
        on.after(after_s, lambda _: _tool("mount", "-o", "remount,abort", on.folder))
        yield


def _not_permitted(on: Disturbed, _after_s: float) -> Iterator[None]:
    # Somebody else's; and a root who may no more than others.
    every = [on.folder, *on.folder.rglob("*")]
    for path in every:
        os.chown(path, NOBODY, NOBODY)
    on.words = ["setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner"]
    yield
    for path in every:
        if path.exists():
            os.chown(path, os.getuid(), os.getgid())


def _future(on: Disturbed, _after_s: float) -> Iterator[None]:
    later = time.time() + 864_000
    for path in on.folder.rglob("*"):
        os.utime(path, (later, later))
    yield


def _no_temporary(on: Disturbed, after_s: float) -> Iterator[None]:
    gone = on.folder.parent / "temporary"
    gone.mkdir()
    on.environment["TMPDIR"] = str(gone)

    on.after(after_s, lambda _: shutil.rmtree(gone, ignore_errors=True))
    yield


def _no_shared_memory(on: Disturbed, _after_s: float) -> Iterator[None]:
    # In its place a folder in which nothing can be made: what is below may be writable, too.
    hide = 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$@"'
    on.words = ["unshare", "-m", "sh", "-c", hide, "sh"]
    yield


def _limited(
    which: int, each_s: int, least: int = 0
) -> Callable[[Disturbed, float], Iterator[None]]:
    def fault(on: Disturbed, after_s: float) -> Iterator[None]:
        most = least + int(each_s * after_s)
        on.before = lambda: resource.setrlimit(which, (most, most))
        yield

    return fault


#: What becomes of a command; called with it and a number of 0 to 3.
FAULTS: dict[str, Callable[[Disturbed, float], Iterator[None]]] = {
    "kill": _signalled(signal.SIGKILL),
    "interrupt": _signalled(signal.SIGINT),
    "terminate": _signalled(signal.SIGTERM),
    "hang up": _signalled(signal.SIGHUP),
    "stop and go on": _stopped,
    "disk full": _full,
    "quota": _quota,
    "share stalls": _stalling,
    "share fails": _shimmed("share", STALLED_S),
    "read-only": _read_only,
    "no permission": _not_permitted,
    "output from the future": _future,
    "clock back": _shimmed("clock", LONGEST_S),
    "TMPDIR gone": _no_temporary,
    "no /dev/shm": _no_shared_memory,
    "few descriptors": _limited(resource.RLIMIT_NOFILE, 16, least=16),
    "little memory": _limited(resource.RLIMIT_AS, 700 << 20),
    "small files only": _limited(resource.RLIMIT_FSIZE, 20_000),
}
#: What a fault needs; tools but a compiler do so as root.
TOOLS = {
    "disk full": ("mount", "umount"), "quota": ("mount", "umount", "sync", "mkfs.btrfs", "btrfs"),
    "share stalls": ("mount", "umount", "mkfs.ext4", "fsfreeze"), "share fails": ("cc",),
    "read-only": ("mount", "umount", "mkfs.ext4"), "clock back": ("cc",),
    "no permission": ("setpriv",), "no /dev/shm": ("unshare", "sh", "mount"),
}  # fmt: skip
AS_ROOT = tuple(fault for fault, tools in TOOLS.items() if tools != ("cc",))


def _tool(*words: str | Path) -> None:
    subprocess.run(words, check=True, capture_output=True)


@contextmanager
def _mounted(folder: Path, mount: str) -> Iterator[None]:
    """A file system of its own in the place of a folder, with its content; later a plain folder."""
    aside = folder.with_name("aside")
    shutil.copytree(folder, aside, symlinks=True)
    _tool(*mount.split(), folder)
    shutil.copytree(aside, folder, dirs_exist_ok=True, symlinks=True)
    shutil.rmtree(aside)
    try:
        yield
    finally:
        shutil.copytree(folder, aside, symlinks=True)
        _tool("umount", "-l", folder)
        shutil.rmtree(folder)
        aside.rename(folder)


@contextmanager
def _imaged(folder: Path, make: str) -> Iterator[None]:
    """One in a file."""
    image = folder.with_name("image")
    with image.open("wb") as file:
        file.truncate(IMAGE)
    _tool(make, "-q", image)
    with _mounted(folder, f"mount -o loop {image}"):
        # Not a folder of ours, and digests are of all that is there.
        shutil.rmtree(folder / "lost+found", ignore_errors=True)
        yield
    image.unlink()


def obstacle(fault: str, folder: Path) -> str | None:
    """Why a fault cannot be made here; None where it can: a command that does nothing has had it.

    Args:
        fault: One of ``FAULTS``.
        folder: An empty one, for files.
    """
    if fault in AS_ROOT and (os.geteuid() or sys.platform != "linux"):
        return "it needs root on Linux"
    lacking = [tool for tool in TOOLS.get(fault, ()) if not shutil.which(tool)]
    if lacking:
        return f"it needs {', '.join(lacking)}"
    on = Disturbed(folder / "output")
    on.folder.mkdir()
    try:
        with contextmanager(FAULTS[fault])(on, 1.0):
            line = [*on.words, sys.executable, "-S", "-c", ""]
            environment = os.environ | on.environment
            subprocess.run(
                line, check=True, capture_output=True, env=environment, preexec_fn=on.before
            )
    except OSError as error:
        return str(error.strerror)
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode("utf-8", "replace").split("\n")
        return f"{error.cmd[0]}: exit status {error.returncode}: {said[0]}"
    return None


def pairs(
    rng: random.Random, faults: Sequence[str], commands: Sequence[str], runs: int = 0
) -> list[tuple[str, str]]:
    """So many pairs of a fault and a command, each fault in turn, no pair twice before all were.

    0 runs are all once.
    """
    found: list[tuple[str, str]] = []
    while len(found) < (runs or 1):
        turns = [rng.sample(commands, len(commands)) for _ in faults]
        for turn in zip(*turns, strict=True):
            found += rng.sample(list(zip(faults, turn, strict=True)), len(faults))
    return found[: runs or len(found)]


def _sleep(process: subprocess.Popen[bytes], seconds: float) -> None:
    with suppress(subprocess.TimeoutExpired):
        process.wait(timeout=seconds)


@dataclass(frozen=True)
class Command:
    """A command, and those that come before it.

    Attributes:
        words: Of the command; CFG and OUT stand for paths.
        after: The command that makes what it takes.
    """

    words: str
    after: str | None = None


COMMANDS = {
    "compile": Command("compile CFG --seed 1 -o OUT/out"),
    "render": Command(
        "render OUT/out --backend annotation --passes label,instance,depth", "compile"
    ),
    "draw": Command("render OUT/out --backend pyrender --spp 1", "compile"),
    "scan": Command("scan OUT/out", "compile"),
    "export": Command("export OUT/out --format coco", "draw"),
    "view": Command("view OUT/out", "draw"),
    "sweep": Command("sweep CFG --seeds 0:3 --compile-only -o OUT/swept"),
}


def _line(command: Command, cfg: Path, out: Path) -> list[str]:
    words = command.words.split()
    return [*SCENEC, *(w.replace("CFG", str(cfg)).replace("OUT", str(out)) for w in words)]


def digests(out: Path) -> dict[str, str]:
    """Of each file."""
    return {str(path): sha256(out / path) for path in tree(out)}


def _taken(command: Command, made: dict[str, Path], folder: Path) -> Path:
    """A new folder with what a command takes."""
    if command.after:
        shutil.copytree(made[command.after], folder)
    else:
        folder.mkdir()
    return folder


def prepared(folder: Path, cfg: Path) -> tuple[dict[str, Path], dict[str, set[str]]]:
    """What each command takes, as folders to copy; and files of its output that time is in."""
    made: dict[str, Path] = {}
    timed: dict[str, set[str]] = {}
    for name, command in COMMANDS.items():
        runs = []
        for turn in ("a", "b"):
            out = _taken(command, made, folder / f"{name}_{turn}")
            run_command(_line(command, cfg, out))
            runs.append(digests(out))
        made[name] = folder / f"{name}_a"
        timed[name] = {file for file in runs[0] if runs[0][file] != runs[1].get(file)}
    return made, timed


def _begin(on: Disturbed) -> None:
    # Under nohup, or behind a shell's &, this process ignores some, and children would, too.
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    if on.before:
        on.before()


def disturbed(on: Disturbed, line: list[str], mark: str) -> tuple[int, str, list[str]]:
    """Exit status, what was said, and what else is wrong."""
    wrong = []
    # No pipe: a process that is left behind would hold it open.
    with tempfile.TemporaryFile() as file:
        process = subprocess.Popen(
            [*on.words, *line],
            env=os.environ | on.environment | {MARK: mark},
            stdout=file,
            stderr=file,
            preexec_fn=lambda: _begin(on),
        )
        on.moment(process)
        try:
            status = process.wait(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            process.kill()
            status = process.wait()
            wrong.append("hangs")
        file.seek(0)
        said = file.read().decode("utf-8", "replace")
    if "Traceback" in said:
        wrong.append(f"traceback: {said[-500:]}")
    if status > 0 and not said.strip():
        wrong.append("says nothing")
    if status > 0 and said.strip().split("scenec: ")[-1] in REASONS:
        wrong.append(f"names no file: {said.strip()[-100:]}")
    end = time.monotonic() + LEAVING_S
    while (left := _marked(mark)) and time.monotonic() < end:
        time.sleep(0.1)
    if left:
        wrong.append(f"leaves processes: {left}")
    return status, said, wrong


def _marked(mark: str) -> list[str]:
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.status() != psutil.STATUS_ZOMBIE and process.environ().get(MARK) == mark:
                found.append(" ".join(process.cmdline())[:100])
    return found


def tried(
    page: Page, made: dict[str, Path], timed: set[str], cfg: Path, name: str, fault: str, rng: Any
) -> tuple[str, list[str]]:
    """One run: what the disturbed command ended with, and all that is wrong."""
    command = COMMANDS[name]
    place = page.scratch / "run"
    place.mkdir()
    folder = _taken(command, made, place / "output")
    line = _line(command, cfg, folder)
    on = Disturbed(folder, environment={"SCENEC_CACHE": ""})
    mark = str(rng.getrandbits(48))
    with contextmanager(FAULTS[fault])(on, rng.uniform(0.05, 3.0)):
        status, said, wrong = disturbed(on, line, mark)
    ended = f"signal {-status}" if status < 0 else f"exit {status}"
    for _ in range(3):
        again, text, more = disturbed(Disturbed(folder), line, mark)
        wrong += [f"again: {each}" for each in more]
        if again == 0:
            break
    else:
        wrong.append(f"does not go on: {text[-300:]}")
    whole, found = digests(made[name]), digests(folder)
    for file in sorted(whole.keys() | found.keys()):
        if (file in timed and file in found) or whole.get(file) == found.get(file):
            continue
        how = "is missing" if file not in found else "is left" if file not in whole else "differs"
        wrong.append(f"{file} {how}")
    shutil.rmtree(place)
    last = said.strip().splitlines()[-1:] or [""]
    return f"{ended}: {last[0][:120]}", wrong


def main(page: Page) -> None:
    """Prints a row a run, and refreshes how often each fault ended how."""
    commands = list(page.options.commands or COMMANDS)
    faults = []
    for fault in page.options.only or FAULTS:
        with tempfile.TemporaryDirectory(dir=page.scratch) as folder:
            why = obstacle(fault, Path(folder))
        if why:
            page.say(f"left out: {fault} ({why})")
        else:
            faults.append(fault)
    if not faults:
        raise ScenecError("none of these faults can be made here")
    rng = random.Random(page.options.seed)
    cfg = write_cfg(page.scratch, scanned_cfg(batches=2, samples=2))
    made, timed = prepared(page.scratch, cfg)
    files = ", ".join(sorted({file for some in timed.values() for file in some})) or "none"
    page.say(f"files that differ between undisturbed runs (times are in them): {files}\n")
    chosen = pairs(rng, faults, commands, len(faults) if page.fast else page.options.runs)
    ends: dict[str, Counter[str]] = {fault: Counter() for fault in faults}
    times, wronged = Counter[tuple[str, str]](), 0
    for number, (fault, name) in enumerate(chosen):
        ended, wrong = tried(page, made, timed[name], cfg, name, fault, rng)
        ends[fault][ended.partition(":")[0]] += 1
        times[fault, name] += 1
        wronged += bool(wrong)
        print(json.dumps([number, name, fault, ended, wrong]), flush=True)
        for each in wrong:
            page.say(f"- run {number}, {name}, {fault}: {each}")
    rows = [
        [fault, ", ".join(name for name in commands if times[fault, name]), _text(ends[fault])]
        for fault in faults
    ]
    header = ["fault", "of", "the command ended with"]
    page.table(header, rows)
    page.say(f"{len(chosen)} runs, {wronged} with something wrong")
    if page.whole:
        page.value("disturbed", f"{len(chosen)} runs, {len(faults)} faults")
        page.value("disturbed_wrong", str(wronged))
        page.block("faults", header, rows)
        page.refresh((), ())


def _text(ends: Counter[str]) -> str:
    return ", ".join(f"{ended} ({times})" for ended, times in sorted(ends.items()))


if __name__ == "__main__":
    run(main, page="robustness", runs=18, seed=0, commands=names, only=names)
