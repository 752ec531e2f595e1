"""Error against run time: how the pictures of each backend converge, and where they differ."""

from scenec.backends.converge.ladder import Ladder, Rung
from scenec.backends.converge.run import ConvergeReport, converge

__all__ = ["ConvergeReport", "Ladder", "Rung", "converge"]
