"""The Containerfile installs what renderers load of the system."""

from __future__ import annotations

import re
from pathlib import Path

from scenec.schemas import system_libraries
from scenec.schemas.system_libraries import OF_BLENDER, OF_EGL, OF_MITSUBA

ROOT = Path(__file__).resolve().parents[2]


def test_the_image_has_every_library_that_wheels_do_not_bring():
    text = (ROOT / "Containerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    (installed,) = re.findall(r"apt-get install (.*?)&&", text)
    needed = re.search(
        r"apt install ([^(]*) \(", system_libraries.mend((*OF_MITSUBA, *OF_EGL, *OF_BLENDER))
    )
    assert needed is not None
    assert set(needed[1].split()) <= set(installed.split())
