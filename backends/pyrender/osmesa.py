"""PyOpenGL's OSMesa platform, with the library where ``platforms.load_osmesa`` finds it.

PyOpenGL looks for a ``libOSMesa.so`` on the system's paths only; a plugin is its documented way to
tell it better. PyOpenGL imports this module itself, by name.
"""

from __future__ import annotations

from typing import Any

from OpenGL.platform import baseplatform
from OpenGL.platform.osmesa import OSMesaPlatform

from scenec.backends.pyrender.platforms import load_osmesa


class WheelOSMesaPlatform(OSMesaPlatform):
    """Differs from PyOpenGL's platform only in the library's path."""

    @baseplatform.lazy_property
    def GL(self) -> Any:  # noqa: N802
        """The library; PyOpenGL takes OSMesa's own functions from it too."""
        return load_osmesa()
