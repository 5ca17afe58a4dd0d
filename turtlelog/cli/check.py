"""`turtlelog check`: check recordings against a specification."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.check_answers import print_marks, print_results
from turtlelog.cli.check_files import ReportOptions, check_files, check_into_table, read_to_judge
from turtlelog.cli.options import Output, Place, ReadingOptions, find_files, list_files
from turtlelog.cli.output import (
    EXIT_FAILED,
    EXIT_FINE,
    FormatOptions,
    fill_lines,
    print_json,
    print_note,
    print_run_notes,
    print_text,
)
from turtlelog.cli.scenario_options import is_recording
from turtlelog.cli.targets import require_apart, require_new_target
from turtlelog.display import describe_count
from turtlelog.errors import ExpressionError, LogError, UsageError
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Spec


Words = Annotated[list[Place], Parameter(name="SPEC FILE")]


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
    init: Place | None = None
    output: Output = None
    schema: bool = False


def check(
    words: Words | None = None,
    /,
    *,
    reference: Place | None = None,
    reports: ReportOptions | None = None,
    first: FirstSpecOptions | None = None,
    formats: FormatOptions | None = None,
    topics: ReadingOptions | None = None,
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
    kind = (formats or FormatOptions()).choose()
    reports, first = reports or ReportOptions(), first or FirstSpecOptions()
    if first.schema:
        from turtlelog.check.spec import build_schema

        print_json(build_schema())
        return EXIT_FINE
    if first.init is not None:
        return _write_first(first.init, words or [], first.output, topics or ReadingOptions())
    words, expect = words or [], first.expect
    files = reports.name_files(_choose_files(words, first))
    _require_targets(reports, first.output, words)
    spec = (
        replace(build_spec(expect), reference=reference)
        if expect
        else tl.load_spec(words[0], reference=reference)
    )
    _require_use(spec, reference if expect else None)
    topics = topics or ReadingOptions()
    if first.output is not None:
        found = find_files(files, first.output)
        files = [Path(one.path) for one in found]
        _require_known(spec, files, topics)
        results = check_into_table(first.output, spec, found, reports, topics)
    else:
        files = list_files(files)
        _require_known(spec, files, topics)
        results = check_files(spec, files, reports, topics)
    if reports.marks:
        if kind != "txt" or reports.all_:
            raise UsageError("--marks prints a line for each recording; leave other formats out")
        return EXIT_FAILED if print_marks(results) == "FAIL" else EXIT_FINE
    verdict = print_results(spec, results, files=len(files), kind=kind, shows_all=reports.all_)
    return EXIT_FAILED if verdict == "FAIL" else EXIT_FINE


def _require_use(spec: "Spec", reference: Path | None) -> None:
    """Refuse a reference that no formula needs.

    Raises:
        UsageError: If there is such a reference.
    """
    from turtlelog.check.judge_formula import list_formula_names
    from turtlelog.check.named_values import TRAJECTORY_VALUES

    if reference is not None and list_formula_names(spec.checks).isdisjoint(TRAJECTORY_VALUES):
        raise UsageError(
            "--reference: leave it out beside --expect, which has no tolerances and names no error"
            " of a trajectory (ate.position.rmse)"
        )


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
        raise UsageError(_describe_no_spec(words))
    if len(words) == 1:
        raise UsageError(f"which recordings? turtlelog check {shlex.quote(str(words[0]))} FILE...")
    return words[1:]


_FORMULA: Final = '"rotate.overshoot <= 2"'
"""Example of a formula."""


def _describe_no_spec(words: list[Path]) -> str:
    """Return what to type if a recording is given in place of the specification."""
    specs = [word for word in words if word.suffix.lower() == ".toml"]
    others = shlex.join(str(word) for word in words if word not in specs)
    if specs:
        spec = shlex.quote(str(specs[0]))
        where = "the specification goes first"
        return f"{words[0]} is a recording; {where}: turtlelog check {spec} {others}"
    return (
        f"{words[0]} is a recording, but check needs a specification first: turtlelog check SPEC"
        f" {others}, or --expect {_FORMULA}, or create one with --init {words[0]}"
    )


def _require_targets(reports: ReportOptions, output: Path | None, words: Sequence[Path]) -> None:
    """Refuse files next to the answer that could not be written."""
    if output is not None and output.suffix.lower() != ".parquet":
        other = "--init, or a name that ends in .parquet"
        raise UsageError(f"--output {output}: needs {other}")
    require_new_target(reports.junit, words, suffix=".xml")
    require_new_target(reports.report, words, suffix=".html")
    targets = (reports.junit, reports.artifacts, reports.report)
    require_apart([path for path in targets if path is not None])


def build_spec(formulas: "Sequence[str]") -> "Spec":
    """Return the specification of --expect; formulas of metrics alone are checked as `expect`."""
    from turtlelog.check.spec import Check
    from turtlelog.check.vocabulary import names_metrics_alone, require_known_names

    checks = []
    for text in formulas:
        formula = tl.expressions.parse_expression(text, source="--expect")
        require_known_names(formula, over_time=True)
        kind: Literal["expect", "holds"] = "expect" if names_metrics_alone(formula) else "holds"
        checks.append(Check(name=text, kind=kind, formula=formula))
    return tl.Spec(checks=tuple(checks), source="--expect")


def _require_known(spec: "Spec", files: Sequence[Path], topics: ReadingOptions) -> None:
    """Refuse names that neither the tables of names nor any recording contains.

    Recordings are read only for names that may be states or parameters of a user law, until one
    recording contains them all.
    """
    from turtlelog.check.vocabulary import is_in_tables, require_known_names

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
    path: Path, words: Sequence[Path], output: Path | None, topics: ReadingOptions
) -> int:
    from turtlelog.check.first_spec import format_first_spec, name_reference

    if words:
        raise UsageError(f"--init: takes one good run and no other file; leave out {words[0]}")
    require_new_target(output, [path], suffix=".toml")
    file, topic = tl.log.split_topic(path)
    choice = topics.build_choice()
    run, notes = read_to_judge(path, choice)
    print_run_notes(path, notes)
    if topic is not None:  # the specification distinguishes both
        choice = replace(choice, pose_topic=topic)
    text = format_first_spec(run, reference=name_reference(file, output), read=choice)
    if output is None:
        print_text(text)
        return EXIT_FINE
    with tl.log.replace_when_complete(output) as part:
        part.write_text(text, encoding="utf-8")
    print_note(f"wrote {output}")
    checks = describe_count(text.count("\n[checks."), "check")
    spec = escape_controls(shlex.quote(str(output)))
    lines = [
        f"{output.name}: {checks} read off {file.name}, each bound with its reason.",
        f"Set each bound to what it should be. Then: turtlelog check {spec} FILE...",
    ]
    print_text(fill_lines(lines))
    return EXIT_FINE
