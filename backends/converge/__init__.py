"""Error against run time: how the pictures of each backend converge, and where they differ."""

from scenec.backends.converge.ladder import Ladder, Rung
from scenec.backends.converge.run import converge
from scenec.backends.converge.series import ConvergeReport

__all__ = ["ConvergeReport", "Ladder", "Rung", "converge"]
