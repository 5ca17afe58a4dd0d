"""From a log to the reason, by numbers."""

from turtlelog.explain.finding import Certainty, Finding
from turtlelog.explain.identify import Identification, identify_run
from turtlelog.explain.resimulation import Resimulation

__all__ = ["Certainty", "Finding", "Identification", "Resimulation", "identify_run"]
