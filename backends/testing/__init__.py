"""The conformance suite: does a renderer show what a scene says?

A backend's tests are its class and a table of what it may be off by, with a reason each::

    from scenec.backends.testing import Conformance, Lacks, Tolerance

    class TestMine(Conformance):
        backend = Mine
        tolerances = {
            "lambert": Tolerance(mean=2e-3, pixel=1e-2, reason="half floats"),
            "cavity": Lacks("light goes from a lamp to a surface and no further"),
        }

Run by pytest, which nothing but this package of scenec imports. See ``docs/backends.md``.
"""

from scenec.backends.testing.conformance import Conformance
from scenec.backends.testing.tolerance import Lacks, Tolerance

__all__ = ["Conformance", "Lacks", "Tolerance"]
