"""Results of a run: against a specification, a reference, or its replay."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeAlias

from turtlelog.check.formula_trace import find_loss
from turtlelog.check.judge_formula import Grown, judge_check, measure_named
from turtlelog.check.reference import (
    MetricsFile,
    ReferenceFile,
    load_reference,
    read_reference_run,
    read_reference_trajectory,
)
from turtlelog.check.result import CheckResult, JudgedSignal, Verdict
from turtlelog.check.spec import Check, Spec, Tolerances
from turtlelog.check.spec_file import count_parts, load_tolerances
from turtlelog.check.vocabulary import TrajectoryJudge, choose_signals
from turtlelog.compare import Tolerance
from turtlelog.compare.common_clock import find_zero_ns
from turtlelog.compare.difference import compare_metrics, compare_signals, explain_lack
from turtlelog.display import format_number, format_pair
from turtlelog.errors import CheckError, CompareError, ExpressionError
from turtlelog.files.urls import make_path
from turtlelog.measure import (
    SIGNALS,
    Metric,
    find_metric_kind,
    find_signal,
    list_metrics,
    list_signal_units,
    list_signals,
    measure_run,
)
from turtlelog.replay import Difference, LawReplay, LoopReplay, PlantReplay, SignalDifference
from turtlelog.run import Run

_MOST_PART_ROWS: Final = 150_000_000
"""Largest product of formula parts and samples. A window takes about 10 ns for each of its four
parts and each sample. All four parts together take 2 s, on a busy machine 5 s."""
_EXPECT: Final = 6
"""Number of additional parts that a bound on a metric counts as, because its violation is searched
by bisection of the run."""
_ANY_PARTS: Final = 400
"""Number of names, numbers and operators that are always allowed, however long the recording is."""


def check_runs(
    spec: Spec, runs: Iterable[tuple[str, Run]], *, allow_partial: bool = False
) -> Iterator[CheckResult]:
    """Yield the results of every check on every run, run by run, without keeping runs in memory.

    Args:
        spec: Specification to check.
        runs: Runs with the names of their files.
        allow_partial: Whether an incomplete recording may pass.

    Raises:
        CheckError: If there are no runs, or tolerances have no reference.
        LogError: If the reference cannot be read.
        ExpressionError: If operand types in a formula match on no run.
    """
    reference, trajectories = read_reference_run(spec), read_reference_trajectory(spec)
    count = 0
    for file, run in runs:
        count += 1
        yield from judge_run(
            spec, reference, run, file=file, allow_partial=allow_partial, trajectories=trajectories
        )
    if not count:
        raise CheckError(f"{spec.source}: no recording to check")


def judge_run(
    spec: Spec,
    reference: Run | MetricsFile | None,
    run: Run,
    *,
    file: str,
    allow_partial: bool = False,
    trajectories: TrajectoryJudge | None = None,
) -> Iterator[CheckResult]:
    """Yield the results of every check on one run; for an incomplete run, only one for the loss."""
    lost = None if allow_partial else find_loss(run)
    if lost is not None:
        yield fail_recording(file, lost)
        return
    _require_few_parts(spec, run, file)
    metrics = measure_named(spec.checks, run, trajectories=trajectories, file=file)
    grown: Grown = {}
    for check in spec.checks:
        try:
            yield judge_check(check, run, file=file, metrics=metrics, grown=grown)
        except ExpressionError as err:
            if not _names_parameters(check):
                raise
            # The keys and states of a law differ between recordings: other checks are judged
            # nevertheless.
            yield replace(fail_recording(file, str(err)), check=check.name)
    if reference is not None:
        yield from _judge_tolerances(spec, reference, run, file)


def _require_few_parts(spec: Spec, run: Run, file: str) -> None:
    rows = max(len(run.poses), len(run.commands), len(run.samples), 1)
    most = max(_ANY_PARTS, _MOST_PART_ROWS // rows)
    bounds = sum(check.kind == "expect" for check in spec.checks)
    parts = sum(map(count_parts, spec.checks)) + _EXPECT * bounds
    if parts > most:
        raise CheckError(
            f"{file}: the checks of {spec.source} take as long as {parts:,} names, numbers and"
            f" operators; {most:,} are the most for a recording of {rows:,} samples. Split the"
            " specification into several files, or the recording into parts"
        )


def _names_parameters(check: Check) -> bool:
    """Return whether a check names parameters or states, which depend on the law."""
    formulas = filter(None, (check.formula, check.when))
    names = (name for formula in formulas for name in formula.names)
    return any(name not in SIGNALS and find_metric_kind(name) is None for name in names)


def fail_recording(file: str, reason: str) -> CheckResult:
    """Return the result for a recording on which no check could be judged."""
    return CheckResult(
        file=file, check="recording", verdict=Verdict.FAIL, reason=reason, is_decided=False
    )


def _judge_tolerances(
    spec: Spec, reference: Run | MetricsFile, run: Run, file: str
) -> list[CheckResult]:
    try:
        return match_run(run, reference, spec.tolerances, file=file, alignment=spec.alignment)
    except CompareError as err:
        names = [f"signals.{name}" for name in spec.tolerances.signals]
        names += [f"metrics.{name}" for name in spec.tolerances.metrics]
        return [replace(fail_recording(file, str(err)), check=name) for name in names]


AnyTolerance: TypeAlias = Tolerance | Tolerances | str | Path | None
AnyReference: TypeAlias = Run | ReferenceFile | MetricsFile | Mapping[str, Metric] | str | Path

_SIGNALS_APART: Final = Tolerance(abs=1e-6, reason="other platforms round otherwise")
_METRICS_APART: Final = Tolerance(abs=1e-9, rel=1e-6, reason="other platforms round otherwise")


def match_run(
    run: Run,
    reference: AnyReference,
    tolerance: AnyTolerance = None,
    *,
    file: str = "",
    alignment: str = "first_sample",
) -> list[CheckResult]:
    """Return the results of comparing a run with a reference.

    Args:
        run: Run that is judged.
        reference: A run, its file, or metrics. If the reference is metrics, a value that is missing
            there must also be missing in the run.
        tolerance: Tolerance of every signal or metric; `Tolerances` or a file of them select the
            signals and metrics to judge. None: signals may differ by 1e-6, and metrics may be worse
            by a millionth.
        file: Name of the run in results; empty: the run's own name.
        alignment: Alignment, as in `compare_runs`.

    Raises:
        CheckError: If the reference cannot be read, or the tolerance does not fit it.
        CompareError: If there is no such alignment, or the runs do not overlap.
    """
    if isinstance(reference, ReferenceFile):
        reference = reference.load()
    if isinstance(reference, str | Path):
        reference = load_reference(make_path(reference))
    if isinstance(tolerance, str | Path):
        tolerance = load_tolerances(tolerance)
    if isinstance(tolerance, Tolerances) and not tolerance:
        raise CheckError("tolerance: names no signal or metric")
    if isinstance(reference, MetricsFile):
        results = _match_metrics(run, reference.metrics, tolerance)
    elif not isinstance(reference, Run):
        results = _match_metrics(run, reference, tolerance)
    elif isinstance(tolerance, Tolerances):
        results = [*_judge_run(run, reference, tolerance, alignment)]
    else:
        tolerances = _spread(run, reference, tolerance or _SIGNALS_APART)
        length = _judge_length(run, reference, 0.0 if tolerance is None else tolerance.time_s)
        results = [*_judge_run(run, reference, tolerances, alignment), length]
    shown = reference if isinstance(reference, Run | MetricsFile) else None
    return [replace(one, file=file or run.name, reference=shown) for one in results]


def judge_replay(
    run: Run, found: LawReplay | LoopReplay | PlantReplay, *, file: str
) -> list[CheckResult]:
    """Return whether a replay equals the recording: every signal, numbers of rows, and the end."""
    mode = {LawReplay: "law", LoopReplay: "loop", PlantReplay: "plant"}[type(found)]
    verb = "the law answers" if mode == "law" else "replayed"

    def describe(difference: Difference) -> str:
        unit = units.get(difference.signal, "")
        recorded, replayed = format_pair(difference.recorded, difference.replayed, unit)
        return f"recorded {recorded}, {verb} {replayed}"

    units = {signal.signal: signal.unit for signal in found.signals}
    known = list_signals(run.declaration)
    signals = [
        replace(
            _judge_signal(signal, f"{mode}.{signal.signal}", run.start_ns, describe),
            file=file,
            expected="as recorded",
            names=(signal.signal,) if signal.signal in known else ("speed", "turn_rate"),
        )
        for signal in found.signals
    ]
    others = [
        CheckResult(
            file=file,
            check=f"{mode}.{other.signal}",
            verdict=Verdict.FAIL,
            expected="as recorded",
            first_violation_s=(other.time_ns - run.start_ns) / 1e9,
            reason=describe(other),
            names=("distance", "speed", "turn_rate"),
        )
        for other in found.others
    ]
    return [*signals, *others]


def _judge_run(
    run: Run, reference: Run, tolerances: Tolerances, alignment: str
) -> Iterator[CheckResult]:
    differences = compare_signals(reference, run, tolerances.signals, alignment=alignment)
    start_ns = run.start_ns - find_zero_ns(run, alignment)  # zero of the times in results

    def describe(difference: Difference) -> str:
        sides = (difference.replayed, difference.recorded)
        at_s = (difference.time_ns - start_ns) / 1e9
        return f"{_tell_sides(sides, units[difference.signal])} at {at_s:.3f} s"

    units = list_signal_units([reference.declaration, run.declaration])
    for name, tolerance in tolerances.signals.items():
        check, names = f"signals.{name}", choose_signals([name], run.declaration)
        if name not in differences:
            reason = explain_lack(name, reference, run)
            yield _leave_open(check, units.get(name, ""), reason, names)
            continue
        found = differences[name]
        yield replace(
            _judge_signal(found, check, start_ns, describe),
            expected=_describe_tube(found, tolerance, alignment),
            names=names,
            judged=JudgedSignal(
                name=name, reference=reference, tolerance=tolerance, alignment=alignment
            ),
        )
    known = list_metrics(reference.declaration, run.declaration)
    for pair in compare_metrics(reference, run, list(tolerances.metrics)):
        metric, names = pair.metric, choose_signals([pair.metric.id], run.declaration)
        if metric.id in known:
            tolerance = tolerances.metrics[metric.id]
            yield _judge_metric(metric, pair.reference, tolerance, names, is_strict=True)
        else:
            yield _leave_open(f"metrics.{metric.id}", metric.unit, metric.lack, names)


def _judge_signal(
    found: SignalDifference, check: str, start_ns: int, describe: Callable[[Difference], str]
) -> CheckResult:
    """Return the verdict on a signal. A value that is missing on one side has no distance."""
    first, furthest = found.first_difference, found.largest_difference
    margin = found.limit - found.largest
    has_distance = math.isfinite(margin) and (first is None or margin < 0)
    told = furthest if has_distance and furthest is not None else first
    return CheckResult(
        file="",
        check=check,
        verdict=Verdict.PASS if first is None else Verdict.FAIL,
        value=found.largest if has_distance else None,
        limit=found.limit,
        margin=margin if has_distance else None,
        unit=found.unit,
        value_s=(furthest.time_ns - start_ns) / 1e9 if has_distance and furthest else None,
        first_violation_s=None if first is None else (first.time_ns - start_ns) / 1e9,
        reason="" if first is None or told is None else describe(told),
    )


def _judge_metric(
    metric: Metric,
    reference: Metric,
    tolerance: Tolerance,
    names: tuple[str, ...],
    *,
    is_strict: bool,
) -> CheckResult:
    """Return the verdict on a metric, which fails in its bad direction or with another status.

    If neither has a value, the metric passes unless `is_strict`.
    """
    check, unit = f"metrics.{metric.id}", metric.unit
    if metric.value is None or reference.value is None:
        is_same = metric.status == reference.status
        reason = f"same status as the reference: {_tell_status(metric)}"
        if not is_same:
            reason = f"{_tell_status(metric)}, where the reference has {_tell_status(reference)}"
        found = _leave_open(check, unit, reason, names)
        if is_strict or not is_same:
            return found
        return replace(found, verdict=Verdict.PASS, is_decided=True)
    kind = find_metric_kind(metric.id)
    if kind is None or metric.unit != reference.unit:
        reason = f"in {metric.unit}, where the reference has {reference.unit}: not compared"
        return _leave_open(check, unit, reason, names)
    off = kind.compute_loss(metric.value, reference.value)
    limit = max(tolerance.abs, tolerance.rel * abs(reference.value))
    sides = metric.value, reference.value
    return CheckResult(
        file="",
        check=check,
        verdict=Verdict.PASS if off <= limit else Verdict.FAIL,
        expected=f"within {format_number(limit, unit)} of the reference",
        value=off,
        limit=limit,
        margin=limit - off,
        unit=unit,
        reason="" if off <= limit else _tell_sides(sides, unit),
        names=names,
    )


def _leave_open(check: str, unit: str, reason: str, names: tuple[str, ...]) -> CheckResult:
    """Return that a metric or signal cannot be judged, which does not count as a pass."""
    return replace(fail_recording("", reason), check=check, unit=unit, names=names)


def _describe_tube(found: SignalDifference, tolerance: Tolerance, alignment: str) -> str:
    text = f"within {format_number(found.limit, found.unit)} of the reference"
    if not tolerance.time_s:
        return text
    if alignment == "sample":
        return f"{text}, sample by sample: no tolerance in time applies"
    return f"{text} within {tolerance.time_s:g} s"


def _tell_sides(sides: tuple[float | str | None, ...], unit: str) -> str:
    texts = [side if isinstance(side, str) else format_number(side, unit) for side in sides]
    return f"{texts[0]} where the reference has {texts[1]}"


def _tell_status(metric: Metric) -> str:
    return metric.lack if metric.reason else metric.status.value


def _spread(run: Run, reference: Run, tolerance: Tolerance) -> Tolerances:
    """Return one tolerance for every signal that either run contains."""
    label = replace(tolerance, abs=0.0, rel=0.0)
    held = {
        name: kind
        for found in (run, reference)
        for name, kind in list_signals(found.declaration).items()
        if find_signal(found, name) is not None
    }
    names = list_signal_units([run.declaration, reference.declaration])
    return Tolerances(
        signals={
            name: label if held[name].compared_as == "label" else tolerance
            for name in names
            if name in held
        }
    )


def _judge_length(run: Run, reference: Run, window_s: float) -> CheckResult:
    """Return whether both runs have the same length; signals are compared on the overlap."""
    lengths_s = [(found.end_ns - found.start_ns) / 1e9 for found in (run, reference)]
    off_s, limit_s = abs(lengths_s[0] - lengths_s[1]), max(window_s, 1e-6)
    return CheckResult(
        file="",
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
    run: Run, reference: Mapping[str, Metric], tolerance: Tolerance | Tolerances | None
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
        raise CheckError(f"reference: has no metric {missing[0]}")
    measured = measure_run(run, only=list(wanted))
    results = []
    for name, found in wanted.items():
        names = choose_signals([name], run.declaration)
        results.append(
            _judge_metric(measured[name], reference[name], found, names, is_strict=False)
        )
    return results
