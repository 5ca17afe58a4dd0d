"""`turtlelog report`: runs as one HTML file."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.check_answers import CountedResults, conclude
from turtlelog.cli.work import show_progress
from turtlelog.display import format_number
from turtlelog.errors import ExplainError, TurtlelogError

if TYPE_CHECKING:
    from turtlelog.charts.curve_marks import ViolatedSignal
    from turtlelog.check import CheckResult


def report(
    files: options.Files,
    /,
    *,
    output: Annotated[options.Place, Parameter(name=("--output", "-o"))],
    spec: options.Place | None = None,
    explain: Literal["auto", "worst", "none"] = "auto",
    topics: options.ReadingOptions = options.ReadingOptions(),
    json: options.Json = False,
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
    options.require_files(files)
    options.require_there(files)
    typed, files = files, options.list_files(files)
    specs = [] if spec is None else [spec]
    options.require_new_target(output, [*files, *specs], suffix=".html")
    runs = options.read_runs(files, topics)
    found = _explain(runs, explain)
    pairs = [(str(file), run) for file, run in zip(files, runs, strict=True)]
    results = [] if spec is None else [*tl.check_runs(tl.load_spec(spec), pairs)]
    names = dict(zip(map(str, files), tl.compare.name_runs(runs), strict=False))
    words = [*map(str, typed), *([] if spec is None else ["--spec", str(spec)])]
    words += [] if explain == "auto" else ["--explain", explain]
    words += options.list_option_words(topics)
    with show_progress("drawing"):
        tl.draw.write_report(
            runs,
            output,
            sources=files,
            explanation=found,
            checks=build_check_lines(results, names, dict(pairs)),
            command=shlex.join(["turtlelog", "report", *words, "-o", str(output)]),
        )
    verdict = tl.check.join_verdicts(results) if results else None
    answer = ReportAnswer(
        ending=tl.compare.describe_runs(runs),
        output=str(output),
        bytes=output.stat().st_size,
        runs=[ReportedRun(file=file, name=run.name) for file, run in pairs],
        explained=found.run.name if found is not None and found.attribution is not None else None,
        verdict=None if verdict is None else verdict.value,
    )
    if json:
        console.print_json(answer)
    else:
        checked = [conclude(CountedResults(results), len(files))] if results else []
        said = console.fill_lines([*checked, answer.ending])
        console.print_text("\n".join([said, *console.list_written([output])]))
    return console.EXIT_FAILED if verdict == "FAIL" else console.EXIT_FINE


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
        verdict: Verdict of all checks.
    """

    ending: str
    output: str
    bytes: int
    runs: list[ReportedRun]
    explained: str | None
    verdict: str | None


def build_check_lines(
    results: "Sequence[CheckResult]", names: "Mapping[str, str]", runs: "Mapping[str, tl.Run]"
) -> "list[tl.draw.CheckLine]":
    """Return results in the form for a report."""
    from turtlelog.check.violation import find_violated_signal
    from turtlelog.draw.report_drawing import MOST_VIOLATIONS

    def tell(value: float | None, unit: str) -> str:
        return "" if value is None else format_number(value, unit)

    signals: dict[int, ViolatedSignal] = {}
    for number, found in enumerate(results):
        if found.file in runs and found.verdict == "FAIL" and len(signals) < MOST_VIOLATIONS:
            signal = find_violated_signal(runs[found.file], found).signal
            signals |= {} if signal is None else {number: signal}
    return [
        tl.draw.CheckLine(
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


def _explain(runs: "Sequence[tl.Run]", choice: str) -> "tl.draw.Explanation | None":
    if choice == "none" or (choice == "auto" and len(runs) > 1):
        return None
    known = [run for run in runs if len(run.samples)]
    if not known:
        return None
    name = "final.position_error"
    run = max(known, key=lambda run: tl.measure_run(run, only=[name])[name].value or 0.0)
    try:
        tl.explain.require_trust(run, trust_law=False)
        found = tl.identify_run(run)
        if found.scenario is None:
            raise ExplainError("no scenario stands for this log")
        with show_progress("simulated", 100.0, "%") as progress:
            attribution = tl.attribute_run(
                run, identified=found, work=tl.explain.Work(report=progress.count)
            )
        what_ifs = tl.explain.simulate_what_ifs(found, attribution)
    except TurtlelogError as err:
        return tl.draw.Explanation(run=run, note=str(err))
    return tl.draw.Explanation(run=run, attribution=attribution, what_ifs=what_ifs)
