"""Checking of files, one after another, in this process or others; the results as JUnit XML."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from turtlelog.check.judge_run import fail_recording, judge_run
from turtlelog.check.reference import MetricsFile, read_metrics_file
from turtlelog.check.result import CheckResult, Verdict, describe_result
from turtlelog.check.spec import Spec
from turtlelog.check.vocabulary import TrajectoryJudge
from turtlelog.errors import LogError
from turtlelog.escapes import escape_controls
from turtlelog.log import ReadChoice, read_as_chosen
from turtlelog.log.recording.head import LOSS_NOTES
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run


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
        """Return the reference, even if no check uses it."""
        if self.reference is not None or self.spec.reference is None:
            return self.reference
        metrics = read_metrics_file(self.spec.reference)
        return metrics or read_as_chosen(self.spec.reference, self.choice)

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
            failed = (fail_recording(file, str(err).removeprefix(f"{path}: ")),)
            took_s = perf_counter() - began_s
            checked = CheckedFile(file=file, results=failed, started=started, took_s=took_s)
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
        more = _describe(run, results) if self.is_described else {}
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
"""Largest number of explained recordings per command, because a series usually fails for one
reason."""


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

        # Failed files that another process has judged are read once more here.
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


def _describe(run: Run, results: Sequence[CheckResult]) -> dict[str, Any]:
    """Return the additional data of a report: all metrics, and the details of failures."""
    from turtlelog.check.failure_report import describe_failure

    failed = [result for result in results if result.verdict == "FAIL"]
    details = {result.check: "\n".join(describe_failure(run, result)) for result in failed}
    return {"metrics": measure_run(run), "details": details}


def read_to_judge(path: Path, choice: ReadChoice) -> tuple[Run, dict[str, str]]:
    """Return a run, complete or not, and the notes on its reading."""
    # An incomplete recording fails its check, which gives the reason.
    run = read_as_chosen(path, replace(choice, allow_partial=True, allow_no_poses=True))
    told = {name: text for name, text in run.notes.items() if name not in LOSS_NOTES}
    return run, told


_NO_XML: Final = {0xFFFE: r"\ufffe", 0xFFFF: r"\uffff"}


def format_junit(files: Sequence[CheckedFile]) -> str:
    """Return results as JUnit XML, with the times of the files."""
    from xml.etree import ElementTree as Xml  # few checks need it

    took_s = sum(found.took_s for found in files)
    counts = _count([result for found in files for result in found.results])
    root = Xml.Element("testsuites", {**counts, "time": f"{took_s:.3f}"})
    root.set("name", "turtlelog check")
    for found in files:
        suite = Xml.SubElement(root, "testsuite", _describe_suite(found))
        if found.metrics:
            properties = Xml.SubElement(suite, "properties")
            for metric in found.metrics.values():
                value = metric.status.value if metric.value is None else repr(metric.value)
                name = metric.id if metric.unit == "1" else f"{metric.id} [{metric.unit}]"
                Xml.SubElement(properties, "property", {"name": name, "value": value})
        each_s = found.each_s or (0.0,) * len(found.results)
        for result, case_s in zip(found.results, each_s, strict=True):
            names = {"name": _clean(result.check), "classname": _clean(result.file)}
            case = Xml.SubElement(suite, "testcase", {**names, "time": f"{case_s:.3f}"})
            if result.verdict is Verdict.SKIPPED:
                Xml.SubElement(case, "skipped", {"message": _clean(result.reason)})
            if result.verdict is Verdict.FAIL:
                message = _clean(describe_result(result))
                failure = Xml.SubElement(case, "failure", {"message": message, "type": "check"})
                failure.text = _clean(found.details.get(result.check, "")) or message
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _describe_suite(found: CheckedFile) -> dict[str, str]:
    suite = {"name": _clean(found.file), **_count(found.results), "time": f"{found.took_s:.3f}"}
    if found.started is not None:
        suite["timestamp"] = found.started.isoformat(timespec="seconds")
    return suite


def _count(results: Sequence[CheckResult]) -> dict[str, str]:
    verdicts = [result.verdict for result in results]
    return {
        "tests": str(len(verdicts)),
        "failures": str(verdicts.count(Verdict.FAIL)),
        "skipped": str(verdicts.count(Verdict.SKIPPED)),
        "errors": "0",
    }


def _clean(text: str) -> str:
    """Return text with escapes for characters that XML cannot contain or that are invisible."""
    return escape_controls(text, keep="\n").translate(_NO_XML)
