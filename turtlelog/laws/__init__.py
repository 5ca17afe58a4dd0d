"""Control laws, one per file: the thing under test."""

from turtlelog.laws.base import ABSENT_BY_DEFAULT, MAY_BE_INFINITE, Decision, Goal, Law, Pose
from turtlelog.laws.loading import (
    LAWS,
    declare_law,
    describe_law_error,
    find_law,
    list_mechanisms,
    list_sample_counters,
    list_unused_keys,
    print_to_stderr,
    require_law_name,
)
from turtlelog.laws.schedule import GainSchedule, PIDGainSchedule
from turtlelog.laws.sequential_p import SequentialP, SequentialPParameters
from turtlelog.laws.sequential_pid import SequentialPID, SequentialPIDParameters

__all__ = [
    "ABSENT_BY_DEFAULT",
    "LAWS",
    "MAY_BE_INFINITE",
    "Decision",
    "GainSchedule",
    "Goal",
    "Law",
    "PIDGainSchedule",
    "Pose",
    "SequentialP",
    "SequentialPID",
    "SequentialPIDParameters",
    "SequentialPParameters",
    "declare_law",
    "describe_law_error",
    "find_law",
    "list_mechanisms",
    "list_sample_counters",
    "list_unused_keys",
    "print_to_stderr",
    "require_law_name",
]
