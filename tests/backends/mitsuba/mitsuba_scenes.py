"""The scenes of ``scenec.backends.testing`` under the name that ``test_mitsuba_stack`` has."""

from scenec.backends.testing.scenes import look_at, mesh, plane, scene, sun, surface

__all__ = ["look_at", "mesh", "plane", "scene", "sun", "surface"]
