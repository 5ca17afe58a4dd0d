"""Output of commands: results to stdout, notes to stderr."""

import errno
import json
import math
import os
import re
import shlex
import stat
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import IO, Any, Final, TextIO, TypeVar

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.errors import TurtlelogError, UsageError, format_line
from turtlelog.escapes import escape_controls, guard_cell, hide_secrets

EXIT_FINE: Final = 0
EXIT_FAILED: Final = 1
"""Exit code of a failed check, or of a failed comparison with tolerances."""
EXIT_BAD_INPUT: Final = 2
"""Exit code of bad usage, or of unreadable input."""
EXIT_DEFECT: Final = 70
EXIT_INTERRUPTED: Final = 130

_SPOOLED: Final = 16 * 2**20
"""Size of a long answer that is kept in memory [bytes]."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FormatOptions:
    """Output formats. Default: tables for a terminal.

    Attributes:
        markdown: Print tables as Markdown.
        csv: Print tables as CSV, with full precision.
        latex: Print tables as LaTeX, for the booktabs package.
        json: Print one JSON value instead of tables.
    """

    markdown: bool = False
    csv: bool = False
    latex: bool = False
    json: bool = False

    def choose(self) -> str:
        """Return the requested format: `txt`, `md`, `csv`, `tex` or `json`; refuse several."""
        kinds = {"markdown": "md", "csv": "csv", "latex": "tex", "json": "json"}
        chosen = [name for name in kinds if getattr(self, name)]
        if len(chosen) > 1:
            raise UsageError(f"--{chosen[0]} and --{chosen[1]}: choose one format")
        return kinds[chosen[0]] if chosen else "txt"


Answer = TypeVar("Answer")


def copy_fields(kind: type[Answer], source: object, **changed: Any) -> Answer:
    """Return an answer with a result's fields of the same names; `changed` are the other fields."""
    names = [one.name for one in fields(kind) if one.name not in changed]  # type: ignore[arg-type]
    return kind(**{name: getattr(source, name) for name in names}, **changed)


def print_text(text: str, *, is_data: bool = False) -> None:
    """Print a result. Line breaks in third-party text have been escaped.

    Control characters are escaped, but not in data for a program.
    """
    if not is_data or sys.stdout.isatty():
        text = escape_controls(text, keep="\n")
    with outlive_reader():
        sys.stdout.write(text.rstrip("\n") + "\n")


_COLOURS: Final = {"PASS": "32", "FAIL": "31", "SKIPPED": "33"}
"""Codes of green, red and yellow in ANSI terminals."""


def print_verdicts(text: str) -> None:
    """Print a result with verdicts in lines and cells, in colour if colours are on."""
    text = escape_controls(text, keep="\n").rstrip("\n")
    if shows_colour():
        # A verdict is at the start of a line, or of a cell, which follows two blanks.
        pattern = rf"(?m)(?:^|(?<=  ))({'|'.join(_COLOURS)})(?=[ :]|$)"
        text = re.sub(pattern, lambda found: f"\x1b[{_COLOURS[found[1]]}m{found[1]}\x1b[0m", text)
    with outlive_reader():
        sys.stdout.write(text + "\n")


def shows_colour() -> bool:
    """Return whether stdout has colours: on a terminal, or by request of the environment.

    NO_COLOR and FORCE_COLOR take effect if they are set and not empty. NO_COLOR has priority.
    """
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"


def print_tables(tables: "Sequence[tl.compare.Table]", kind: str) -> None:
    """Print tables in a format, separated by empty lines."""
    texts = (
        fit_table(table) if kind == "txt" else tl.draw.format_table(table, kind) for table in tables
    )
    print_text("\n".join(texts), is_data=kind == "csv")


@contextmanager
def outlive_reader() -> Iterator[None]:
    """Continue if the reader of stdout has ended, like `head`. The exit code stays valid."""
    try:
        yield
    except OSError as err:
        is_closed = err.errno == errno.EPIPE or (
            # A terminal, for which `isatty` returns False when it is closed.
            err.errno == errno.EIO and stat.S_ISCHR(os.fstat(sys.stdout.fileno()).st_mode)
        )
        if not is_closed:
            raise
        drop_stdout()


def flush_stdout() -> None:
    """Send everything printed so far to the reader of stdout."""
    with outlive_reader():
        sys.stdout.flush()


def drop_stdout() -> None:
    """Discard all further output."""
    _drop(sys.stdout)


def _drop(stream: TextIO) -> None:
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


_LINE: Final = 80
"""Characters in a line of sentences, and in any line without a terminal."""


def find_width(stream: TextIO | None = None) -> int:
    """Return the characters in a line of the terminal of a stream; without a terminal 80."""
    stream = stream or sys.stdout
    if not stream.isatty():
        return _LINE
    asked = os.environ.get("COLUMNS", "")
    if asked.isdecimal() and int(asked):
        return int(asked)
    with suppress(OSError):
        return os.get_terminal_size(stream.fileno()).columns or _LINE
    return _LINE


def fill_lines(lines: Iterable[str], *, indent: int = 0) -> str:
    """Return sentences as wrapped lines. Words and formulas stay whole.

    A command at the end of a line continues after a backslash, so that it can be pasted.
    """
    width = find_width()
    return "\n".join(_fill(escape_controls(hide_secrets(line)), indent, width) for line in lines)


def _fill(line: str, indent: int, width: int) -> str:
    width = min(width, _LINE)
    head, *command = re.split(r"[:?] turtlelog ", line, maxsplit=1)
    is_alone = all(", " not in part and not part.endswith(".") for part in command)
    is_command = bool(command) and is_alone and len(head) < width // 2
    end = " \\" if is_command else ""
    filled = textwrap.wrap(
        line,
        width - len(end) if len(line) > width else width,
        subsequent_indent=" " * max(indent, 2 * is_command),
        break_long_words=False,
        break_on_hyphens=False,
    )
    return f"{end}\n".join(filled)


def quote_file(*files: object) -> str:
    """Return files, and options for reading them, as words of a command that a user can type."""
    return escape_controls(shlex.join(map(str, files)))


def name_explain(file: object, law: object, reading: Sequence[str]) -> str:
    """Return the command that explains a run, with the options for reading its file.

    Code that only its recording names must be trusted. Laws of the user's own are named PLACE:NAME.
    """
    trust = " --trust-law" if ":" in str(law) else ""
    return f"turtlelog explain {quote_file(file, *reading)}{trust}"


def advise_explain(file: Path | str, reading: Sequence[str]) -> str | None:
    """Return the command that explains a file; None if it has no samples of a controller."""
    with suppress(TurtlelogError):
        found = tl.log.read_file_info(file)
        lacks = "samples" in found.absent
        return None if lacks else name_explain(file, found.parameters.get("law.kind"), reading)
    return name_explain(file, None, reading)


def write_text(path: Path, text: str) -> None:
    """Write a text file, which appears when it is complete."""
    with tl.log.replace_when_complete(path) as part:
        part.write_text(text, encoding="utf-8")


def write_asked(path: Path | None, write: Callable[[Path], object]) -> None:
    """Write a file if it is requested, and name it in a note."""
    if path is not None:
        write(path)
        print_note(f"wrote {path}")


def list_written(paths: Iterable[object]) -> list[str]:
    """Return a line for every written file. Paths stay whole, including blanks."""
    return [escape_controls(hide_secrets(f"wrote {path}")) for path in paths]


def align_rows(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return indented lines of aligned cells, with the columns that fit a line."""
    while rows:
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        padded = [map(str.ljust, map(escape_controls, row), widths) for row in rows]
        lines = [f"  {'   '.join(row)}".rstrip() for row in padded]
        if len(widths) == 1 or max(map(len, lines)) <= find_width():
            return lines
        rows = [row[:-1] for row in rows]
    return []


def build_table(
    title: str,
    heads: "Iterable[str | tl.compare.Column]",
    rows: Iterable[Iterable[Any]],
    notes: Iterable[str] = (),
) -> "tl.compare.Table":
    """Return a table. A head may end in a unit: `duration [s]`."""
    columns = []
    for head in heads:
        if isinstance(head, str):
            name, _, unit = head.removesuffix("]").partition(" [")
            head = tl.compare.Column(title=name, unit=unit)
        columns.append(head)
    return tl.compare.Table(
        title=title, columns=tuple(columns), rows=tuple(map(tuple, rows)), notes=tuple(notes)
    )


def fit_table(table: "tl.compare.Table") -> str:
    """Return a table that fits a line."""
    return tl.draw.format_table(table, width=find_width())


def fit_body(table: "tl.compare.Table") -> str:
    """Return a table that fits a line, below an empty line in place of its title."""
    return "\n" + fit_table(replace(table, title="")).strip("\n")


_MOST_ROWS: Final = 20
"""Largest number of runs in a table. So many runs fit a screen, and the answer above names the best
run."""


def cut_rows(table: "tl.compare.Table") -> "tl.compare.Table":
    """Return the first rows of a table of runs, with the number of the other rows."""
    more = len(table.rows) - _MOST_ROWS
    if more <= 0:
        return table
    note = f"Runs not shown: {more}. --csv shows all."
    return replace(table, rows=table.rows[:_MOST_ROWS], notes=(note, *table.notes))


def print_note(text: str) -> None:
    """Print a note in one line, with names escaped and secrets of URLs removed.

    On a terminal, the line is wrapped like an answer.
    """
    line = format_line(text)
    try:
        if sys.stderr.isatty():
            line = _fill(line, 2, find_width(sys.stderr))
        sys.stderr.write(line + "\n")
        sys.stderr.flush()
    except OSError:
        # The result and the exit code remain valid. Python 3.14 tries again at its end, and exits
        # with code 120 if that fails too.
        _drop(sys.stderr)


_HELD: Final[list[str]] = []
_MOST_HELD: Final = 100
"""Largest number of notes that wait for the answer; a user of more files sees them one by one."""


def print_run_notes(path: Path | str, notes: Mapping[str, str]) -> None:
    """Print notes on the reading of third-party files, and on losses, after the answer."""
    _HELD.extend(f"{path}: {text}" for text in tl.log.list_notes_after(notes))
    if len(_HELD) > _MOST_HELD:
        print_held_notes()


def print_held_notes() -> None:
    """Print the notes that waited for the answer."""
    for text in _HELD:
        print_note(text)
    _HELD.clear()


def print_error(text: str) -> None:
    """Print an error in one line."""
    print_note(f"turtlelog: error: {text}")


def print_errors(errors: Iterable[TurtlelogError]) -> int:
    """Print errors of files, each in one line, and return the exit code."""
    code = EXIT_FINE
    for err in errors:
        print_error(str(err))
        code = EXIT_BAD_INPUT
    return code


def print_json(value: Any) -> None:
    """Print one JSON value and nothing else. Numbers that are not finite become null.

    Numbers, booleans and arrays of numpy are printed as Python's.
    """
    with outlive_reader():
        sys.stdout.write(_format_json(value) + "\n")


def print_json_list(values: Iterable[Any]) -> None:
    """Print one JSON list like `print_json`, item by item, with little memory.

    Nothing is printed before the last item is ready.
    """
    with _spool() as spool:
        before = "[\n"
        for value in values:
            spool.write(before + textwrap.indent(_format_json(value), "  "))
            before = ",\n"
        spool.write("[]\n" if before == "[\n" else "\n]\n")


def print_csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a CSV table row by row, with little memory, after the last row is ready.

    Without rows nothing is printed.
    """
    import csv

    with _spool() as spool:
        writer = csv.writer(spool, lineterminator="\n")
        is_shown = sys.stdout.isatty()  # else a program reads the cells
        for number, row in enumerate(rows):
            cells = [*map(guard_cell, row)]
            if is_shown:
                cells = [escape_controls(one) if isinstance(one, str) else one for one in cells]
            writer.writerows([cells] if number else [head, cells])


@contextmanager
def _spool() -> Iterator[IO[str]]:
    """Yield a stream whose text is printed at the end of the block."""
    import shutil  # Few answers are that long.
    import tempfile

    with tempfile.SpooledTemporaryFile(_SPOOLED, "w+", encoding="utf-8", newline="") as spool:
        yield spool
        spool.seek(0)
        with outlive_reader():
            shutil.copyfileobj(spool, sys.stdout)


def _format_json(value: Any) -> str:
    return json.dumps(_make_plain(value), indent=2, allow_nan=False)


@cache
def list_json_keys(kind: Any) -> Mapping[str, tuple[str, bool]]:
    """Return the key in JSON of each field of a dataclass, and whether an empty text is null.

    The key is the field's metadata `json`, or its name. JSON lacks a field that the repr lacks.
    """
    from turtlelog.display import NULL_IF_EMPTY  # help does without

    return {
        one.name: (
            one.metadata.get("json", one.name),
            NULL_IF_EMPTY.items() <= one.metadata.items(),
        )
        for one in fields(kind)
        if one.repr
    }


def _make_plain(value: Any) -> Any:
    """Return a value in the types of JSON. Numbers that are not finite become null."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, str):
        return str.__str__(value)
    if isinstance(value, Mapping):
        return {_make_plain(key): _make_plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [*map(_make_plain, value)]
    if is_dataclass(value):
        kind: Any = type(value)
        return {
            key: getattr(value, name) or None if is_text else _make_plain(getattr(value, name))
            for name, (key, is_text) in list_json_keys(kind).items()
        }
    return _make_plain(value.tolist()) if hasattr(value, "dtype") else value
