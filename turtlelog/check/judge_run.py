"""Results of a specification on runs."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from turtlelog.check.formula_trace import find_loss
from turtlelog.check.judge_difference import match_run
from turtlelog.check.judge_formula import Grown, judge_check, list_formula_names, measure_named
from turtlelog.check.named_values import TRAJECTORY_VALUES, TrajectoryJudge
from turtlelog.check.reference import MetricsFile, read_metrics_file
from turtlelog.check.result import CheckResult, Verdict
from turtlelog.check.spec import Check, Spec
from turtlelog.check.spec_file import count_parts, require_reference
from turtlelog.errors import CheckError, CompareError, ExpressionError, LogError
from turtlelog.log import ReadChoice, read_as_chosen, read_trajectory, split_topic
from turtlelog.log.ros2.bag import open_bag
from turtlelog.log.ros2.bag_topics import JOINTS, TRANSFORMS
from turtlelog.measure import SIGNALS, find_metric_kind
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
            spec,
            reference,
            run,
            file=file,
            allow_partial=allow_partial,
            trajectories=trajectories,
        )
    if not count:
        raise CheckError(f"{spec.source}: no recording to check")


def read_reference_run(spec: Spec, topics: ReadChoice | None = None) -> Run | MetricsFile | None:
    """Return the run or metrics to which tolerances refer; None if no reference is needed.

    Args:
        spec: Specification that names the reference.
        topics: Topics as for the runs, in addition to those of the specification. A topic that the
            reference does not have gets the default. The reference must always be complete.

    Raises:
        CheckError: If tolerances have no reference, or signals have only metrics as reference.
        LogError: If the reference cannot be read.
    """
    require_reference(spec)
    if not spec.tolerances or spec.reference is None:
        return None
    if (metrics := read_metrics_file(spec.reference)) is not None:
        _require_metrics(spec, metrics)
        return metrics
    choice = _restrict(spec.read.override(topics or ReadChoice()), spec.reference)
    return read_as_chosen(spec.reference, choice)


def _require_metrics(spec: Spec, reference: MetricsFile) -> None:
    """Raise an error for tolerances to which a file of metrics cannot be compared."""
    if spec.tolerances.signals:
        name = next(iter(spec.tolerances.signals))
        raise CheckError(
            f"{spec.source}: [signals.{name}] needs a recording as its reference, and"
            f" {reference.file} has metrics alone"
        )
    missing = next((one for one in spec.tolerances.metrics if one not in reference.metrics), None)
    if missing is not None:
        raise CheckError(f"{spec.source}: [metrics]: {reference.file} has no metric {missing}")


def read_reference_trajectory(
    spec: Spec, topics: ReadChoice | None = None, *, reads_files: bool = False
) -> TrajectoryJudge | None:
    """Return the judge of errors relative to the reference trajectory; None without a reference.

    Args:
        spec: Specification that names the reference trajectory.
        topics: Topics as for the runs, in addition to those of the specification.
        reads_files: Whether runs are named by their files, from which poses in space are read.

    Raises:
        CheckError: If errors have no reference.
        LogError: If the reference cannot be read.
    """
    names = sorted(list_formula_names(spec.checks) & TRAJECTORY_VALUES.keys())
    if not names:
        return None
    if spec.reference is None:
        raise CheckError(
            f"{spec.source}: {names[0]} needs a trajectory that is true: reference = FILE in the"
            " file, or --reference FILE"
        )
    choice = spec.read.override(topics or ReadChoice())
    if split_topic(spec.reference)[0].exists():
        return TrajectoryJudge(
            reference=read_trajectory(spec.reference, _restrict(choice, spec.reference)),
            settings=spec.trajectory,
            choice=choice,
            reads_files=reads_files,
        )
    raise CheckError(f"{spec.source}: reference: {spec.reference}: no such file")


def _restrict(choice: ReadChoice, path: Path) -> ReadChoice:
    """Return the choice without the topics that a file does not have."""
    try:
        bag = open_bag(split_topic(path)[0])
    except LogError:
        held, is_own = set[tuple[str, str]](), False  # a log, or nothing that can be read
    else:
        held = {(topic.topic, topic.type) for topic in bag.topics if topic.count}
        is_own = any(info.format_version is not None for info in bag.infos.values())
    names = {name for name, _ in held}
    changes: dict[str, Any] = {
        key: name if name in names else None
        for key in ("pose_topic", "command_topic", "path_topic")
        if (name := getattr(choice, key)) is not None
    }
    has_frames = TRANSFORMS in {kind for _, kind in held}
    changes |= {} if has_frames else {"pose_frame": None, "world_frame": None}
    if JOINTS not in {kind for _, kind in held}:
        changes |= {"wheel_joints": None, "wheels": None}
    # A turtlelog recording contains its own goal.
    changes |= {"goal": None} if is_own else {}
    return replace(choice, allow_partial=False, **changes)


def judge_run(
    spec: Spec,
    reference: Run | MetricsFile | None,
    run: Run,
    *,
    file: str,
    allow_partial: bool = False,
    trajectories: TrajectoryJudge | None = None,
) -> Iterator[CheckResult]:
    """Yield the results of every check on one run; for an incomplete run, also one for the loss.

    Args:
        spec: Specification to check.
        reference: Run or metrics to which tolerances refer.
        run: Run that is judged.
        file: Name of the run.
        allow_partial: Whether an incomplete recording may pass.
        trajectories: Object that measures errors relative to a reference trajectory.
    """
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
