"""Processes that store frames: that they end with their parent, and what is where none can be."""

from __future__ import annotations

import resource
import subprocess
import sys

import psutil
import pytest

from scenec.datasets.view.jobs import Pool
from scenec.schemas.errors import OutputError
from scenec.testing.processes import until_gone

PROGRAM = """
import time
from scenec.datasets.view.jobs import Pool

if __name__ == "__main__":
    with Pool([], 2) as pool:
        print(sum(pool.over(abs, range(-20, 0))), flush=True)
        time.sleep(600)
"""


def test_workers_end_where_their_parent_is_killed(tmp_path):
    file = tmp_path / "program.py"
    file.write_text(PROGRAM)
    process = subprocess.Popen([sys.executable, file], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "210\n"
    workers = psutil.Process(process.pid).children(recursive=True)
    assert len(workers) >= 2
    process.kill()
    process.communicate()
    for worker in workers:
        until_gone(worker.pid)


def test_where_semaphores_cannot_be_made_one_process_does_it():
    hide = 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$@"'
    private = ["unshare", "--map-root-user", "--mount", "sh", "-c", hide, "sh"]
    try:
        subprocess.run([*private, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no file systems of one's own here")
    code = (
        "import multiprocessing\n"
        "from scenec.datasets.view.jobs import Pool\n"
        "try: multiprocessing.Lock()\n"
        "except OSError: print('no lock')\n"
        "with Pool([], 2) as pool: print(list(pool.over(abs, [-1, 2, -3])))\n"
    )
    line = [*private, sys.executable, "-c", code]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("no lock\n[1, 2, 3]\n", "")


def test_a_process_that_cannot_be_started_later_is_said():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with Pool([], 2) as pool:
        resource.setrlimit(resource.RLIMIT_NOFILE, (psutil.Process().num_fds(), hard))
        try:
            with pytest.raises(OutputError, match=r"Too many open files; try --workers 1"):
                list(pool.over(abs, range(3)))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
