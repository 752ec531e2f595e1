"""Leaves out tests that need packages which are not installed, and says so."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

from scenec.schemas.extras import install


def missing(*packages: str) -> list[str]:
    """Lists those of some packages that are not installed."""
    return [name for name in packages if find_spec(name) is None]


def needs(extra: str, *packages: str) -> pytest.MarkDecorator:
    """Marks tests that are skipped without an extra's packages: why, and what installs them."""
    lacking = missing(*packages)
    reason = f"needs {', '.join(lacking)}: {install(extra)}"
    return pytest.mark.skipif(bool(lacking), reason=reason)
