"""Says how a Python package that is missing is installed: by an extra of scenec."""

from __future__ import annotations

import sys

#: Extras whose wheels are not there for each Python that scenec works with, and those they are for
#: (the markers in pyproject.toml).
PYTHONS = {"cycles": ((3, 13),), "osmesa": ((3, 12), (3, 13)), "flip": ((3, 12), (3, 13))}


def install(extra: str) -> str:
    """Returns the command that installs an extra; names its Pythons where this is none of them."""
    command = f"pip install 'scenec[{extra}]'"
    pythons = PYTHONS.get(extra)
    if pythons is None or sys.version_info[:2] in pythons:
        return command
    names = " or ".join(f"{major}.{minor}" for major, minor in pythons)
    here = f"{sys.version_info[0]}.{sys.version_info[1]}"
    return f"{command}, with Python {names} (there is no wheel for {here})"
