"""`turtlelog report`: runs as one HTML file."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.check_answers import conclude
from turtlelog.cli.check_tables import CountedResults
from turtlelog.cli.options import (
    Files,
    Json,
    Place,
    ReadingOptions,
    list_files,
    list_reading_words,
    read_runs,
    require_files,
    require_there,
)
from turtlelog.cli.output import (
    EXIT_FAILED,
    EXIT_FINE,
    fill_lines,
    list_written,
    print_json,
    print_text,
)
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.display import format_number
from turtlelog.errors import ExplainError, TurtlelogError

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.charts.curve_marks import ViolatedSignal
    from turtlelog.check import CheckResult
    from turtlelog.draw.report import CheckLine, Explanation


def report(
    files: Files,
    /,
    *,
    output: Annotated[Place, Parameter(name=("--output", "-o"))],
    spec: Place | None = None,
    explain: Literal["auto", "worst", "none"] = "auto",
    topics: ReadingOptions | None = None,
    json: Json = False,
) -> int:
    """Write a report on runs as one file of HTML, which opens without a network.

    The report begins with the result in a sentence: which run ends nearest to its goal, which check
    fails, what caused the worst run. Below this sentence, the report shows the plane with a slider
    over time, plots that can be zoomed, tables, checks, and the files with their sha256.

    The exit code is 1 if a check of --spec fails.

    Example: turtlelog report kp1.mcap kp10.mcap -o report.html

    Example: turtlelog report run.mcap --spec spec.toml -o report.html

    Args:
        files: Recordings (.mcap), ROS 2 bags, tables, or the paper's logs (.json, .csv).
        output: Write this .html file.
        spec: Check the runs against this specification (.toml).
        explain: Explain the final error: of a single run (auto), of the run that ends furthest from
            its goal (worst), or of no run (none).
        json: Print one JSON object instead of lines.
    """
    require_files(files)
    require_there(files)
    files = list_files(files)
    inputs = [*files, *([] if spec is None else [spec])]
    require_new_target(output, inputs, suffix=".html")
    runs = read_runs(files, topics)
    found = _explain(runs, explain)
    results = [] if spec is None else _check(spec, files, runs)
    names = dict(zip(map(str, files), tl.compare.name_runs(runs), strict=False))
    words = [*map(str, files), *([] if spec is None else ["--spec", str(spec)])]
    words += [] if explain == "auto" else ["--explain", explain]
    words += list_reading_words(topics or ReadingOptions())
    with show_progress("drawing"):
        tl.draw.write_report(
            runs,
            output,
            sources=files,
            explanation=found,
            checks=build_check_lines(results, names, dict(zip(map(str, files), runs, strict=True))),
            command=shlex.join(["turtlelog", "report", *words, "-o", str(output)]),
        )
    verdict = tl.check.join_verdicts(results) if results else None
    answer = ReportAnswer(
        ending=tl.compare.describe_runs(runs),
        output=str(output),
        bytes=output.stat().st_size,
        runs=[
            ReportedRun(file=str(file), name=run.name)
            for file, run in zip(files, runs, strict=True)
        ],
        explained=found.run.name if found is not None and found.attribution is not None else None,
        verdict=None if verdict is None else verdict.value,
    )
    if json:
        print_json(answer)
    else:
        checked = [conclude(CountedResults(results), len(files))] if results else []
        said = fill_lines([*checked, answer.ending])
        print_text("\n".join([said, *list_written([output])]))
    return EXIT_FAILED if verdict == "FAIL" else EXIT_FINE


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportedRun:
    """A run in a report."""

    file: str
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportAnswer:
    """Result of writing a report.

    Attributes:
        ending: Sentence on how the runs ended.
        output: Path of the report.
        bytes: Size of the report [bytes].
        runs: Runs in the report.
        explained: Name of the explained run; None if no run is explained.
        verdict: Verdict of all checks; None without a specification.
    """

    ending: str
    output: str
    bytes: int
    runs: list[ReportedRun]
    explained: str | None
    verdict: str | None


def build_check_lines(
    results: "Sequence[CheckResult]", names: "Mapping[str, str]", runs: "Mapping[str, Run]"
) -> "list[CheckLine]":
    """Return results in the form for a report."""
    from turtlelog.check.violation import find_violated_signal
    from turtlelog.draw.report import CheckLine
    from turtlelog.draw.report.marked_plots import MOST_VIOLATIONS

    def tell(value: float | None, unit: str) -> str:
        return "" if value is None else format_number(value, unit)

    signals: dict[int, ViolatedSignal] = {}
    for number, found in enumerate(results):
        if found.file in runs and found.verdict == "FAIL" and len(signals) < MOST_VIOLATIONS:
            signal = find_violated_signal(runs[found.file], found).signal
            signals |= {} if signal is None else {number: signal}
    return [
        CheckLine(
            run=names.get(found.file, found.file),
            check=found.check,
            verdict=found.verdict.value,
            value=tell(found.value, found.unit),
            limit=tell(found.limit, found.unit),
            margin=tell(found.margin, found.unit),
            expected=found.expected,
            first_violation_s=found.first_violation_s,
            reason=found.reason,
            names=found.names,
            signal=signals.get(number),
        )
        for number, found in enumerate(results)
    ]


def _check(spec: Path, files: Sequence[Path], runs: "Sequence[Run]") -> "list[CheckResult]":
    loaded = tl.load_spec(spec)
    pairs = [(str(file), run) for file, run in zip(files, runs, strict=True)]
    return [*tl.check_runs(loaded, pairs)]


def _explain(runs: "Sequence[Run]", choice: str) -> "Explanation | None":
    """Return the causes of the final error of the run to explain."""
    run = _choose_run(runs, choice)
    if run is None:
        return None
    from turtlelog.draw.report import Explanation
    from turtlelog.explain import require_trust
    from turtlelog.explain.game import simulate_what_ifs

    try:
        require_trust(run, trust_law=False)
        found = tl.identify_run(run)
        if found.scenario is None:
            raise ExplainError("no scenario stands for this log")
        with show_progress("simulated", 100.0, "%") as progress:
            attribution = tl.attribute_run(
                run, identified=found, work=tl.explain.Work(report=progress.count)
            )
        what_ifs = simulate_what_ifs(found, attribution)
    except TurtlelogError as err:
        return Explanation(run=run, note=str(err))
    return Explanation(run=run, attribution=attribution, what_ifs=what_ifs)


def _choose_run(runs: "Sequence[Run]", choice: str) -> "Run | None":
    if choice == "none" or (choice == "auto" and len(runs) > 1):
        return None
    known = [run for run in runs if len(run.samples)]
    misses_m = [
        (found.value or 0.0, run)
        for run in known
        for found in [tl.measure_run(run, only=["final.position_error"])["final.position_error"]]
    ]
    return max(misses_m, key=lambda pair: pair[0])[1] if misses_m else None
