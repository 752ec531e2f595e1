"""What ``lab/robustness/faults.py`` leaves out on a machine, how it draws, what it finds."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager
from itertools import product
from pathlib import Path

import pytest

from scenec.lab.robustness import faults as study
from scenec.lab.robustness.faults import FAULTS, Disturbed, disturbed, obstacle, pairs
from scenec.testing.processes import until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="its faults are Linux's")
STUDY = Path(__file__).resolve().parents[2] / "lab" / "robustness" / "faults.py"
#: What the kernel lets root do: mount(2), chown(2), unshare(2).
ROOTS = {"no permission", "disk full", "quota", "share stalls", "read-only", "no /dev/shm"}
TRIED = """
import json, tempfile
from pathlib import Path
from scenec.lab.robustness.faults import FAULTS, obstacle
with tempfile.TemporaryDirectory() as folder:
    found = {}
    for number, fault in enumerate(FAULTS):
        place = Path(folder) / str(number)
        place.mkdir()
        found[fault] = obstacle(fault, place)
    assert folder not in Path("/proc/self/mounts").read_text()
print(json.dumps(found))
"""
#: A command of a few lines that knows what a fault does, and ends well once it has met that.
OUT = "import sys, time; from pathlib import Path; out = Path(sys.argv[1])\n"
FILLS = """
with (out / 'new').open('wb', buffering=0) as file:
    while True: file.write(bytes(4096))
"""
#: Tries again and again; a fault that never comes is one that does nothing.
AGAIN = "for turn in range(1500):\n  time.sleep(0.02)\n  "
EFFECTS = {
    "kill": AGAIN + "pass",
    "interrupt": "try:\n  time.sleep(30)\nexcept KeyboardInterrupt: raise OSError(130)",
    "terminate": AGAIN + "pass",
    "hang up": AGAIN + "pass",
    "stop and go on": "import signal\n"
    "def woken(number, frame): raise OSError(number)\n"
    "signal.signal(signal.SIGCONT, woken)\ntime.sleep(30)",
    "disk full": FILLS,
    "quota": FILLS,
    "share stalls": AGAIN + "start = time.monotonic()\n"
    "  (out / 'new').write_text('new')\n"
    "  if time.monotonic() - start > 1.0: raise OSError(1)",
    "share fails": AGAIN + "(out / 'there').read_text()",
    "read-only": AGAIN + "(out / 'new').write_text('new')",
    "no permission": "(out / 'new').write_text('new')",
    "output from the future": "later = (out / 'there').stat().st_mtime - time.time()\n"
    "raise OSError(int(later > 8e5))",
    "clock back": "start = time.time()\n"
    + AGAIN + "if time.time() < start - 8e5: raise OSError(1)",
    "TMPDIR gone": "import tempfile\n" + AGAIN + "tempfile.NamedTemporaryFile().close()",
    "no /dev/shm": "from multiprocessing.shared_memory import SharedMemory\n"
    "SharedMemory(create=True, size=1)",
    "few descriptors": "every = [open(out / 'there') for _ in range(60)]",
    "little memory": "try:\n  bytearray(3 << 30)\nexcept MemoryError: raise OSError(12)",
    "small files only": FILLS,
}  # fmt: skip
#: What then is said, by numbers of errno where the kernel says it.
SAID = {
    "interrupt": {130},
    "stop and go on": {signal.SIGCONT},
    "disk full": {errno.ENOSPC},
    "quota": {errno.EDQUOT},
    "share stalls": {1},
    "share fails": {errno.ESTALE, errno.EIO, errno.ETIMEDOUT},
    "read-only": {errno.EROFS},
    "no permission": {errno.EACCES},
    "output from the future": {1},
    "clock back": {1},
    "TMPDIR gone": {errno.ENOENT},
    "no /dev/shm": {errno.EROFS},
    "few descriptors": {errno.EMFILE},
    "little memory": {12},
    "small files only": {errno.EFBIG},
}
SIGNALS = {"kill": signal.SIGKILL, "terminate": signal.SIGTERM, "hang up": signal.SIGHUP}


def left_out(*words: str, **environment: str) -> dict[str, str]:
    """Faults that are left out in a process that the words start, each with the reason."""
    found: dict[str, str | None] = json.loads(
        subprocess.run(
            [*words, sys.executable, "-c", TRIED],
            env=os.environ | environment,
            stdout=subprocess.PIPE,
            check=True,
        ).stdout
    )
    return {fault: why for fault, why in found.items() if why is not None}


def can(*words: str) -> bool:
    return (
        shutil.which(words[0]) is not None
        and subprocess.run(words, capture_output=True, check=False).returncode == 0
    )


@pytest.mark.parametrize(
    "powers", [("--bounding-set=-all", "--inh-caps=-all"), ("--reuid=65534", "--clear-groups")]
)
def test_what_the_kernel_grants_to_root_alone_is_left_out_without_its_powers(powers):
    # Root without capabilities, as in a container, or nobody; other users have nothing to drop.
    words = () if os.geteuid() else ("setpriv", *powers)
    if not can(*words, sys.executable, "-c", "import scenec.lab.runner"):
        pytest.skip("nobody cannot read these files")
    found = left_out(*words)
    shimmed = {"share fails", "clock back"} if shutil.which("cc") is None else set()
    assert set(found) == ROOTS | shimmed
    assert all(why.strip() and "\n" not in why for why in found.values()), found


def test_without_tools_faults_that_run_one_are_left_out(tmp_path):
    found = left_out(PATH=str(tmp_path))
    assert set(found) == ROOTS | {"share fails", "clock back"}
    assert found["clock back"] == found["share fails"] == "it needs cc"


def test_where_images_cannot_be_mounted_what_needs_one_is_left_out():
    # Root of a user namespace mounts tmpfs, but no image.
    words = ("unshare", "--map-root-user", "--mount")
    if not can(*words, "true"):
        pytest.skip("no user namespaces here")
    found = left_out(*words)
    assert {"quota", "share stalls", "read-only"} <= set(found)
    assert "disk full" not in found, found


def test_if_nothing_is_left_the_study_says_why_and_ends(tmp_path):
    done = subprocess.run(
        [sys.executable, STUDY, "--only", "quota,clock back"],
        env=os.environ | {"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "left out: quota (" in done.stdout
    assert "left out: clock back (it needs cc)\n" in done.stdout
    assert done.stderr == "faults.py: none of these faults can be made here\n"


@pytest.mark.parametrize("runs", [0, 1, 11, 12, 13, 30])
def test_no_pair_is_taken_twice_before_all_were(runs):
    faults, commands = ["kill", "quota", "clock back"], ["compile", "scan", "view", "export"]
    found = pairs(random.Random(3), faults, commands, runs)
    assert len(found) == (runs or 12)
    times = Counter(found)
    counts = [times[pair] for pair in product(faults, commands)]
    assert sum(counts) == len(found)
    assert max(counts) - min(counts) <= 1
    assert len({fault for fault, _ in found[: len(faults)]}) == min(len(found), len(faults))


def test_another_seed_is_another_order():
    faults, commands = [str(number) for number in range(9)], ["compile", "scan"]
    orders = [pairs(random.Random(seed), faults, commands) for seed in (0, 0, 1)]
    assert orders[0] == orders[1] != orders[2]


@pytest.mark.parametrize(
    ("script", "wrong"),
    [
        ("", []),
        ("raise SystemExit('scenec: a.json: No space left on device')", []),
        ("raise ValueError(1)", ["traceback"]),
        ("raise SystemExit(1)", ["says nothing"]),
        ("raise SystemExit('scenec: No space left on device')", ["names no file"]),
        ("raise SystemExit('scaling\\nscenec: File too large')", ["names no file"]),
    ],
)
def test_a_command_that_tells_its_user_too_little_is_found(script, wrong, tmp_path):
    line = [sys.executable, "-c", script]
    status, _, found = disturbed(Disturbed(tmp_path), line, mark=f"test {tmp_path}")
    assert [each.partition(":")[0] for each in found] == wrong
    assert (status == 0) == (script == "")


def test_a_process_that_a_command_leaves_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "LEAVING_S", 0.0)
    # It ends once its file is gone.
    stays = "import pathlib, time\nwhile pathlib.Path('here').exists(): time.sleep(0.05)"
    starts = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {stays!r}])"
    here = tmp_path / "here"
    here.touch()
    monkeypatch.chdir(tmp_path)
    line = [sys.executable, "-c", starts]
    _, _, found = disturbed(Disturbed(tmp_path), line, mark=f"test {tmp_path}")
    here.unlink()
    assert [each.partition(":")[0] for each in found] == ["leaves processes"]


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_happens_to_the_command_that_it_is_made_for(fault, tmp_path):
    probe = tmp_path / "probe"
    probe.mkdir()
    if why := obstacle(fault, probe):
        pytest.skip(why)
    on = Disturbed(tmp_path / "output")
    on.folder.mkdir()
    (on.folder / "there").write_text("there", encoding="utf-8")
    lines = EFFECTS[fault].replace("\n", "\n  ")
    script = f"{OUT}(out.parent / 'ready').touch()\ntry:\n  {lines}\n"
    script += "except OSError as error: print(error.errno or error.args[0])"
    with contextmanager(FAULTS[fault])(on, 1.0):
        line = [sys.executable, "-c", script, str(on.folder)]
        happens, ready = on.moment, tmp_path / "ready"

        def moment(process: subprocess.Popen[bytes]) -> None:
            until(ready.exists, process)
            happens(process)

        on.moment = moment
        status, said, wrong = disturbed(on, line, mark=f"test {tmp_path}")
    assert wrong == []
    if fault in SIGNALS:
        assert (status, said) == (-SIGNALS[fault], "")
    else:
        assert (status, int(said or 0) in SAID[fault]) == (0, True), said
    # Other people's file systems are gone from its folder, and its own files are there.
    assert not on.folder.is_mount()
    assert (on.folder / "there").read_text(encoding="utf-8") == "there"
