"""Reading and writing of the user's small text and TOML files, within size limits.

The end of the file has the words in which errors describe the values of a table.
"""

import dataclasses
import errno
import os
import re
import stat
import textwrap
import time
import types
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Union, get_args, get_origin

from turtlelog.errors import RemoteError, describe_error, find_near, join_names
from turtlelog.files.urls import RemotePath, make_path

if TYPE_CHECKING:
    from msgspec import Meta

MOST_BYTES: Final = 2**20
"""Largest size of a file of settings: some ten thousand checks, which take a second to read."""

LFS_POINTER: Final = b"version https://git-lfs.github.com/spec/v1\n"
"""Beginning of the text that Git LFS leaves in place of a file."""

_PATIENCE_S: Final = 1.0
"""Time for which a pipe may have no writer, for example while both programs start [s]."""

_DEEPEST: Final = 32
"""Largest nesting depth of TOML tables and arrays; files of turtlelog nest at most 4 deep."""

_KEY: Final = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY: Final = re.compile(
    rf"(?:^|[\[{{,])[ \t]*+(?:{_KEY}\.[ \t]*+){{{_DEEPEST + 1}}}", re.MULTILINE
)

_TABLE: Final = re.compile(r"\[([A-Za-z0-9_-]+)\]")
_OF_LINES: Final = ('"""', "'''", "\r")
"""Marks of texts that span several lines, and of line ends that cannot be parsed alone."""

_LONGEST_LINE: Final = 120
_MOST_LINES: Final = 4096
"""Largest length of a cached line, and largest number of cached lines: at most 2 MB."""

_NO_PAIR: Final = (None, None)

_LINE_LENGTH: Final = 80
"""Largest length of a list on one line: with its key about as wide as a terminal."""

_BLANKS: Final = re.compile(r"\s*+")
BLANKS_AND_COMMENTS: Final = re.compile(r"(?:\s++|#[^\n]*+)*+")
"""Text between the lines of data: blanks, or blanks and lines that begin with #."""

_NUMBERS: Final = re.compile(r"\[\n(?P<entries>(?: *[-+.\w]+,\n)+)(?P<indent> *)\]")
_POINTS: Final = re.compile(r"\[\n(?P<entries>(?: *\[[-+.\w, ]+\],\n)+)(?P<indent> *)\]")
"""Lists as tomli-w writes them, one entry per line. Texts do not match, because texts have
quotes."""


def read_text_file(path: str | Path, *, most: int = MOST_BYTES) -> str:
    """Return the text of a file or a pipe.

    Args:
        path: The file.
        most: Largest accepted size [bytes].

    Raises:
        OSError: If the file cannot be read, is too large, or is a device (see `strerror`).
        UnicodeDecodeError: If the file is not text.
    """
    data = _read_bytes(make_path(path), most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"more than {most:,} bytes")
    if data.startswith(LFS_POINTER):
        raise OSError(errno.EINVAL, "a Git LFS pointer, not the file: git lfs pull")
    return data.decode("utf-8-sig")


def _read_bytes(path: Path, most: int) -> bytes:
    if isinstance(path, RemotePath):
        try:
            with path.file.open() as stream:
                return stream.read(most)
        except RemoteError as err:
            raise OSError(errno.EIO, str(err).partition("found ")[2]) from err
    mode = path.stat().st_mode
    if stat.S_ISFIFO(mode):
        return _read_pipe(path, most)
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "a device")
    with path.open("rb") as stream:
        return stream.read(most)


def iterate_lines(text: str, *, comments: bool = True) -> Iterator[tuple[int, str]]:
    """Yield the non-empty lines with their numbers, from 1, with one line in memory at a time.

    Lines that begin with # are `comments`.
    """
    skipped = _BLANKS if comments else BLANKS_AND_COMMENTS
    start, number = 0, 1
    while start < len(text):
        begin = skipped.match(text, start).end()  # type: ignore[union-attr]  # of no blanks, too
        if begin >= len(text):
            return
        number += text.count("\n", start, begin)
        start = max(start, text.rfind("\n", start, begin) + 1)
        end = text.find("\n", begin)
        end = len(text) if end < 0 else end
        yield number, text[start:end].removesuffix("\r")
        start, number = end + 1, number + 1


def describe_csv_error(err: Exception) -> str:
    """Return a description of a CSV error in a cell, with a hint."""
    import csv

    text = str(err)
    if text.startswith("field larger"):
        most = f"a cell of more than {csv.field_size_limit():,} characters"
    elif text == "unexpected end of data":
        most = "a cell that goes on to the end of the file"
    else:
        return text
    return f"{most}; look for a quote that no other closes, and delete it"


def _load_toml(text: str) -> dict[str, Any]:
    import tomllib  # Most commands read no TOML.

    return tomllib.loads(text)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises:
        ValueError: If the text is not TOML or is nested too deeply. The message has one line.
    """
    deep = f"tables or arrays more than {_DEEPEST} deep within each other"
    if not isinstance(text, str):
        raise ValueError(f"expected text, found {text!r:.60}")  # noqa: TRY004
    if _LONG_KEY.search(text):  # tomllib takes the square of its length for each
        raise ValueError(deep)
    try:
        tables = _load_toml(text)
    except RecursionError as err:
        raise ValueError(deep) from err
    except ValueError as err:
        raise ValueError(describe_error(err).removeprefix("TOMLDecodeError: ")) from err
    level: list[Any] = [tables]
    for _ in range(_DEEPEST + 1):
        held = (one.values() if isinstance(one, dict) else one for one in level)
        level = [inner for one in held for inner in one if isinstance(inner, dict | list)]
    if level:
        raise ValueError(deep)
    return tables


def parse_known_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text like `parse_toml`, with a cache of known lines.

    The cache is for tables of one level with one plain value per line, as of similar scenarios.
    """
    tables: dict[str, Any] = {}
    table = tables
    lines = [] if any(sign in text for sign in _OF_LINES) else text.split("\n")
    for line in lines:
        if (heading := _TABLE.fullmatch(line)) is not None and heading[1] not in tables:
            table = tables[heading[1]] = {}
        elif line:
            key, value = _parse_line(line) if len(line) <= _LONGEST_LINE else _NO_PAIR
            if key is None or key in table:
                return parse_toml(text)
            table[key] = value
    return tables if lines else parse_toml(text)


@lru_cache(maxsize=_MOST_LINES)
def _parse_line(line: str) -> tuple[str | None, Any]:
    """Return the key and value of a complete line; `_NO_PAIR` for any other line."""
    try:
        pairs = [*_load_toml(line).items()]
    except (ValueError, RecursionError):
        return _NO_PAIR
    is_plain = len(pairs) == 1 and not isinstance(pairs[0][1], dict | list)
    return pairs[0] if is_plain else _NO_PAIR


def format_toml(tables: Mapping[str, Any]) -> str:
    """Return nested tables as TOML text, with compact lists of numbers and points."""
    import tomli_w  # who reads only spares it

    text = tomli_w.dumps(tables)
    for pattern in (_NUMBERS, _POINTS):
        text = pattern.sub(_join_entries, text)
    return text


def _join_entries(found: re.Match[str]) -> str:
    """Return a list on one line, or a long list on lines of many numbers or of one point each."""
    line = " ".join(found["entries"].split()).removesuffix(",")
    if len(line) <= _LINE_LENGTH:
        return f"[{line}]"
    if found.re is _POINTS:
        return found[0]
    lines = textwrap.wrap(f"{line},", _LINE_LENGTH, break_long_words=False, break_on_hyphens=False)
    indent = found["indent"]
    return "\n".join(["[", *(f"{indent}    {one}" for one in lines), f"{indent}]"])


def _read_pipe(path: Path, most: int) -> bytes:
    """Read a pipe; give up if nobody opens it for writing."""
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb", buffering=0) as stream:
        end_s = time.monotonic() + _PATIENCE_S
        while (first := stream.read(most)) == b"":  # None: somebody is there, and has not begun
            if time.monotonic() > end_s:
                raise OSError(errno.EPIPE, "a pipe that nobody writes to")
            time.sleep(0.01)
        os.set_blocking(stream.fileno(), True)
        data = first or b""
        while len(data) < most and (more := stream.read(most - len(data))):
            data += more
    return data


def describe_missing(path: str | Path, others: Iterable[str] = ()) -> str:
    """Return the message about a missing file, with files or known names that are similar."""
    path = make_path(path)
    if isinstance(path, RemotePath) or not path.parent.is_dir():
        return "no such file"
    names = [one.name for one in path.parent.iterdir()]
    # Of names without their endings: one ending makes no two names alike.
    stems: dict[str, list[str]] = {}
    for name in [*names, *others]:
        stems.setdefault(make_path(name).stem, []).append(name)
    near = [name for stem in find_near(path.stem, stems) for name in stems[stem]][:3]
    shown = [str(path.with_name(name)) if name in names else name for name in near]
    return f"no such file; did you mean {join_names(shown)}?" if near else "no such file"


_WORDS: Final = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}


def describe_type(hint: Any) -> str:
    """Return a description of a type's values: `a number > 0`, `bearing or heading`, `a table`."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        from msgspec import Meta  # only errors need it

        bounds = next((found for found in args[1:] if isinstance(found, Meta)), None)
        return f"{describe_type(args[0])}{_describe_bounds(bounds)}"
    if origin is Literal:
        return " or ".join(map(str, args))
    if origin in {Union, types.UnionType}:
        return " or ".join(describe_type(arg) for arg in args if arg is not type(None))
    if origin in {tuple, list}:
        return f"a list of {len(args)}" if origin is tuple and Ellipsis not in args else "a list"
    is_table = origin is not None or dataclasses.is_dataclass(hint) or hint is dict
    return _WORDS.get(hint, "a table" if is_table else str(getattr(hint, "__name__", hint)))


def describe_value(value: Any, *, longest: int = 60) -> str:
    """Return a value as in a scenario file, cut if it is long; `no value` for None."""
    if value is None:
        return "no value"
    try:
        text = str(value).lower() if isinstance(value, bool) else repr(value)
    except ValueError:
        return "a number of thousands of digits"
    if hasattr(value, "isoformat"):
        text = value.isoformat()
    return text if len(text) <= longest else f"{text[:longest]}... ({len(text)} characters)"


def name_key(key: str) -> str:
    """Return a key in a form that fits into one line."""
    return key if key.isprintable() else repr(key)


def _describe_bounds(bounds: "Meta | None") -> str:
    if bounds is None:
        return ""
    if bounds.ge is not None and bounds.le is not None:
        return f" from {bounds.ge:.10g} to {bounds.le:.10g}"
    if bounds.gt is not None and bounds.le is not None:
        return f" > {bounds.gt:g} and up to {bounds.le:g}"
    low = "" if bounds.gt is None else f" > {bounds.gt:g}"
    return low if bounds.ge is None else f" >= {bounds.ge:g}"
