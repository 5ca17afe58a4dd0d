"""Checking of files one by one, and the files written next to the answer."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.folders import summarise_table, tabulate
from turtlelog.cli.options import (
    Place,
    ReadingOptions,
    WorkOptions,
    list_reading_words,
    watch_files,
)
from turtlelog.cli.output import print_note, print_run_notes
from turtlelog.errors import LogError, UsageError
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from turtlelog import Run, Spec
    from turtlelog.check import ArtifactWriter, CheckResult
    from turtlelog.check.junit import CheckedFile
    from turtlelog.check.named_values import TrajectoryJudge
    from turtlelog.check.reference import MetricsFile
    from turtlelog.log import ReadChoice
    from turtlelog.sweep import FoundRecording

_FILE_S: Final = 5e-3
"""Time to read a usual file and judge about ten checks, in addition to the time for its bytes
[s]."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions(WorkOptions):
    """Files to write beside the answer.

    Attributes:
        junit: Write JUnit XML to this .xml file, with each metric as a property.
        artifacts: Write a Rerun view, a picture and a shortened recording of each failure to this
            folder.
        report: Write a report on the recordings and their checks to this .html file. One process
            reads all recordings then.
        all_: Print the checks that pass, too.
        no_why: Do not explain failures. Default: with a reference, the first three failing
            recordings are explained by their difference from the reference, each within 10 s.
        marks: Print one line for each recording: its verdict, and how many of its checks pass.
    """

    junit: Place | None = None
    artifacts: Place | None = None
    report: Place | None = None
    all_: Annotated[bool, Parameter(name="--all")] = False
    no_why: Annotated[bool, Parameter(negative=())] = False
    marks: bool = False


def check_into_table(
    output: Path,
    spec: "Spec",
    found: "Sequence[FoundRecording]",
    reports: ReportOptions,
    topics: ReadingOptions,
) -> "Iterator[CheckResult]":
    """Return the results of files. The table provides the results of unchanged files."""
    from turtlelog.check.verdict_rows import plan_verdict_table, read_verdicts

    for name in ("junit", "artifacts", "report"):
        if getattr(reports, name) is not None:
            raise UsageError(f"--{name}: leave out --output, which does not read unchanged files")
    judge = _prepare_judge(spec, topics)
    table = plan_verdict_table(spec, judge.judge_file, judge.choice, is_partial=topics.partial)
    done = tabulate(found, output, table, work=reports, file_s=_FILE_S)
    print_note(summarise_table(done))
    return read_verdicts(output, {one.label: one.path for one in found})


def _prepare_judge(
    spec: "Spec", topics: ReadingOptions, *, is_described: bool = False, keeps_runs: bool = False
) -> "_Judge":
    from turtlelog.check.judge_run import read_reference_run, read_reference_trajectory

    choice = spec.read.override(topics.build_choice())
    return _Judge(
        spec=spec,
        reference=read_reference_run(spec, choice),
        trajectories=read_reference_trajectory(spec, choice, reads_files=True),
        choice=choice,
        allow_partial=topics.partial,
        is_described=is_described,
        keeps_runs=keeps_runs,
    )


def check_files(
    spec: "Spec", files: Sequence[Path], reports: ReportOptions, topics: ReadingOptions
) -> "Iterator[CheckResult]":
    """Yield the results of files, and write the requested files next to the answer."""
    if reports.scheduler is not None and reports.report is not None:
        raise UsageError("--report: leave out --scheduler")
    with reports.find_place(files, file_s=_FILE_S) as place:
        yield from _check_files(spec, files, reports, topics, place=place)


def _check_files(
    spec: "Spec",
    files: Sequence[Path],
    reports: ReportOptions,
    topics: ReadingOptions,
    *,
    place: "int | Executor",
) -> "Iterator[CheckResult]":
    from turtlelog.check.junit import CheckedFile, format_junit

    jobs = 1 if reports.report is not None else place
    keeps_runs = reports.report is not None or (reports.artifacts is not None and jobs == 1)
    is_described = reports.junit is not None
    judge = _prepare_judge(spec, topics, is_described=is_described, keeps_runs=keeps_runs)
    judged = map_in_processes(judge, files, jobs)
    explain = None if reports.no_why or reports.marks else judge.build_explainer()
    checked: list[CheckedFile] = []  # data for a report
    runs: dict[str, Run] = {}
    with ExitStack() as stack:
        writer = reports.artifacts and stack.enter_context(
            tl.check.ArtifactWriter(reports.artifacts)
        )
        for path, file in zip(files, watch_files(judged, len(files)), strict=True):
            if explain is not None:
                file = explain(path, file)
            if reports.junit is not None or reports.report is not None:
                checked.append(file.checked)
            print_run_notes(file.checked.file, file.notes)
            if file.run is not None and reports.report is not None:
                runs[file.checked.file] = file.run
            if writer:
                # Failed files that another process has judged are read once more here.
                _write_artifacts(file if keeps_runs else judge.look_closer(path, file), writer)
            yield from file.checked.results
    if reports.junit is not None:
        with tl.log.replace_when_complete(reports.junit) as part:
            part.write_text(format_junit(checked), encoding="utf-8")
        print_note(f"wrote {reports.junit}")
    if reports.report is not None:
        results = [result for file in checked for result in file.results]
        words = [*runs, *list_reading_words(topics), "--report", str(reports.report)]
        _write_report(reports.report, runs, results, _join_command(spec, words))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Judged:
    """The results of one file, notes on its reading, and its run if the run is kept."""

    checked: "CheckedFile"
    notes: "Mapping[str, str]"
    run: "Run | None" = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Judge:
    """A judge of files against a specification, in this process or another."""

    spec: "Spec"
    reference: "Run | MetricsFile | None"
    trajectories: "TrajectoryJudge | None"
    choice: "ReadChoice"
    allow_partial: bool
    is_described: bool
    keeps_runs: bool

    def read_reference(self) -> "Run | MetricsFile | None":
        """Return the reference, even if no check uses it."""
        if self.reference is not None or self.spec.reference is None:
            return self.reference
        from turtlelog.check.reference import read_metrics_file

        metrics = read_metrics_file(self.spec.reference)
        return metrics or tl.log.read_as_chosen(self.spec.reference, self.choice)

    def look_closer(self, path: Path, file: _Judged) -> _Judged:
        """Return the results of a file with its run, if a check fails."""
        has_failed = any(result.verdict == "FAIL" for result in file.checked.results)
        return replace(self, keeps_runs=True, is_described=False)(path) if has_failed else file

    def build_explainer(self) -> "_Explainer | None":
        """Return the explainer of failed recordings; None without a reference."""
        # A true trajectory contains the robot's positions, but no settings.
        is_truth = self.trajectories is not None and not self.spec.tolerances
        if self.spec.reference is None or is_truth:
            return None
        return _Explainer(judge=self, place=str(self.spec.reference))

    def judge_file(self, path: str) -> "tuple[CheckResult, ...]":
        """Return the results of a file."""
        return self(Path(path)).checked.results

    def __call__(self, path: Path) -> _Judged:
        from turtlelog.check.judge_run import fail_recording, judge_run
        from turtlelog.check.junit import CheckedFile

        file, started, clock = str(path), datetime.now(UTC), _Clock()
        try:
            run, notes = read_to_judge(path, self.choice)
        except LogError as err:
            failed = (fail_recording(file, str(err).removeprefix(f"{path}: ")),)
            checked = CheckedFile(file=file, results=failed, started=started, took_s=clock.read())
            return _Judged(checked=checked, notes={})
        found = judge_run(
            self.spec,
            self.reference,
            run,
            file=file,
            allow_partial=self.allow_partial,
            trajectories=self.trajectories,
        )
        timed = [(result, clock.lap()) for result in found]
        results = tuple(result for result, _ in timed)
        more = _describe(run, results) if self.is_described else {}
        took_s = clock.read()
        if not self.keeps_runs:
            # `judged` may contain the reference, which is only needed together with the run.
            results = tuple(replace(one, judged=None, reference=None) for one in results)
        checked = CheckedFile(
            file=file,
            results=results,
            started=started,
            took_s=took_s,
            each_s=tuple(each_s for _, each_s in timed),
            **more,
        )
        return _Judged(checked=checked, notes=notes, run=run if self.keeps_runs else None)


_MOST_EXPLAINED: Final = 3
"""Largest number of explained recordings per command, because a series usually fails for one
reason."""


@dataclass(slots=True, kw_only=True)
class _Explainer:
    """An explainer of the differences between the first failed recordings and the reference."""

    judge: _Judge
    place: str
    explained: int = 0

    def __call__(self, path: Path, file: _Judged) -> _Judged:
        has_failed = any(result.verdict == "FAIL" for result in file.checked.results)
        if not has_failed or self.explained == _MOST_EXPLAINED:
            return file
        from turtlelog.check.difference_reason import explain_failures

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


def _write_report(
    path: Path,
    runs: "Mapping[str, Run]",
    results: "Sequence[CheckResult]",
    command: str,
) -> None:
    """Write a report on the readable recordings, with the command that creates it."""
    from turtlelog.cli.report import build_check_lines

    bare = [file for file, run in runs.items() if not len(run.poses)]
    runs = {file: run for file, run in runs.items() if file not in bare}
    for file in bare:
        print_note(f"{path}: {file} has commands alone, and a report needs poses")
    if not runs:
        print_note(f"{path}: no report: none of the recordings could be read")
        return
    names = dict(zip(runs, tl.compare.name_runs([*runs.values()]), strict=True))
    tl.draw.write_report(
        [*runs.values()],
        path,
        sources=[*runs],
        checks=build_check_lines(results, names, runs),
        command=command,
    )
    print_note(f"wrote {path}")


def _join_command(spec: "Spec", words: Sequence[str]) -> str:
    """Return the command that repeats the check; empty if no file contains the checks."""
    is_file = not str(spec.source).startswith("--")
    return shlex.join(["turtlelog", "check", str(spec.source), *words]) if is_file else ""


class _Clock:
    """A clock of the checks, whose first lap includes the time to read."""

    def __init__(self) -> None:
        self._began_s = self._last_s = perf_counter()

    def lap(self) -> float:
        """Return the time since the last lap [s]."""
        last_s, self._last_s = self._last_s, perf_counter()
        return self._last_s - last_s

    def read(self) -> float:
        """Return the time since the beginning [s]."""
        return perf_counter() - self._began_s


def _describe(run: "Run", results: "Sequence[CheckResult]") -> dict[str, Any]:
    """Return the additional data of a report: all metrics, and the details of failures."""
    from turtlelog.check.failure_report import describe_failure

    failed = [result for result in results if result.verdict == "FAIL"]
    details = {result.check: "\n".join(describe_failure(run, result)) for result in failed}
    return {"metrics": tl.measure_run(run), "details": details}


def read_to_judge(path: Path, choice: "ReadChoice") -> "tuple[Run, dict[str, str]]":
    """Return a run, complete or not, and the notes on its reading."""
    from turtlelog.log.recording.head import LOSS_NOTES

    # An incomplete recording fails its check, which gives the reason.
    run = tl.log.read_as_chosen(path, replace(choice, allow_partial=True, allow_no_poses=True))
    told = {name: text for name, text in run.notes.items() if name not in LOSS_NOTES}
    return run, told


def _write_artifacts(file: _Judged, writer: "ArtifactWriter") -> None:
    for result in file.checked.results:
        if file.run is None or result.verdict != "FAIL":
            continue
        written = writer.write(file.run, result)
        for line in (*(f"wrote {path}" for path in written.files), *written.notes):
            print_note(line)
