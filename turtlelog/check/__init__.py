"""Assertions on recordings."""

from turtlelog.check.formula import Finding, check_formula, check_run
from turtlelog.check.robustness import compute_robustness
from turtlelog.check.signals import Signals, read_signals
from turtlelog.check.steps import Steps

__all__ = [
    "Finding",
    "Signals",
    "Steps",
    "check_formula",
    "check_run",
    "compute_robustness",
    "read_signals",
]
