"""`turtlelog compare --why`: causes of a metric's difference between two runs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.cli.options import ReadingOptions, list_files, read_chosen_run, require_pictures
from turtlelog.cli.work import count_jobs, require_jobs, show_progress, watch_summaries
from turtlelog.display import describe_count, join_words, split_numbers
from turtlelog.errors import TurtlelogError, UsageError
from turtlelog.escapes import escape_controls
from turtlelog.files.urls import make_path

if TYPE_CHECKING:
    from turtlelog.cli.compare import ReferenceOptions

_LONGEST: Final = 40
"""Longest list of settings in a line [characters]; JSON and CSV contain all."""

_MOST_SETTINGS: Final = 3
"""Largest number of settings of a change in its line; a law has ten and more."""


_SUFFIXES: Final = (".mcap", ".json", ".csv", ".parquet", ".tum", ".db3", ".bag")
"""Suffixes of recordings except folders. A word after --why with such a suffix is not a metric."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WhyOptions:
    """Why two runs differ.

    Attributes:
        why: Explain why this metric differs between two runs. Example: --why run.duration. Default:
            the final position error, or without a goal the error of the last loop.
        first: With --why: explain the first recording, by name, that meets this condition, compared
            with the recording before. Example: "final.position_error > 0.01".
        trust_law: With --why: run the code of the laws that the recordings name.
    """

    why: Annotated[bool | str | None, Parameter(negative=(), metavar="METRIC")] = None
    first: Annotated[str | None, Parameter(metavar="EXPRESSION")] = None
    trust_law: bool = False

    @property
    def is_why(self) -> bool:
        """Whether --why is given.

        Raises:
            UsageError: If an option needs --why.
        """
        lacking = {"--first": self.first is not None, "--trust-law": self.trust_law}
        if not self.why and any(lacking.values()):
            name = next(name for name, is_given in lacking.items() if is_given)
            raise UsageError(f"{name}: needs --why")
        return bool(self.why)


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


def split_metric(against: WhyOptions, files: Sequence[Path]) -> tuple[str | None, list[Path]]:
    """Return the metric and the files, because the word after --why may be the first file."""
    word = against.why
    if not isinstance(word, str):
        return None, [*files]
    is_metric = tl.measure.find_metric_kind(word) is not None
    path = make_path(word)
    if not is_metric and ("/" in word or path.suffix.lower() in _SUFFIXES or path.exists()):
        return None, [path, *files]
    return word, [*files]


def compare_why(
    against: "ReferenceOptions",
    files: Sequence[Path],
    *,
    plot: Path | None,
    topics: ReadingOptions | None,
    kind: str,
) -> int:
    """Print the causes of a metric's difference between two runs."""
    metric, files = split_metric(against, files)
    require_pictures(plot, None, files, drawn=(), of="")
    topics = topics or ReadingOptions()
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
    runs = [replace(read_chosen_run(one, topics), name=one.name) for one in pair]
    with show_progress("simulated", 100.0, "%") as progress:
        found = tl.explain_difference(
            *runs,
            metric=metric,
            trust_law=against.trust_law,
            work=tl.explain.Work(jobs=require_jobs(against.jobs), report=progress.count),
        )
    if kind == "json":
        files_of = {"first": str(pair[0]), "second": str(pair[1])}
        console.print_json(WhyAnswer(**files_of, condition=against.first, explanation=found))
    elif kind == "txt":
        console.print_text(format_why(found, pair, lead=told))
    else:
        console.print_tables([tabulate_why(found)], kind)
    if plot is not None:
        tl.draw.write_difference_figure(found, plot)
        console.print_note(f"wrote {plot}")
    return code


def _find_pair(
    condition: str, files: Sequence[Path], jobs: int | None, topics: ReadingOptions, kind: str
) -> tuple[tuple[tuple[Path, Path], list[str]] | None, int]:
    """Return the first recording that meets a condition and the one before it, described."""
    paths = sorted(list_files(files), key=lambda path: split_numbers(str(path)))
    errors: list[TurtlelogError] = []
    needed = tl.compare.list_needed_metrics([], where=condition, sort=None, source="--first")
    found = tl.compare.summarise_files(
        paths,
        only=partial(_take_needed, needed),
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


_MOST_NAMED: Final = 3
"""Largest number of unreadable recordings that a sentence names; stderr has a line for each."""


def _take_needed(needed: tuple[str, ...], _: "tl.Run") -> tuple[str, ...]:
    return needed


def format_why(
    found: "tl.explain.ExplainedDifference", files: tuple[Path, Path], *, lead: Sequence[str] = ()
) -> str:
    """Return the causes of a difference: the answer, a line for each change, and its conditions."""
    head, *rest = found.sentences
    rows = []
    for one in found.contributions:
        size, undone = tl.explain.format_change(found, one), ""
        if one.undone is not None:
            undone = f"without: {tl.explain.format_magnitude(found, one.undone)}"
        settings = shorten("; ".join(_list_settings(one)), _LONGEST, placeholder=" ...")
        rows.append((one.name, size, settings, undone))
    table = ["", *console.align_rows(rows), ""] if rows else []
    following = f"turtlelog compare --reference {' '.join(map(console.quote_file, files))}"
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


def tabulate_why(found: "tl.explain.ExplainedDifference") -> "tl.compare.Table":
    """Return a row for each change."""
    unit = f" [{found.unit}]" if found.unit else ""
    heads = ("change", f"contribution{unit}", f"s.e.{unit}", f"undone{unit}", "settings")
    rows = []
    for one in found.contributions:
        settings = "; ".join(_list_settings(one))
        rows.append((one.name, one.contribution, one.standard_error, one.undone, settings))
    return console.build_table(found.sentences[0], heads, rows, found.sentences[1:])
