"""Records what a major version promises: run once, when it begins.

    python lab/robustness/promises.py

``tests/packaging/test_guarantees.py`` then holds every later version to it.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import scenec
from scenec.testing.promises import kept_cfg, promised
from scenec.testing.small import write_cfg

KEPT = Path(__file__).resolve().parents[2] / "tests" / "packaging" / "kept"


def main() -> None:
    """Writes ``promises.json``, a cfg and what was made of it."""
    shutil.rmtree(KEPT, ignore_errors=True)
    KEPT.mkdir()
    rows = (
        f"{json.dumps(part)}: {{\n"
        + ",\n".join(
            f"{json.dumps(key)}: {json.dumps(facts[key], sort_keys=True)}" for key in sorted(facts)
        )
        + "\n}"
        for part, facts in sorted(promised().items())
    )
    (KEPT / "promises.json").write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")
    cfg = write_cfg(KEPT, kept_cfg(), "kept.json")
    scenec.run(cfg, KEPT / "output", seed=1, backend="mitsuba", spp=4)


if __name__ == "__main__":
    main()
