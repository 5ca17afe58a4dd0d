"""`turtlelog check`: check recordings against a specification."""

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.check_answers import (
    CheckAnswer,
    CountedResults,
    conclude,
    format_many,
    format_results,
    list_failure_reasons,
    list_verdict_reasons,
    tabulate_files,
    tabulate_matrix,
    tabulate_values,
)
from turtlelog.cli.scenario import is_recording
from turtlelog.cli.work import WorkOptions, summarise_table, tabulate, watch_files
from turtlelog.display import describe_count
from turtlelog.errors import ExpressionError, LogError, UsageError
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from turtlelog.check.judge_run import CheckedFile, FileJudge, JudgedFile


Words = Annotated[list[options.Place], Parameter(name="SPEC FILE")]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FirstSpecOptions:
    """Alternatives to a specification file.

    Attributes:
        expect: Check this formula instead of a specification. Can be repeated.
        init: Write a first specification from this good run, to the file of -o.
        output: With --init: the .toml file to write (default: print it). Without --init: a
            .parquet table of verdicts to write. Files that did not change since the table was
            written with the same specification are not read again.
        schema: Print the JSON Schema of specification files, for editors.
    """

    expect: Annotated[list[str] | None, Parameter(metavar="FORMULA", negative=())] = None
    init: options.Place | None = None
    output: options.Output = None
    schema: bool = False


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

    junit: options.Place | None = None
    artifacts: options.Place | None = None
    report: options.Place | None = None
    all_: Annotated[bool, Parameter(name="--all")] = False
    no_why: Annotated[bool, Parameter(negative=())] = False
    marks: bool = False


def check(
    words: Words | None = None,
    /,
    *,
    reference: options.Place | None = None,
    reports: ReportOptions = ReportOptions(),
    first: FirstSpecOptions = FirstSpecOptions(),
    formats: console.FormatOptions = console.FormatOptions(),
    topics: options.ReadingOptions = options.ReadingOptions(),
) -> int:
    """Check recordings against a specification: bounds, temporal-logic formulas, tolerances.

    The exit code is 0 if all checks pass, 1 if a check fails or cannot be decided, and 2 if the
    specification or its reference cannot be read. A metric without a value fails. A recording that
    cannot be read fails, and an incomplete recording fails unless --partial is given.

    The first line is the verdict. The checks that fail follow; with --all, every check of every
    recording.

    Example: turtlelog check --init good.mcap -o spec.toml

    Example: turtlelog check spec.toml runs/*.mcap --junit report.xml

    Example: turtlelog check run.mcap --expect "always(abs(speed) <= 1.5)"

    Example: turtlelog check spec.toml runs -o verdicts.parquet

    Example: turtlelog check spec.toml handed-in/*.mcap --marks

    Args:
        words: A specification (.toml) and recordings; with --expect, recordings alone.
        reference: Reference recording, instead of the one in SPEC; also the reference trajectory of
            ate.* and rpe.* in --expect.
    """
    kind = formats.choose()
    words = words or []
    if first.schema:
        from turtlelog.check.spec_templates import build_schema

        console.print_json(build_schema())
        return console.EXIT_FINE
    if first.init is not None:
        return _write_first(first.init, words, first.output, topics)
    files = reports.name_files(_choose_files(words, first))
    _require_targets(reports, first.output, words)
    spec = _load_spec(words[0], first.expect or (), reference)
    if first.output is not None:
        found = options.find_files(files, first.output)
        files = [Path(one.path) for one in found]
        _require_known(spec, files, topics)
        results = _check_into_table(first.output, spec, found, reports, topics)
    else:
        files = options.list_files(files)
        _require_known(spec, files, topics)
        results = _check_all(spec, files, reports, topics)
    if reports.marks:
        if kind != "txt" or reports.all_:
            raise UsageError("--marks prints a line for each recording; leave other formats out")
        return console.EXIT_FAILED if _print_marks(results) == "FAIL" else console.EXIT_FINE
    reading = options.list_option_words(topics)
    verdict = _print_results(
        spec, results, reading, files=len(files), kind=kind, shows_all=reports.all_
    )
    return console.EXIT_FAILED if verdict == "FAIL" else console.EXIT_FINE


def _load_spec(path: Path, formulas: Sequence[str], reference: Path | None) -> "tl.Spec":
    """Return the specification of --expect, or else of a file, with a reference that it needs."""
    from turtlelog.check.spec import TRAJECTORY_VALUES, build_spec, list_formula_names

    if not formulas:
        return tl.load_spec(path, reference=reference)
    spec = replace(build_spec(formulas), reference=reference)
    if reference is not None and list_formula_names(spec.checks).isdisjoint(TRAJECTORY_VALUES):
        raise UsageError(
            "--reference: leave it out beside --expect, which has no tolerances and names no error"
            " of a trajectory (ate.position.rmse)"
        )
    return spec


def _choose_files(words: list[Path], first: FirstSpecOptions) -> list[Path]:
    """Return the recordings among the words; refuse combinations that do not fit."""
    if first.expect:
        if not words:
            raise UsageError(f"check needs recordings: turtlelog check FILE... --expect {_FORMULA}")
        return words
    if not words:
        raise UsageError(
            "check needs a specification and recordings: turtlelog check SPEC FILE..., or"
            f" turtlelog check FILE... --expect {_FORMULA}"
        )
    if is_recording(words[0]) or str(words[0]) in tl.PRESETS:
        specs = [word for word in words if word.suffix.lower() == ".toml"]
        others = shlex.join(str(word) for word in words if word not in specs)
        head = f"{words[0]} is a recording"
        if specs:
            command = f"turtlelog check {shlex.quote(str(specs[0]))} {others}"
            raise UsageError(f"{head}; the specification goes first: {command}")
        raise UsageError(
            f"{head}, but check needs a specification first: turtlelog check SPEC {others}, or"
            f" --expect {_FORMULA}, or create one with --init {words[0]}"
        )
    if len(words) == 1:
        raise UsageError(f"which recordings? turtlelog check {shlex.quote(str(words[0]))} FILE...")
    return words[1:]


_FORMULA: Final = '"rotate.overshoot <= 2"'
"""Example of a formula."""


def _require_targets(reports: ReportOptions, output: Path | None, words: Sequence[Path]) -> None:
    if output is not None and output.suffix.lower() != ".parquet":
        raise UsageError(f"--output {output}: needs --init, or a name that ends in .parquet")
    options.require_new_target(reports.junit, words, suffix=".xml")
    options.require_new_target(reports.report, words, suffix=".html")
    targets = (reports.junit, reports.artifacts, reports.report)
    options.require_apart([path for path in targets if path is not None])


def _require_known(spec: "tl.Spec", files: Sequence[Path], topics: options.ReadingOptions) -> None:
    """Refuse names that neither the tables of names nor any recording contains.

    Recordings are read only for names that may be states or parameters of a user law, until one
    recording contains them all.
    """
    from turtlelog.check.judge_run import read_to_judge
    from turtlelog.check.spec import is_in_tables, require_known_names

    formulas = [
        (formula, check.kind == "holds" and formula is check.formula)
        for check in spec.checks
        for formula in (check.formula, check.when)
        if formula is not None and not all(map(is_in_tables, formula.names))
    ]
    problem: ExpressionError | None = None
    for path in files if formulas else ():
        try:
            run, _ = read_to_judge(path, spec.read.override(topics.build_choice()))
        except LogError:
            continue
        try:
            for formula, over_time in formulas:
                require_known_names(formula, over_time=over_time, run=run)
        except ExpressionError as err:
            problem = err
        else:
            return
    if problem is not None:
        raise problem


def _write_first(
    path: Path, words: Sequence[Path], output: Path | None, topics: options.ReadingOptions
) -> int:
    from turtlelog.check.formula_trace import find_loss
    from turtlelog.check.judge_run import read_to_judge
    from turtlelog.check.spec_templates import find_doubt, format_first_spec, name_reference

    if words:
        raise UsageError(f"--init: takes one good run and no other file; leave out {words[0]}")
    options.require_new_target(output, [path], suffix=".toml")
    file, topic = tl.log.split_topic(path)
    choice = topics.build_choice()
    run, notes = read_to_judge(path, choice)
    console.print_run_notes(path, notes)
    if topic is not None:  # the specification distinguishes both
        choice = replace(choice, pose_topic=topic)
    text = format_first_spec(run, reference=name_reference(file, output), read=choice)
    doubt = find_doubt(run)
    doubts = [] if doubt is None else [f"Was {file.name} a good run? {doubt}"]
    if output is None:
        for line in doubts:
            console.print_note(line)
        console.print_text(text)
        return console.EXIT_FINE
    console.write_text(output, text)
    console.print_note(f"wrote {output}")
    checks = describe_count(text.count("\n[checks."), "check")
    spec = console.quote_file(output)
    partial = "" if find_loss(run) is None else " --partial"
    lines = [
        f"{output.name}: {checks} read off {file.name}, each bound with its reason.",
        *doubts,
        f"Set each bound to what it should be. Then: turtlelog check {spec} FILE...{partial}",
    ]
    console.print_text(console.fill_lines(lines))
    return console.EXIT_FINE


def _check_into_table(
    output: Path,
    spec: "tl.Spec",
    found: "Sequence[tl.sweep.FoundRecording]",
    reports: ReportOptions,
    topics: options.ReadingOptions,
) -> "Iterator[tl.check.CheckResult]":
    """Return the results of files. The table provides the results of unchanged files."""
    from turtlelog.check.verdict_files import plan_verdict_table, read_verdicts

    given = {f"--{name}": getattr(reports, name) for name in ("junit", "artifacts", "report")}
    options.refuse_given(given, "leave out --output, which does not read unchanged files")
    judge = _prepare_judge(spec, topics)
    table = plan_verdict_table(spec, judge.judge_file, judge.choice, is_partial=topics.partial)
    options.require_new_target(output, [Path(one.path) for one in found], suffix=".parquet")
    done = tabulate(found, output, table, work=reports, file_s=_FILE_S)
    console.print_note(summarise_table(done))
    return read_verdicts(output, {one.label: one.path for one in found})


def _prepare_judge(
    spec: "tl.Spec",
    topics: options.ReadingOptions,
    *,
    is_described: bool = False,
    keeps_runs: bool = False,
) -> "FileJudge":
    from turtlelog.check.judge_run import FileJudge, read_reference_run, read_reference_trajectory

    choice = spec.read.override(topics.build_choice())
    return FileJudge(
        spec=spec,
        reference=read_reference_run(spec, choice),
        trajectories=read_reference_trajectory(spec, choice, reads_files=True),
        choice=choice,
        allow_partial=topics.partial,
        is_described=is_described,
        keeps_runs=keeps_runs,
    )


def _check_all(
    spec: "tl.Spec", files: Sequence[Path], reports: ReportOptions, topics: options.ReadingOptions
) -> "Iterator[tl.check.CheckResult]":
    """Yield the results of files, and write the requested files next to the answer."""
    from turtlelog.check.verdict_files import format_junit

    if reports.scheduler is not None and reports.report is not None:
        raise UsageError("--report: leave out --scheduler")
    checked: list[CheckedFile] = []  # data for a report
    runs: dict[str, tl.Run] = {}
    with ExitStack() as stack:
        place = stack.enter_context(reports.find_place(files, file_s=_FILE_S))
        jobs = 1 if reports.report is not None else place
        keeps_runs = reports.report is not None or (reports.artifacts is not None and jobs == 1)
        is_described = reports.junit is not None
        judge = _prepare_judge(spec, topics, is_described=is_described, keeps_runs=keeps_runs)
        judged = map_in_processes(judge, files, jobs)
        explain = None if reports.no_why or reports.marks else judge.build_explainer()
        writer = reports.artifacts and stack.enter_context(
            tl.check.ArtifactWriter(reports.artifacts)
        )
        for path, file in zip(files, watch_files(judged, len(files)), strict=True):
            if explain is not None:
                file = explain(path, file)
            if reports.junit is not None or reports.report is not None:
                checked.append(file.checked)
            console.print_run_notes(file.checked.file, file.notes)
            if file.run is not None and reports.report is not None:
                runs[file.checked.file] = file.run
            if writer:
                # Failed files that another process has judged are read once more here.
                _write_artifacts(file if keeps_runs else judge.look_closer(path, file), writer)
            yield from file.checked.results
    console.write_asked(reports.junit, lambda path: console.write_text(path, format_junit(checked)))
    _write_report(reports.report, runs, checked, spec, topics)


def _write_report(
    path: Path | None,
    runs: "Mapping[str, tl.Run]",
    checked: "Sequence[CheckedFile]",
    spec: "tl.Spec",
    topics: options.ReadingOptions,
) -> None:
    """Write the requested report on the readable recordings, with the command that creates it."""
    from turtlelog.cli.report import build_check_lines

    if path is None:
        return
    posed = {file: run for file, run in runs.items() if len(run.poses)}
    for file in (file for file in runs if file not in posed):
        console.print_note(f"{path}: {file} has commands alone, and a report needs poses")
    if not posed:
        console.print_note(f"{path}: no report: none of the recordings could be read")
        return
    names = dict(zip(posed, tl.compare.name_runs([*posed.values()]), strict=True))
    results = [result for file in checked for result in file.results]
    words = ["turtlelog", "check", str(spec.source), *runs, *options.list_option_words(topics)]
    is_file = not str(spec.source).startswith("--")  # else no file contains the checks
    tl.draw.write_report(
        [*posed.values()],
        path,
        sources=[*posed],
        checks=build_check_lines(results, names, posed),
        command=shlex.join([*words, "--report", str(path)]) if is_file else "",
    )
    console.print_note(f"wrote {path}")


def _write_artifacts(file: "JudgedFile", writer: "tl.check.ArtifactWriter") -> None:
    for result in file.checked.results:
        if file.run is None or result.verdict != "FAIL":
            continue
        written = writer.write(file.run, result)
        for line in (*(f"wrote {path}" for path in written.files), *written.notes):
            console.print_note(line)


def _print_results(
    spec: "tl.Spec",
    results: "Iterable[tl.check.CheckResult]",
    reading: Sequence[str],
    *,
    files: int,
    kind: str,
    shows_all: bool,
) -> "tl.check.Verdict":
    """Print the verdict and what fails, and return the verdict. Of many files, count results."""
    told: Any = {"files": files, "spec": spec, "shows_all": shows_all, "reading": reading}
    if kind == "txt" and files > _MOST_FILES:
        counted = CountedResults(results)
        console.print_verdicts(format_many(counted, **told))
        return counted.verdict
    results = [*results]
    verdict = tl.check.join_verdicts(results)
    if kind == "json":
        console.print_json(CheckAnswer(verdict=verdict.value, results=results))
    elif kind == "csv":
        console.print_tables([tabulate_values(spec, results)], kind)
    elif kind == "txt":
        console.print_verdicts(format_results(results, **told))
    else:
        tables = [*tabulate_files(results), *tabulate_matrix(results)]
        notes = (
            conclude(CountedResults(results), files),
            *list_verdict_reasons(spec, results),
            *list_failure_reasons(results),
        )
        console.print_tables([*tables[:-1], replace(tables[-1], notes=notes)], kind)
    return verdict


def _print_marks(results: "Iterable[tl.check.CheckResult]") -> "tl.check.Verdict":
    """Print a line for each recording as soon as it is checked, and return the joint verdict."""
    from turtlelog.check.result import decide_verdict

    counted = []
    for file, of_file in groupby(results, key=lambda result: result.file):
        found = CountedResults(of_file)
        counted.append(found.verdict)
        passed, total = found.verdicts[tl.check.Verdict.PASS], found.verdicts.total()
        count = f"{passed} of {describe_count(total, 'check')}"
        console.print_verdicts(f"{found.verdict}  {file}: {count} passed")
    return decide_verdict(Counter(counted))


_MOST_FILES: Final = 20
"""Largest number of recordings whose checks are kept in memory; for more, checks are counted."""
