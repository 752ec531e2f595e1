"""pyrender as a backend: ids drawn by OpenGL, a quick preview."""

from scenec.backends.pyrender.adapter import Pyrender

__all__ = ["Pyrender"]
