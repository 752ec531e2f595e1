"""Error against cost of the compiler's own approximations, one varied at a time.

Each approximation has a ladder: rungs around the cfg's value. A rung's error is measured against a
reference that does not depend on it, beside the error that the rung itself claims (what
``report.json`` says), the processor's seconds, and the bytes it adds to the stage. Nothing of this
is part of compiling, and nothing is written to an output.
"""

from scenec.quality.ladder.results import APPROXIMATIONS, Ladder, LadderReport, Rung
from scenec.quality.ladder.run import climb

__all__ = ["APPROXIMATIONS", "Ladder", "LadderReport", "Rung", "climb"]
