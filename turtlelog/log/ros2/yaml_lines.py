"""The few lines of YAML that a bag's description is made of."""

import re
from collections.abc import Iterator
from typing import Final

from turtlelog.errors import LogError

_LINE: Final = re.compile(r"^(?P<indent> *)(?P<item>- +)?(?P<text>.*?)\s*$")
ENTRY: Final = re.compile(r"^(?P<key>[\w.]+):(?: +(?P<value>.*))?$")
_QUOTED: Final = re.compile(
    r"""^(?:"(?P<double>[^"\\]*)"|'(?P<single>(?:[^']|'')*)')(?:\s+#.*)?$"""
)
_COMMENT: Final = re.compile(r"(?:^|\s)#.*$")


def iterate_entries(text: str, root: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, key and value of the entries right below the root.

    What stands below an entry, list items or keys of its own, comes as text without a key.
    """
    depth: int | None = None
    for number, indent, item, content in _iterate_body(text, root):
        depth = indent if depth is None else depth
        if item or indent > depth:
            yield number, "", content
        else:
            entry = ENTRY.match(content)
            if entry is None:
                raise LogError(f"line {number}: expected key: value, found {content[:60]!r}")
            yield number, entry["key"], entry["value"] or ""
    if depth is None:
        raise LogError(f"expected an entry {root}, found none")


def _iterate_body(text: str, root: str) -> Iterator[tuple[int, int, bool, str]]:
    """Yield the lines below the root: number, indent, whether a list item begins, content."""
    is_inside = False
    for number, line in enumerate(text.splitlines(), start=1):
        found = _LINE.match(line)
        if found is None or not found["text"] or found["text"].startswith(("#", "---")):
            continue
        if not found["indent"] and not found["item"]:
            is_inside = _COMMENT.sub("", found["text"]).rstrip() == f"{root}:"
        elif is_inside:
            yield number, len(found["indent"]), bool(found["item"]), found["text"]


def unquote(number: int, key: str, value: str) -> str:
    """Return a value without its quotes and without a comment behind it."""
    if value[:1] in {'"', "'"}:
        found = _QUOTED.match(value)
        if found is None:
            raise LogError(f"line {number}: {key}: expected text in quotes, found {value[:60]!r}")
        is_double = found["double"] is not None
        return found["double"] if is_double else found["single"].replace("''", "'")
    value = _COMMENT.sub("", value).rstrip()
    if value == "[]":
        return ""
    if value[:1] in {"[", "{", "&", "*", "|", ">", "!"}:
        raise LogError(f"line {number}: {key}: expected plain text, found {value[:60]!r}")
    return "" if value in {"~", "null"} else value
