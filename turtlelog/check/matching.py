"""A run beside a reference, with one tolerance for all or a list of them."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from turtlelog.check.reference import Reference, load_reference
from turtlelog.check.result import CheckResult, Verdict
from turtlelog.check.runs import convert_finding
from turtlelog.compare import Finding, Tolerance, Tolerances, compare_runs, load_tolerances
from turtlelog.compare.ids import list_names
from turtlelog.compare.verdict import judge_metric
from turtlelog.errors import CheckError
from turtlelog.measure import Metric, list_signals, measure_run, read_signal
from turtlelog.run import Run

AnyTolerance = Tolerance | Tolerances | str | Path | None

_SIGNALS_APART: Final = Tolerance(abs=1e-6, reason="other platforms round otherwise")
_METRICS_APART: Final = Tolerance(abs=1e-9, rel=1e-6, reason="other platforms round otherwise")


def match_run(
    run: Run,
    reference: Run | Reference | Mapping[str, Metric] | str | Path,
    tolerance: AnyTolerance,
    *,
    file: str,
) -> list[CheckResult]:
    """Return how a run compares with a reference.

    Raises:
        CheckError: Where the reference cannot be read, or the tolerance does not fit it.
        CompareError: Where the runs do not overlap.
    """
    if isinstance(reference, Reference):
        reference = reference.load()
    if isinstance(reference, str | Path):
        reference = load_reference(Path(reference))
    if isinstance(tolerance, str | Path):
        tolerance = load_tolerances(tolerance)
    if isinstance(tolerance, Tolerances) and not tolerance:
        raise CheckError("tolerance: expected at least one signal or metric, found none")
    if isinstance(reference, Run):
        return _match_runs(run, reference, tolerance, file)
    return _match_metrics(run, reference, tolerance, file)


def _match_runs(
    run: Run, reference: Run, tolerance: Tolerance | Tolerances | None, file: str
) -> list[CheckResult]:
    tolerances = tolerance
    if not isinstance(tolerances, Tolerances):
        tolerances = _spread(run, reference, tolerances or _SIGNALS_APART)
    findings = compare_runs(reference, run, tolerances=tolerances).findings
    results = [convert_finding(finding, run.declaration, file=file) for finding in findings]
    if not isinstance(tolerance, Tolerances):
        window_s = 0.0 if tolerance is None else tolerance.time_s
        results.append(_judge_length(run, reference, window_s, file))
    return results


def _spread(run: Run, reference: Run, tolerance: Tolerance) -> Tolerances:
    """Return one tolerance for every signal that either run holds."""
    label = dataclasses.replace(tolerance, abs=0.0, rel=0.0)
    held = {
        name: kind
        for found in (run, reference)
        for name, kind in list_signals(found.declaration).items()
        if read_signal(found, name) is not None
    }
    names = list_names([run.declaration, reference.declaration])
    return Tolerances(
        signals={
            name: label if held[name].compared_as == "label" else tolerance
            for name in names
            if name in held
        }
    )


def _judge_length(run: Run, reference: Run, window_s: float, file: str) -> CheckResult:
    """Return whether both are as long: signals are compared only where they overlap."""
    lengths_s = [(found.end_ns - found.start_ns) / 1e9 for found in (run, reference)]
    off_s, limit_s = abs(lengths_s[0] - lengths_s[1]), max(window_s, 1e-6)
    return CheckResult(
        file=file,
        check="length",
        verdict=Verdict.PASS if off_s <= limit_s else Verdict.FAIL,
        expected="as long as the reference",
        value=off_s,
        limit=limit_s,
        margin=limit_s - off_s,
        unit="s",
        first_violation_s=None if off_s <= limit_s else min(lengths_s),
        reason="" if off_s <= limit_s else f"{lengths_s[0]:g} s long, not {lengths_s[1]:g} s",
        names=("distance", "speed", "turn_rate"),
    )


def _match_metrics(
    run: Run,
    reference: Mapping[str, Metric],
    tolerance: Tolerance | Tolerances | None,
    file: str,
) -> list[CheckResult]:
    if isinstance(tolerance, Tolerances):
        if tolerance.signals:
            name = next(iter(tolerance.signals))
            raise CheckError(f"tolerance: expected metrics alone, as the reference's: {name}")
        wanted = dict(tolerance.metrics)
    else:
        wanted = dict.fromkeys(reference, tolerance or _METRICS_APART)
    missing = sorted(wanted.keys() - reference.keys())
    if missing:
        raise CheckError(f"reference: expected the metric {missing[0]}, found none")
    measured = measure_run(run, only=list(wanted))
    findings: Sequence[Finding] = [
        judge_metric(measured[name], reference[name], found) for name, found in wanted.items()
    ]
    # What never had a value is as it was.
    return [
        convert_finding(finding, run.declaration, file=file, is_strict=False)
        for finding in findings
    ]
