"""The backend of the example package conforms, by the test that stands beside it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("embreex")
sys.path.append(str(Path(__file__).resolve().parents[3] / "docs" / "example_plugins"))

from test_scenec_embree import TestEmbree as TestEmbree
