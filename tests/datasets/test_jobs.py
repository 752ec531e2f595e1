"""Who stores frames: what is where no semaphores can be made."""

from __future__ import annotations

import subprocess
import sys

import pytest


def test_where_semaphores_cannot_be_made_workers_need_none():
    hide = 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$@"'
    private = ["unshare", "--map-root-user", "--mount", "sh", "-c", hide, "sh"]
    try:
        subprocess.run([*private, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no file systems of one's own here")
    code = (
        "import multiprocessing\n"
        "from scenec.backends.run.executors import Processes\n"
        "from scenec.backends.run.units import OfBackend\n"
        "from scenec.schemas.units import run_all\n"
        "try: multiprocessing.Lock()\n"
        "except OSError: print('no lock')\n"
        "with Processes(2) as workers:\n"
        "    units = [OfBackend(text, len) for text in ('a', 'bc', 'def')]\n"
        "    print([o.result() for _, o in run_all(workers, units, in_order=True, ahead=2)])\n"
    )
    line = [*private, sys.executable, "-c", code]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("no lock\n[1, 2, 3]\n", "")
