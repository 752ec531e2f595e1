"""Processes that store frames end with the one that asked for them, however that ends."""

from __future__ import annotations

import subprocess
import sys

import psutil
from processes import until_gone

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
