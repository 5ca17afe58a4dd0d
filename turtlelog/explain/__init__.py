"""From a log to the reason, by numbers."""

from turtlelog.explain.attribute import (
    attribute_run,
    attribute_scenario,
    choose_metric,
    require_mechanisms,
)
from turtlelog.explain.attribution import (
    Attribution,
    Grain,
    SeedRange,
    Share,
    StartRange,
    Together,
    ValueSet,
)
from turtlelog.explain.game import Work
from turtlelog.explain.hypothesis import require_trust
from turtlelog.explain.identification import Certainty, Finding, Identification
from turtlelog.explain.identify import identify_run
from turtlelog.explain.law_identification import describe_loop_name
from turtlelog.explain.mechanisms import find_mechanisms, simulate_without
from turtlelog.explain.motion_facts import Delays, Largest, MotionFacts, Periods, read_motion_facts
from turtlelog.explain.report import write_sentences
from turtlelog.explain.resimulation import Resimulation
from turtlelog.explain.what_ifs import name_without, simulate_what_ifs

__all__ = [
    "Attribution",
    "Certainty",
    "Delays",
    "Finding",
    "Grain",
    "Identification",
    "Largest",
    "MotionFacts",
    "Periods",
    "Resimulation",
    "SeedRange",
    "Share",
    "StartRange",
    "Together",
    "ValueSet",
    "Work",
    "attribute_run",
    "attribute_scenario",
    "choose_metric",
    "describe_loop_name",
    "find_mechanisms",
    "identify_run",
    "name_without",
    "read_motion_facts",
    "require_mechanisms",
    "require_trust",
    "simulate_what_ifs",
    "simulate_without",
    "write_sentences",
]
