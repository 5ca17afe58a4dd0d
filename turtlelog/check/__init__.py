"""Assertions on recordings."""

from turtlelog.check.failure_report import Artifacts, ArtifactWriter, write_artifacts
from turtlelog.check.formula import FormulaResult, check_formula, check_run
from turtlelog.check.formula_trace import Signals, read_signals
from turtlelog.check.judge_difference import judge_replay, match_run
from turtlelog.check.judge_run import check_runs
from turtlelog.check.piecewise_constant import Steps
from turtlelog.check.recording import Recording
from turtlelog.check.result import (
    CheckResult,
    MissingValueError,
    PartialLogError,
    UndecidedError,
    Verdict,
    join_verdicts,
)
from turtlelog.check.robustness import compute_robustness
from turtlelog.check.spec import Check, Spec, Tolerances
from turtlelog.check.spec_file import load_spec, load_tolerances, parse_spec

__all__ = [
    "ArtifactWriter",
    "Artifacts",
    "Check",
    "CheckResult",
    "FormulaResult",
    "MissingValueError",
    "PartialLogError",
    "Recording",
    "Signals",
    "Spec",
    "Steps",
    "Tolerances",
    "UndecidedError",
    "Verdict",
    "check_formula",
    "check_run",
    "check_runs",
    "compute_robustness",
    "join_verdicts",
    "judge_replay",
    "load_spec",
    "load_tolerances",
    "match_run",
    "parse_spec",
    "read_signals",
    "write_artifacts",
]
