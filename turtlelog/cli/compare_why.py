"""`turtlelog compare --why`: why a metric differs between two runs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.compare_answer import list_compared
from turtlelog.cli.work import count_jobs, show_progress, watch_summaries
from turtlelog.display import describe_count, join_words, split_numbers
from turtlelog.errors import TurtlelogError, UsageError
from turtlelog.escapes import escape_controls
from turtlelog.files.urls import make_path

if TYPE_CHECKING:
    from turtlelog.cli.compare import ReferenceOptions

_SUFFIXES: Final = (".mcap", ".json", ".csv", ".parquet", ".tum", ".db3", ".bag")
"""Suffixes of recordings except folders. A word after --why with such a suffix is not a metric."""

_LONGEST: Final = 40
"""Longest list of settings in a line [characters]; JSON and CSV contain all."""

_MOST_SETTINGS: Final = 3
"""Largest number of settings of a change in its line; a law has ten and more."""

_MOST_NAMED: Final = 3
"""Largest number of unreadable recordings that a sentence names; stderr has a line for each."""


def compare_why(
    against: "ReferenceOptions",
    files: Sequence[Path],
    *,
    plot: Path | None,
    topics: options.ReadingOptions,
    kind: str,
) -> int:
    """Print why a metric of two runs differs, and return the exit code."""
    metric, files = _split_metric(against, files)
    options.require_pictures(plot, None, files, drawn=(), of="")
    code, told = console.EXIT_FINE, list[str]()
    if against.first is None:
        if len(files) != 2:
            raise UsageError(
                f"--why compares two runs, but {len(files)} {'was' if len(files) == 1 else 'were'}"
                " given; of more, --first EXPRESSION takes the first that meets a condition and the"
                " one before it"
            )
        pair = files[0], files[1]
    else:
        found_pair, code = _find_pair(against.first, files, against.jobs, topics, kind)
        if found_pair is None:
            return code
        pair, told = found_pair
        if metric is None:  # the first metric that the condition names
            names = tl.expressions.parse_expression(against.first, source="--first").names
            metric = next((name for name in names if tl.measure.find_metric_kind(name)), None)
    runs = [replace(options.read_chosen_run(one, topics), name=one.name) for one in pair]
    with show_progress("simulated", 100.0, "%") as progress:
        found = tl.explain_difference(
            *runs,
            metric=metric,
            trust_law=against.trust_law,
            work=tl.explain.Work(jobs=against.jobs, report=progress.count),
        )
    if kind == "json":
        first, second = map(str, pair)
        console.print_json(
            WhyAnswer(first=first, second=second, condition=against.first, explanation=found)
        )
    elif kind == "txt":
        words = [*pair, *options.list_option_words(topics)]
        console.print_text(_format_why(found, words, lead=told))
    else:
        console.print_tables([_tabulate_why(found)], kind)
    console.write_asked(plot, lambda path: tl.draw.write_difference_figure(found, path))
    return code


@dataclass(frozen=True, slots=True, kw_only=True)
class WhyAnswer:
    """Causes of a metric's difference between two recordings.

    Attributes:
        first: File of the first run; None if there is nothing to compare.
        second: File of the second run.
        condition: Given condition, which `second` is the first to meet.
        explanation: Causes of the difference; None if there is nothing to compare.
    """

    first: str | None
    second: str | None
    condition: str | None
    explanation: "tl.explain.ExplainedDifference | None"


def _split_metric(
    against: "ReferenceOptions", files: Sequence[Path]
) -> tuple[str | None, list[Path]]:
    """Return the metric and the files, because the word after --why may be the first file."""
    word = against.why
    if not isinstance(word, str):
        return None, [*files]
    is_metric = tl.measure.find_metric_kind(word) is not None
    path = make_path(word)
    if not is_metric and ("/" in word or path.suffix.lower() in _SUFFIXES or path.exists()):
        return None, [path, *files]
    return word, [*files]


def _find_pair(
    condition: str,
    files: Sequence[Path],
    jobs: int | None,
    topics: options.ReadingOptions,
    kind: str,
) -> tuple[tuple[tuple[Path, Path], list[str]] | None, int]:
    """Return the first recording that meets a condition and the one before it, described."""
    paths = sorted(options.list_files(files), key=lambda path: split_numbers(str(path)))
    errors: list[TurtlelogError] = []
    needed = tl.compare.list_needed_metrics([], where=condition, sort=None, source="--first")
    found = tl.compare.summarise_files(
        paths,
        only=partial(list_compared, needed=needed, is_usual=False),
        topics=topics.build_choice(),
        jobs=count_jobs(jobs, paths),
    )
    summaries = [*watch_summaries(found, len(paths), errors)]
    code = console.print_errors(errors)
    met, notes = tl.compare.select_runs(summaries, condition, source="--first")
    for note in notes:
        console.print_note(note)
    row = summaries.index(met[0]) if met else 0
    if row:
        first, second = Path(summaries[row - 1].file), Path(summaries[row].file)
        told = [f"{second.name} is the first that meets {condition}, after {first.name}."]
        read = {one.file for one in summaries}
        unread = [one.name for one in paths if str(one) < str(second) and str(one) not in read]
        if unread:
            count = describe_count(len(unread), "earlier recording")
            names = join_words(unread[:_MOST_NAMED])
            told.append(f"{count} cannot be read and may meet it, too: {names}.")
        return ((first, second), told), code
    if kind == "json":
        bad = summaries[0].file if met else None
        console.print_json(WhyAnswer(first=None, second=bad, condition=condition, explanation=None))
    elif summaries:
        name, readable = Path(summaries[0].file).name, " that can be read" if errors else ""
        text = f"None of {len(summaries)} recordings{readable} meets {condition}."
        if met:
            text = f"{name} meets {condition}, and no recording{readable} comes before it."
        elif len(summaries) == 1:
            text = f"{name} does not meet {condition}."
        console.print_text(console.fill_lines([text]))
    return None, code


def _format_why(
    found: "tl.explain.ExplainedDifference",
    words: Sequence[object],
    *,
    lead: Sequence[str] = (),
) -> str:
    """Return the causes of a difference: the answer, a line for each change, and its conditions.

    `words`: both files, and options for reading them.
    """
    head, *rest = found.sentences
    rows = []
    for one in found.contributions:
        size, undone = tl.explain.format_change(found, one), ""
        if one.undone is not None:
            undone = f"without: {tl.explain.format_magnitude(found, one.undone)}"
        settings = shorten("; ".join(_list_settings(one)), _LONGEST, placeholder=" ...")
        rows.append((one.name, size, settings, undone))
    table = ["", *console.align_rows(rows), ""] if rows else []
    following = f"turtlelog compare --reference {console.quote_file(*words)}"
    ends = console.fill_lines([*rest, f"Signal by signal: {following}"])
    return "\n".join([console.fill_lines([head, *lead]), *table, ends])


def _list_settings(one: "tl.explain.Change") -> Iterator[str]:
    """Yield the settings of a change. Settings with equal pairs of values share an entry."""
    pairs: dict[tuple[str, str], list[str]] = {}
    for key, before, after in zip(one.keys, one.first, one.second, strict=True):
        if before == after:  # the same seed in both runs
            continue
        pairs.setdefault((_show(before), _show(after)), []).append(key)
    for number, ((before, after), keys) in enumerate(pairs.items()):
        if number == _MOST_SETTINGS:
            yield f"{sum(map(len, [*pairs.values()][number:]))} more"
            return
        yield f"{', '.join(keys)} {before} -> {after}"


def _show(value: Any) -> str:
    if value is None:
        return "none"
    return f"{value:.6g}" if isinstance(value, float) else escape_controls(str(value))


def _tabulate_why(found: "tl.explain.ExplainedDifference") -> "tl.compare.Table":
    """Return a row for each change."""
    unit = f" [{found.unit}]" if found.unit else ""
    heads = ("change", f"contribution{unit}", f"s.e.{unit}", f"undone{unit}", "settings")
    rows = []
    for one in found.contributions:
        settings = "; ".join(_list_settings(one))
        rows.append((one.name, one.contribution, one.standard_error, one.undone, settings))
    return console.build_table(found.sentences[0], heads, rows, found.sentences[1:])
