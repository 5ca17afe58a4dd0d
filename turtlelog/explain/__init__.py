"""From a log to the reason, by numbers."""

from turtlelog.explain.attribute import (
    DEFAULT_MECHANISMS,
    DEFAULT_METRIC,
    Attribution,
    Share,
    attribute_run,
    attribute_scenario,
    require_players,
)
from turtlelog.explain.finding import Certainty, Finding
from turtlelog.explain.identification import Identification
from turtlelog.explain.identify import identify_run
from turtlelog.explain.mechanisms import MECHANISMS, Mechanism, simulate_without
from turtlelog.explain.resimulation import Resimulation
from turtlelog.explain.wording import write_sentences

__all__ = [
    "DEFAULT_MECHANISMS",
    "DEFAULT_METRIC",
    "MECHANISMS",
    "Attribution",
    "Certainty",
    "Finding",
    "Identification",
    "Mechanism",
    "Resimulation",
    "Share",
    "attribute_run",
    "attribute_scenario",
    "identify_run",
    "require_players",
    "simulate_without",
    "write_sentences",
]
