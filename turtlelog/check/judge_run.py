"""Results of recordings against a specification: of runs and of files."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from turtlelog.check.formula_trace import find_loss
from turtlelog.check.judge_formula import judge_check
from turtlelog.check.reference import MetricsFile, match_run, read_metrics_file
from turtlelog.check.result import CheckResult, Grown, fail_recording
from turtlelog.check.spec import (
    TRAJECTORY_VALUES,
    Spec,
    TrajectoryJudge,
    list_formula_names,
    measure_named,
)
from turtlelog.check.spec_file import require_few_parts, require_reference
from turtlelog.errors import CheckError, CompareError, ExpressionError, LogError
from turtlelog.log import ReadChoice, read_as_chosen, read_trajectory, split_topic
from turtlelog.log.planar_poses import JOINTS, TRANSFORMS
from turtlelog.log.recording.head import LOSS_NOTES
from turtlelog.log.ros2.bag_rows import open_bag
from turtlelog.measure import SIGNALS, Metric, find_metric_kind, measure_run
from turtlelog.run import Run


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
    if not allow_partial and (lost := find_loss(run)) is not None:
        yield fail_recording(file, lost)
        return
    require_few_parts(spec, run, file)
    metrics = measure_named(spec.checks, run, trajectories=trajectories, file=file)
    grown: Grown = {}
    for check in spec.checks:
        try:
            yield judge_check(check, run, file=file, metrics=metrics, grown=grown)
        except ExpressionError as err:
            names = list_formula_names([check]) - SIGNALS.keys()
            if all(find_metric_kind(name) is not None for name in names):
                raise
            # It names keys or states of a law, which differ between recordings: other checks are
            # judged nevertheless.
            yield replace(fail_recording(file, str(err)), check=check.name)
    if reference is None:
        return
    limits = spec.tolerances
    try:
        yield from match_run(run, reference, limits, file=file, alignment=spec.alignment)
    except CompareError as err:
        checks = [f"signals.{name}" for name in limits.signals]
        for name in (*checks, *(f"metrics.{name}" for name in limits.metrics)):
            yield replace(fail_recording(file, str(err)), check=name)


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedFile:
    """The results of one recording.

    Attributes:
        metrics: Metrics by id; empty if the recording could not be measured.
        details: Text for failures, by name of the check.
        started: Start time of the checks; None: the report has no time of day.
        took_s: Time for reading, measuring and checking [s].
        each_s: Time for each check [s], in the order of the results.
    """

    file: str
    results: tuple[CheckResult, ...]
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    details: Mapping[str, str] = field(default_factory=dict)
    started: datetime | None = None
    took_s: float = 0.0
    each_s: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedFile:
    """The results of one file, notes on its reading, and its run if the run is kept."""

    checked: CheckedFile
    notes: Mapping[str, str]
    run: Run | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FileJudge:
    """A judge of files against a specification, in this process or another."""

    spec: Spec
    reference: Run | MetricsFile | None
    trajectories: TrajectoryJudge | None
    choice: ReadChoice
    allow_partial: bool
    is_described: bool
    keeps_runs: bool

    def read_reference(self) -> Run | MetricsFile | None:
        """Return the reference, even if no check uses it; then it need not be complete."""
        if self.reference is not None or self.spec.reference is None:
            return self.reference
        choice = replace(self.choice, allow_partial=True)
        return read_metrics_file(self.spec.reference) or read_as_chosen(self.spec.reference, choice)

    def look_closer(self, path: Path, file: JudgedFile) -> JudgedFile:
        """Return the results of a file with its run, if a check fails."""
        has_failed = any(result.verdict == "FAIL" for result in file.checked.results)
        return replace(self, keeps_runs=True, is_described=False)(path) if has_failed else file

    def build_explainer(self) -> "FailureExplainer | None":
        """Return the explainer of failed recordings; None without a reference."""
        # A true trajectory contains the robot's positions, but no settings.
        is_truth = self.trajectories is not None and not self.spec.tolerances
        if self.spec.reference is None or is_truth:
            return None
        return FailureExplainer(judge=self, place=str(self.spec.reference))

    def judge_file(self, path: str) -> tuple[CheckResult, ...]:
        """Return the results of a file."""
        return self(Path(path)).checked.results

    def __call__(self, path: Path) -> JudgedFile:
        """Return the results of a file, with its run if runs are kept."""
        file, started, began_s = str(path), datetime.now(UTC), perf_counter()
        try:
            run, notes = read_to_judge(path, self.choice)
        except LogError as err:
            lost = (fail_recording(file, str(err).removeprefix(f"{path}: ")),)
            took_s = perf_counter() - began_s
            checked = CheckedFile(file=file, results=lost, started=started, took_s=took_s)
            return JudgedFile(checked=checked, notes={})
        found = judge_run(
            self.spec,
            self.reference,
            run,
            file=file,
            allow_partial=self.allow_partial,
            trajectories=self.trajectories,
        )
        timed = [(result, perf_counter()) for result in found]
        results = tuple(result for result, _ in timed)
        # The time of the first check includes the time to read.
        ends_s = [began_s, *(end_s for _, end_s in timed)]
        more: dict[str, Any] = {}
        if self.is_described:
            from turtlelog.check.failure_report import describe_failure

            failed = [result for result in results if result.verdict == "FAIL"]
            details = {one.check: "\n".join(describe_failure(run, one)) for one in failed}
            more = {"metrics": measure_run(run), "details": details}
        took_s = perf_counter() - began_s
        if not self.keeps_runs:
            # `judged` may contain the reference, which is only needed together with the run.
            results = tuple(replace(one, judged=None, reference=None) for one in results)
        checked = CheckedFile(
            file=file,
            results=results,
            started=started,
            took_s=took_s,
            each_s=tuple(end_s - start_s for start_s, end_s in pairwise(ends_s)),
            **more,
        )
        return JudgedFile(checked=checked, notes=notes, run=run if self.keeps_runs else None)


_MOST_EXPLAINED: Final = 3
"""Largest number of explained recordings per command: a series usually fails for one reason."""


@dataclass(slots=True, kw_only=True)
class FailureExplainer:
    """An explainer of the differences between the first failed recordings and the reference."""

    judge: FileJudge
    place: str
    explained: int = 0

    def __call__(self, path: Path, file: JudgedFile) -> JudgedFile:
        """Return the results of a file; if one fails, with the reason, for the first files."""
        has_failed = any(result.verdict == "FAIL" for result in file.checked.results)
        if not has_failed or self.explained == _MOST_EXPLAINED:
            return file
        from turtlelog.check.failure_report import explain_failures

        # Files that another process has judged are read once more here.
        closer = self.judge.look_closer(path, file) if file.run is None else file
        reference = self.judge.read_reference()
        if closer.run is None or reference is None:
            return file
        self.explained += 1
        found = explain_failures(closer.run, reference, closer.checked.results, place=self.place)
        whys = {one.check: one.why for one in found if one.why}
        results = tuple(replace(one, why=whys.get(one.check, ())) for one in file.checked.results)
        details = {
            name: "\n".join([text, *whys.get(name, ())])
            for name, text in file.checked.details.items()
        }
        return replace(file, checked=replace(file.checked, results=results, details=details))


def read_to_judge(path: Path, choice: ReadChoice) -> tuple[Run, dict[str, str]]:
    """Return a run, complete or not, and the notes on its reading."""
    # An incomplete recording fails its check, which gives the reason.
    run = read_as_chosen(path, replace(choice, allow_partial=True, allow_no_poses=True))
    told = {name: text for name, text in run.notes.items() if name not in LOSS_NOTES}
    return run, told


def read_reference_run(spec: Spec, topics: ReadChoice | None = None) -> Run | MetricsFile | None:
    """Return the run or metrics to which tolerances refer; None if no reference is needed.

    `topics` are those of the runs, in addition to the specification's. A topic that the reference
    does not have gets the default. The reference must always be complete.
    """
    require_reference(spec)
    if not spec.tolerances or spec.reference is None:
        return None
    if (metrics := read_metrics_file(spec.reference)) is not None:
        for name in spec.tolerances.signals:
            needs = f"[signals.{name}] needs a recording as its reference"
            raise CheckError(f"{spec.source}: {needs}, and {metrics.file} has metrics alone")
        for name in spec.tolerances.metrics:
            if name not in metrics.metrics:
                raise CheckError(f"{spec.source}: [metrics]: {metrics.file} has no metric {name}")
        return metrics
    choice = _restrict(spec.read.override(topics or ReadChoice()), spec.reference)
    return read_as_chosen(spec.reference, choice)


def read_reference_trajectory(
    spec: Spec, topics: ReadChoice | None = None, *, reads_files: bool = False
) -> TrajectoryJudge | None:
    """Return the judge of errors relative to the reference trajectory; None without a reference.

    `topics` are as in `read_reference_run`. With `reads_files`, runs are named by their files, from
    which poses in space are read.
    """
    names = sorted(list_formula_names(spec.checks) & TRAJECTORY_VALUES.keys())
    if not names:
        return None
    if spec.reference is None:
        needs = f"{names[0]} needs a trajectory that is true"
        fix = "reference = FILE in the file, or --reference FILE"
        raise CheckError(f"{spec.source}: {needs}: {fix}")
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
    kinds = {kind for _, kind in held}
    changes |= {} if TRANSFORMS in kinds else {"pose_frame": None, "world_frame": None}
    changes |= {} if JOINTS in kinds else {"wheel_joints": None, "wheels": None}
    # A turtlelog recording contains its own goal.
    changes |= {"goal": None} if is_own else {}
    return replace(choice, allow_partial=False, **changes)
