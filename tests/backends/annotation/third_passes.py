"""Passes of other packages, found through entry points here and in workers."""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path

import pytest

#: The pass of docs/recipes.md, as it stands there.
ASPECT = re.search(
    r"<!-- file: aspect/scenec_aspect.py -->\n```python\n(.*?)```",
    (Path(__file__).resolve().parents[3] / "docs" / "recipes.md").read_text(encoding="utf-8"),
    re.DOTALL,
)[1]

#: One of the whole picture with two channels: where its own camera shows what a pixel shows.
PLACE = """
import numpy as np
from scenec.backends.annotation.contract import Pass, Picture
from scenec.backends.annotation.passes import position
from scenec.schemas.lens import pixels_at

def place(picture: Picture) -> np.ndarray:
    pose = picture.camera.camera_to_world
    local = (picture.once(position) - pose[:3, 3]) @ pose[:3, :3]
    return pixels_at(picture.camera.lens, picture.camera.intrinsics, local)

PLACE = Pass(
    name="place", channels=("column", "row"), convention="pixels", compute=place, whole=True,
)
"""


def install(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    passes: Mapping[str, str],
    package: str = "scenec_aspect",
) -> Path:
    """Make a package known; returns its folder.

    Args:
        folder: Where packages go.
        monkeypatch: The test's.
        passes: Sources by the name of the entry point; its value is that name in capitals.
        package: Its name; each module's is of it and of the pass.
    """
    site = folder / package
    info = site / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = ["[scenec.passes]"]
    for name, source in passes.items():
        module = f"{package}_{name}"
        (site / f"{module}.py").write_text(textwrap.dedent(source))
        lines.append(f"{name} = {module}:{name.upper()}")
        monkeypatch.delitem(sys.modules, module, raising=False)
    (info / "entry_points.txt").write_text("\n".join([*lines, ""]))
    monkeypatch.syspath_prepend(str(site))
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    return site
