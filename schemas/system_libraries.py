"""Finds system libraries that renderers load, and the packages that bring missing ones.

Wheels bring no X11 and no OpenGL. Slim images of containers have neither, and a loader names only
the first library that it misses.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable

#: Name of a library: its package in Debian and Ubuntu, and in Fedora.
_PACKAGES = {
    "libatomic.so.1": ("libatomic1", "libatomic"),
    "libz.so.1": ("zlib1g", "zlib-ng-compat"),
    "libEGL.so.1": ("libegl1", "libglvnd-egl"),
    "libGL.so.1": ("libgl1", "libglvnd-glx"),
    "libOpenGL.so.0": ("libopengl0", "libglvnd-opengl"),
    "libICE.so.6": ("libice6", "libICE"),
    "libSM.so.6": ("libsm6", "libSM"),
    "libX11.so.6": ("libx11-6", "libX11"),
    "libXext.so.6": ("libxext6", "libXext"),
    "libXfixes.so.3": ("libxfixes3", "libXfixes"),
    "libXi.so.6": ("libxi6", "libXi"),
    "libXrender.so.1": ("libxrender1", "libXrender"),
    "libXt.so.6": ("libxt6", "libXt"),
    "libxkbcommon.so.0": ("libxkbcommon0", "libxkbcommon"),
}
#: What bpy's wheel needs and does not bring.
OF_BLENDER = (
    "libX11.so.6", "libXrender.so.1", "libXfixes.so.3", "libXi.so.6", "libXext.so.6", "libXt.so.6",
    "libSM.so.6", "libICE.so.6", "libxkbcommon.so.0", "libGL.so.1",
)  # fmt: skip
#: What Mitsuba's and Dr.Jit's wheels need and do not bring.
OF_MITSUBA = ("libatomic.so.1", "libz.so.1")
#: What draws without a window: EGL, and OpenGL, which either of two libraries gives.
OF_EGL = ("libEGL.so.1", "libOpenGL.so.0")


def missing(names: Iterable[str]) -> tuple[str, ...]:
    """Lists those libraries that cannot be loaded on this machine."""
    return tuple(name for name in names if not _loads(name))


def mend(names: Iterable[str]) -> str:
    """Says which libraries are missing and what brings them, without the first word.

    Args:
        names: Of missing libraries, each one of those above.
    """
    names = tuple(names)
    debian, fedora = zip(*(_PACKAGES[name] for name in names), strict=True)
    return (
        f"the system lacks {', '.join(names)}; mend it with: apt install {' '.join(debian)} "
        f"(Debian, Ubuntu), or dnf install {' '.join(fedora)} (Fedora)"
    )


def _loads(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True
