"""The backend of docs/backends.md conforms, as it stands there."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("embreex")
PAGE = Path(__file__).resolve().parents[3] / "docs" / "backends.md"


def block(name: str) -> str:
    """Code of a file on the page."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.search(rf"`{re.escape(name)}`:\n\n```python\n(.*?)```", text, re.DOTALL)
    assert found, name
    return found[1]


sys.modules["scenec_embree"] = ModuleType("scenec_embree")
exec(block("scenec_embree.py"), vars(sys.modules["scenec_embree"]))
exec(block("test_scenec_embree.py"), globals())
