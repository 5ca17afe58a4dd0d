"""`turtlelog metrics`: measurement of recordings."""

import re
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.list_names import complete_metrics
from turtlelog.cli.metrics_answer import (
    MOST_SAID,
    drop_words,
    find_value,
    format_run,
    format_runs,
    list_jumps,
    list_motion,
    list_resolutions,
    list_scatter,
    list_summary_metrics,
    tell_range,
)
from turtlelog.cli.usage import Whole, parse_option
from turtlelog.cli.work import WorkOptions, summarise_table, tabulate, watch_summaries
from turtlelog.display import describe_count
from turtlelog.errors import MeasureError, TurtlelogError, UsageError
from turtlelog.escapes import escape_controls


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureOptions:
    """How to measure. Values of a heading loop are in rad, of other loops in m.

    Attributes:
        metric: Ids or patterns of metrics. Example: rotate.overshoot,final.*. List: turtlelog list
            metrics.
        band: Half-width of the settling band, as a fraction of the step [1]. Default: 0.02.
        initial: Start of the step [rad or m]: NUMBER or LOOP=NUMBER. Default: the first value.
        final: End of the step [rad or m]: reference, last, NUMBER, or LOOP=VALUE. Default:
            reference.
        reference_path: CSV of x,y [m] for cross-track errors. Default: the line to the goal.
        goal_tolerance: Distance to the goal that counts as reached, for run.time_to_goal [m].
            Default: the band.
        dead_time: Dead time of the delayed ideal loop [samples]. Default: as measured.
    """

    metric: Annotated[str | None, Parameter(metavar="IDS", completer=complete_metrics)] = None
    band: Annotated[float | None, Parameter(metavar="SHARE")] = None
    initial: Annotated[str | None, Parameter(metavar="VALUE")] = None
    final: Annotated[str | None, Parameter(metavar="VALUE")] = None
    reference_path: options.Place | None = None
    goal_tolerance: Annotated[float | None, Parameter(metavar="METRES")] = None
    dead_time: Annotated[Whole | None, Parameter(metavar="SAMPLES")] = None

    def build_settings(self) -> "tl.MeasureSettings":
        """Return the options as settings."""
        path = self.reference_path
        asked: dict[str, Any] = {
            "band": self.band,
            "initial": None if self.initial is None else _parse_values("--initial", self.initial),
            "final": None if self.final is None else _parse_values("--final", self.final),
            "reference_path_xy_m": None if path is None else tl.measure.read_reference_path(path),
            "dead_time_ticks": self.dead_time,
            "goal_tolerance_m": self.goal_tolerance,
        }
        given = {name: value for name, value in asked.items() if value is not None}
        with _name_options():
            return tl.MeasureSettings(**given)


@contextmanager
def _name_options() -> Iterator[None]:
    """Replace the names of settings in errors by the options as typed."""
    try:
        yield
    except MeasureError as err:
        key, _, problem = str(err).partition(":")
        if key not in {one.name for one in fields(tl.MeasureSettings)}:
            raise
        option = re.sub(r"_(m|ticks)$", "", key).replace("_", "-")
        raise UsageError(f"--{option}:{problem}") from err


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredFile:
    """The JSON answer for one file.

    Attributes:
        file: Name of the file as given.
        name: Name of the run.
        ending: End at the goal.
        jumps: Jumps that the path length contains.
        scatter: Path and turning without steps back and forth.
        gaps: Time without poses.
        rest: Motion that counts as rest.
        resolution: Resolution of the poses.
        leads: Motion that leads its commands.
        metrics: Requested metrics. Default: all metrics.
    """

    file: str
    name: str
    ending: str | None
    jumps: str | None
    scatter: str | None
    gaps: str | None
    rest: str | None
    resolution: str | None
    leads: str | None
    metrics: list[dict[str, Any]]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FolderOptions(WorkOptions):
    """Options for many recordings.

    Attributes:
        output: Write a row for every file to this .parquet table, and print a summary alone. Files
            that have not changed since the table was written are not read again.
    """

    output: options.Output = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TableAnswer:
    """Result of a table of recordings: numbers of read, unchanged and unreadable files."""

    output: str
    files: int
    read: int
    unchanged: int
    failed: int


def metrics(
    files: options.Files,
    /,
    *,
    measuring: MeasureOptions = MeasureOptions(),
    all_: Annotated[bool, Parameter(name="--all")] = False,
    folders: FolderOptions = FolderOptions(),
    formats: console.FormatOptions = console.FormatOptions(),
    topics: options.ReadingOptions = options.ReadingOptions(),
) -> int:
    """Measure recordings: where each run ends, and how its loops respond.

    For one run, its loops are side by side. For several runs, each has a row, in order of their
    gains. A cell without a value shows a status, and the reason is below the table. With --all or
    --metric, metrics are listed by their ids, up to six runs side by side. JSON and CSV contain
    every metric of each file, in the order given. A file that cannot be read is reported on stderr;
    the others are measured, and the exit code is 2.

    Example: turtlelog metrics kp1.mcap kp4.mcap

    Example: turtlelog metrics kp4.mcap --metric "translate.*" --band 0.05

    Example: turtlelog metrics runs -o table.parquet

    Args:
        files: Recordings (.mcap), ROS 2 bags, tables (.csv, .parquet, .tum), or the paper's logs
            (.json, .csv).
        all_: Show every metric, not only the essential ones.
    """
    options.require_files(files)
    choice = replace(topics.build_choice(), allow_no_poses=True)
    kind, files = formats.choose(), folders.name_files(files)
    patterns = options.split_names(measuring.metric, "--metric")
    if folders.output is not None:
        if kind not in {"txt", "json"}:
            raise UsageError("--output: takes --json, no other format")
        plan = tl.sweep.plan_metric_table(measuring.build_settings(), only=patterns, topics=choice)
        found = options.find_files(files, folders.output)
        inputs = [Path(one.path) for one in found]
        options.require_new_target(folders.output, inputs, suffix=".parquet")
        return _tell(tabulate(found, folders.output, plan, work=folders), kind)
    files = options.list_files(files)
    is_short = patterns is None and not all_ and kind not in {"json", "csv"}
    settings = measuring.build_settings()
    essential = partial(list_summary_metrics, has_path=measuring.reference_path is not None)
    errors: list[TurtlelogError] = []
    with _name_options(), folders.find_place(files) as place:
        summarised = tl.compare.summarise_files(
            files,
            settings,
            only=essential if is_short else patterns,
            topics=choice,
            jobs=place,
            with_parameters=False,
        )
        summaries = watch_summaries(summarised, len(files), errors)
        if kind == "json":
            console.print_json_list(map(_build_measured, summaries))
        elif kind == "csv":
            rows = _CsvRows(summaries)
            _refuse_patterns(None if rows.units else patterns, rows.declarations)
            rows.print()
        else:
            held = list(summaries)
            if not any(found.metrics for found in held):
                _refuse_patterns(patterns, [found.declaration for found in held])
            if is_short:
                held = list(tl.compare.complete_summaries(held, settings, topics=choice))
                _print_essential(held, kind, options.list_option_words(topics))
            else:
                _print_chosen(held, kind)
    return console.print_errors(errors)


def _build_measured(one: "tl.compare.RunSummary") -> MeasuredFile:
    return MeasuredFile(
        file=one.file,
        name=one.name,
        ending=None if one.goal_end is None else one.goal_end.describe(),
        jumps=one.notes.get("jumps"),
        scatter=next(list_scatter(one, "", one.metrics), None),
        gaps=next(list_motion(one, "", ["gaps"]), None),
        rest=next(list_motion(one, "", ["crept"]), None),
        resolution=next(list_motion(one, "", ["resolution"]), None),
        leads=next(list_motion(one, "", ["leads"]), None),
        metrics=[metric.to_dict() for metric in one.metrics.values()],
    )


def _print_essential(
    summaries: "Sequence[tl.compare.RunSummary]", kind: str, reading: Sequence[str]
) -> None:
    """Print the essential metrics: sentences for one run, a row per run for several.

    `reading`: words of options that further commands on the same file need, too.
    """
    if kind != "txt":
        _print_chosen([drop_words(one) for one in summaries], kind, is_essential=True)
    elif len(summaries) == 1:
        who = tl.compare.label_file(summaries[0].file)
        console.print_text(format_run(summaries[0], who, reading=reading))
    elif summaries:
        console.print_text(format_runs(summaries))


_MOST_COLUMNS: Final = 6
"""Largest number of runs, or metrics, side by side; more runs become rows."""


def _print_chosen(
    summaries: "Sequence[tl.compare.RunSummary]", kind: str, *, is_essential: bool = False
) -> None:
    """Print the metrics of runs as a table by id; as text, the answer comes first."""
    if not summaries:
        return
    declarations = [found.declaration for found in summaries]
    ids = (name for found in summaries for name in found.metrics)
    chosen = tl.compare.order_ids(ids, declarations)
    if is_essential:
        chosen = tl.compare.drop_absent(summaries, chosen)
    summaries = tl.compare.order_by_gain(summaries)
    notes: list[str] = []
    if kind == "txt":
        summaries, notes = tl.compare.shorten_names(summaries)
    is_wide = len(summaries) > _MOST_COLUMNS
    if is_wide or (kind == "txt" and len(summaries) > 1 and len(chosen) <= _MOST_COLUMNS):
        table = tl.tabulate_runs(summaries, only=chosen)
        if kind == "txt":
            reasons = tl.compare.list_reasons(found.metrics for found in summaries)
            table = replace(table, marks={}, notes=reasons)
    else:
        names = tl.compare.name_runs(summaries)
        measured = [
            {name: found for name, found in summary.metrics.items() if name in chosen}
            for summary in summaries
        ]
        table = tl.compare.tabulate_measured(names, measured, declarations=declarations)
    notes += [*list_jumps(summaries, chosen), *list_resolutions(summaries)]
    table = replace(table, notes=(*table.notes, *notes))
    if kind != "txt":
        console.print_tables([table], kind)
        return
    console.print_text(f"{_describe_chosen(summaries, chosen)}\n{console.fit_body(table)}")


def _describe_chosen(summaries: "Sequence[tl.compare.RunSummary]", chosen: Sequence[str]) -> str:
    """Return the values of a few metrics; for more metrics, the end of the run or their number."""
    several = describe_count(len(summaries), "run")
    who = several if len(summaries) > 1 else tl.compare.label_file(summaries[0].file)
    if len(chosen) <= MOST_SAID:
        said = [f"{name} {tell_range(summaries, name)}" for name in chosen]
        return console.fill_lines([f"{who}: {', '.join(said)}."])
    count = describe_count(len(chosen), "metric")
    if len(summaries) == 1:
        if {"final.position_error", "run.duration"} <= {*chosen}:
            return console.fill_lines([f"{who}: {tl.compare.describe_end(summaries[0])}."])
        known = sum(find_value(summaries[0], name) is not None for name in chosen)
        return f"{who}: {count}, {known} with a value."
    first = next((name for name in _FIRST if name in chosen), chosen[0])
    return console.fill_lines([f"{who}, {count}: {first} {tell_range(summaries, first)}."])


_FIRST: Final = ("final.position_error", "run.duration")
"""Metrics for the first line about many metrics of several runs; the first available metric is
used."""


def _tell(done: "tl.sweep.TabulatedFiles", kind: str) -> int:
    if kind == "json":
        unchanged = done.files - done.read
        console.print_json(
            console.copy_fields(TableAnswer, done, output=str(done.output), unchanged=unchanged)
        )
    else:
        console.print_text(escape_controls(summarise_table(done)))
    for label, reason in done.errors:
        console.print_error(f"{label}: {reason}")
    more = done.failed - len(done.errors)
    if more:
        console.print_error(f"{more} more cannot be read: see the column error of {done.output}")
    return console.EXIT_BAD_INPUT if done.failed else console.EXIT_FINE


def _refuse_patterns(
    patterns: Sequence[str] | None, declarations: "Collection[tl.Declaration]"
) -> None:
    if patterns is None or not declarations:
        return
    known = tl.measure.list_metrics(*declarations)
    raise UsageError(tl.measure.describe_no_metric(patterns[0], known))


class _CsvRow(NamedTuple):
    """A run: its file, its name, and its metrics with ids, and values or reasons."""

    file: str
    name: str
    ids: tuple[str, ...]
    values: "array[float]"
    reasons: dict[int, str]


class _CsvRows:
    """CSV rows in the given order, some kB per run; the columns are known after the last run."""

    def __init__(self, summaries: "Iterable[tl.compare.RunSummary]") -> None:
        """Store the values of runs one by one."""
        self.declarations: dict[tl.Declaration, None] = {}
        self._rows: list[_CsvRow] = []
        self._ids: dict[tuple[str, ...], tuple[str, ...]] = {}
        self.units: dict[str, dict[str, bool]] = {}
        for summary in summaries:
            self._add(summary)

    def _add(self, summary: "tl.compare.RunSummary") -> None:
        found = summary.metrics
        ids = self._ids.setdefault(tuple(found), tuple(found))
        values = array("d", [0.0 if one.value is None else one.value for one in found.values()])
        reasons = {
            place: str(one.status.value)
            for place, one in enumerate(found.values())
            if one.value is None
        }
        self._rows.append(_CsvRow(summary.file, summary.name, ids, values, reasons))
        self.declarations[summary.declaration] = None
        for name, one in found.items():
            units = self.units.setdefault(name, {})
            units[one.unit] = units.get(one.unit, False) or one.value is not None

    def print(self) -> None:
        """Print the rows below the names of the columns."""
        chosen = tl.compare.order_ids(self.units)
        heads = [f"{name} [{' or '.join(self._list_units(name))}]" for name in chosen]
        console.print_csv(
            ["file", "run", *heads], (self._list_cells(row, chosen) for row in self._rows)
        )

    def _list_units(self, name: str) -> list[str]:
        """Return the units of metrics with values; without values, the first unit."""
        units = self.units[name]
        return [unit for unit, has_value in units.items() if has_value] or [*units][:1]

    def _list_cells(self, row: _CsvRow, chosen: Sequence[str]) -> "list[str | float | None]":
        cells = {
            name: row.reasons.get(place, row.values[place]) for place, name in enumerate(row.ids)
        }
        return [row.file, row.name, *(cells.get(name) for name in chosen)]


Value = float | str


def _parse_values(option: str, text: str) -> Value | Mapping[str, Value]:
    if "=" not in text:
        return _parse_value(option, text)
    pairs = [part.partition("=") for part in text.split(",")]
    return {loop.strip(): _parse_value(option, value) for loop, _, value in pairs}


def _parse_value(option: str, text: str) -> Value:
    text = text.strip()
    if option == "--final" and text in {"reference", "last"}:
        return text
    words = "reference, last, a number" if option == "--final" else "a number"
    return parse_option(option, text, float, f"{words} or LOOP=VALUE,...")
