"""Error against run time: how the pictures of each backend converge, and where they differ."""

from scenec.studies.converge.ladder import Ladder, Rung
from scenec.studies.converge.run import converge
from scenec.studies.converge.series import ConvergeReport

__all__ = ["ConvergeReport", "Ladder", "Rung", "converge"]
