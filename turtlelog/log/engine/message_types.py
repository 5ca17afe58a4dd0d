"""The text of a `ros2msg` schema -> the fields of a message type."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from turtlelog.errors import LogError

TEXT: Final = "text"
"""Kind of a string; every other kind is a type code of numpy, or the fields of a message."""

_MOST_FIELDS: Final = 10_000  # types nested in types multiply; none that people use comes near
_DEEPEST: Final = 64

LONGEST_TEXT: Final = 2**20
"""Bytes of a definition with all its types that is read; the longest known take a tenth."""

_KINDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "bool": "?",
        "byte": "u1",
        "char": "u1",
        "float32": "f4",
        "float64": "f8",
        **{f"int{8 * size}": f"i{size}" for size in (1, 2, 4, 8)},
        **{f"uint{8 * size}": f"u{size}" for size in (1, 2, 4, 8)},
        "string": TEXT,
    }
)

_BUILTIN: Final[Mapping[str, str]] = MappingProxyType(
    {
        "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
        "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec\n",
        "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    }
)
_SHORT: Final = MappingProxyType(
    {
        "time": "builtin_interfaces/Time",
        "duration": "builtin_interfaces/Duration",
        "Header": "std_msgs/Header",
    }
)

_SEPARATOR: Final = re.compile(r"^={3,}[ \t\r]*\n", re.MULTILINE)
_HEADING: Final = re.compile(r"\s*MSG:[ \t]*(\S+)[ \t\r]*(?:\n|\Z)")
_LINE: Final = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d{1,9})?"
    r"(?P<brackets>\[(?P<bound><=)?(?P<length>\d{0,9})\])?"
    r"\s+(?P<name>[A-Za-z]\w*)\s*(?P<constant>=)?",
    re.ASCII,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One field of a message type.

    Attributes:
        name: Without the names of the messages around it.
        kind: A type code of numpy without byte order, `TEXT`, or the fields of a nested message.
        length: Of a fixed array; None for one value and for a sequence.
        is_sequence: Whether any number of values may stand here.
    """

    name: str
    kind: "str | tuple[Field, ...]"
    length: int | None = None
    is_sequence: bool = False


def parse_schema(name: str, text: str) -> tuple[Field, ...]:
    """Return the fields of the message type `name`, nested types resolved.

    Args:
        name: `package/msg/Type` or `package/Type`.
        text: Its definition; those of nested types follow after lines of equals signs.

    Raises:
        LogError: Where the text is no `ros2msg`, or a nested type is missing or holds itself.
    """
    first, *others = _SEPARATOR.split(text.removesuffix("\n") + "\n")
    definitions = dict(_BUILTIN)
    for part in others:
        heading = _HEADING.match(part)
        if heading is None:
            raise LogError(f"schema {name}: expected MSG: and a type after =====, found none")
        definitions[_shorten(heading[1])] = part[heading.end() :]
    # The first definition may carry its own heading.
    own = _HEADING.match(first)
    definitions[_shorten(name)] = first[own.end() :] if own else first
    return _Resolver(definitions).resolve(_shorten(name), ())


def count_fields(fields: tuple[Field, ...]) -> int:
    """Return how many numbers, texts and sequences fields come to, nested ones among them."""
    count = 0
    for field in fields:
        if isinstance(field.kind, str):
            count += 1
        else:
            count += max(count_fields(field.kind), 1) * (field.length or 1)
    return count


class _Resolver:
    """Puts nested types in, once each, and counts what they come to."""

    def __init__(self, definitions: Mapping[str, str]) -> None:
        self._definitions = definitions
        self._known: dict[str, tuple[tuple[Field, ...], int]] = {}

    def resolve(self, name: str, inside: tuple[str, ...]) -> tuple[Field, ...]:
        if name not in self._known:
            self._known[name] = self._build(name, inside)
        return self._known[name][0]

    def _build(self, name: str, inside: tuple[str, ...]) -> tuple[tuple[Field, ...], int]:
        if name in inside or len(inside) > _DEEPEST:
            raise LogError(f"schema {name}: expected types that end, found one that holds itself")
        if name not in self._definitions:
            raise LogError(f"schema {name}: expected its definition, found none")
        fields, count = [], 0
        for found in _parse_lines(name, self._definitions[name]):
            length = int(found["length"]) if found["length"] and not found["bound"] else None
            kind, size = self._find_kind(name, found["type"], inside)
            count += max(size, 1) * (1 if isinstance(kind, str) or length is None else length)
            is_sequence = found["brackets"] is not None and length is None
            field = Field(name=found["name"], kind=kind, length=length, is_sequence=is_sequence)
            fields.append(field)
            if count > _MOST_FIELDS:
                raise LogError(
                    f"schema {name}: expected up to {_MOST_FIELDS} fields, found {count} or more"
                )
        if len({field.name for field in fields}) < len(fields):
            raise LogError(f"schema {name}: expected names that differ, found one twice")
        return tuple(fields), count

    def _find_kind(
        self, name: str, kind: str, inside: tuple[str, ...]
    ) -> tuple[str | tuple[Field, ...], int]:
        if kind in _KINDS:
            return _KINDS[kind], 1
        if kind == "wstring":
            raise LogError(f"schema {name}: wstring: ROS's middlewares do not agree on its bytes")
        nested = _SHORT.get(kind) or _shorten(kind, package=name.split("/")[0])
        fields = self.resolve(nested, (*inside, name))
        return fields, self._known[nested][1]


def _parse_lines(name: str, text: str) -> Iterator[re.Match[str]]:
    """Yield the lines that define a field; constants and comments are passed over."""
    for line in text.splitlines():
        stripped = line.strip()
        if not stripped or stripped.startswith("#"):
            continue
        found = _LINE.match(stripped)
        if found is None:
            raise LogError(f"schema {name}: expected a type and a name, found {stripped[:60]!r}")
        if not found["constant"]:
            yield found


def _shorten(name: str, package: str = "") -> str:
    """Return `package/Type`, whatever stands between the two or, as eProsima writes it, before."""
    *before, last = name.split("/")
    if before and before[-1] in {"msg", "srv", "action"}:
        before.pop()
    return f"{before[-1] if before else package}/{last}"
