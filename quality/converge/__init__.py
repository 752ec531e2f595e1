"""Error against run time: how the pictures of each backend converge, and where they differ."""

from scenec.quality.converge.ladder import Ladder, Rung
from scenec.quality.converge.run import converge
from scenec.quality.converge.series import ConvergeReport

__all__ = ["ConvergeReport", "Ladder", "Rung", "converge"]
