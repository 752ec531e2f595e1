"""Prints the lock of what scenec and some extras need: ``python tools/locked.py [EXTRA...]``."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def plain(name: str) -> str:
    """A distribution's name as the lock spells it."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\s\[<>=!~;]", name, maxsplit=1)[0]).lower()


def main() -> None:
    """Follows the lock's own notes of who needs what ("via")."""
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    entries = {plain(e.split("==")[0]): e for e in re.split(r"\n(?=[A-Za-z])", lock.strip())}
    via = {
        name: {plain(w) for line in entry.splitlines() for w in _needers(line)}
        for name, entry in entries.items()
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = (project["optional-dependencies"][name] for name in sys.argv[1:])
    listed = [*project["dependencies"], *(need for extra in extras for need in extra)]
    needed = {"setuptools", *map(plain, listed)}
    before = 0
    while len(needed) > before:
        before = len(needed)
        needed |= {name for name, needers in via.items() if needers & needed}
    print("\n".join(entries[name] for name in sorted(needed)))


def _needers(line: str) -> list[str]:
    text = line.strip().removeprefix("#").strip().removeprefix("via").strip()
    return [text] if line.strip().startswith("#") and text else []


if __name__ == "__main__":
    main()
