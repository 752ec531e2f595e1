"""``make audit`` ends tests that leave something open, however many processes it takes."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest

from scenec.testing.processes import ran

ROOT = Path(__file__).resolve().parents[2]
TESTS = """
import warnings

def test_closes(tmp_path):
    (tmp_path / "a").write_text("a")

def test_leaves_open(tmp_path):
    (tmp_path / "a").open("w").write("a")

def test_uses_what_is_deprecated():
    warnings.warn("old", DeprecationWarning)

def test_uses_what_numpy_calls_invalid():
    import numpy as np
    np.zeros(1) / 0
"""


@pytest.mark.slow
@pytest.mark.skipif(
    not shutil.which("make") or not (ROOT / ".venv").exists(), reason="needs make, and its .venv"
)
@pytest.mark.parametrize("workers", ["1", "2"])
def test_what_warns_fails_under_make_audit(workers, tmp_path):
    (tmp_path / "test_of_an_audit.py").write_text(TESTS, encoding="utf-8")
    # A module without tests, beside the configuration of all of them.
    paths = f"tests/elsewhere.py {tmp_path / 'test_of_an_audit.py'} -p no:cacheprovider"
    # Nor what the run of tests or the make that this one is part of was told.
    told = ("PYTEST_", "MAKE", "MFLAGS")
    environment = {key: os.environ[key] for key in os.environ if not key.startswith(told)}
    words = ["make", "-o", "setup", "audit", f"WORKERS={workers}", f"PYTEST_ARGS={paths}"]
    done = ran(*words, cwd=ROOT, env=environment)
    failed = set(re.findall(r"^FAILED \S*::(\w+)", done.stdout, re.M))
    assert failed == {
        "test_leaves_open",
        "test_uses_what_is_deprecated",
        "test_uses_what_numpy_calls_invalid",
    }, done.stdout + done.stderr
    assert "1 passed" in done.stdout
