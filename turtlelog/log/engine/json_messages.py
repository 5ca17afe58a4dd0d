"""Decoding of JSON messages with the JSON schema in the file."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import msgspec
import numpy as np

from turtlelog.errors import LogError
from turtlelog.log.engine.message_types import DEEPEST, LONGEST_TEXT, MOST_FIELDS, Column

JsonKind = Literal["number", "integer", "boolean", "string", "any"]

LONGEST_MESSAGE: Final = 2**24
"""Largest size of a message [bytes]. Decoded objects may take thirty times as much memory."""

_MOST_PARTS: Final = 2**18
"""Largest number of objects, references and choices that are read in a schema.

References to objects with references multiply, even without fields. Reading this number of parts
takes 0.5 s; a text of 1 MB has fewer objects."""

_EXPECTED: Final[Mapping[JsonKind, str]] = MappingProxyType(
    {
        "number": "a number",
        "integer": "a whole number",
        "boolean": "true or false",
        "string": "a text",
    }
)
"""Kinds of values in words."""
_NUMBERS: Final = MappingProxyType({"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf})
"""Texts that represent numbers missing in JSON, in protobuf's JSON."""

_ABSENT: Final = object()


@dataclass(frozen=True, slots=True, kw_only=True)
class JsonField:
    """One value in each message.

    Attributes:
        path: Names of the enclosing objects, then the name of the value.
        kind: Kind in the schema; `any` for arrays, objects without properties, and values with
            several allowed kinds.
    """

    path: tuple[str, ...]
    kind: JsonKind

    @property
    def name(self) -> str:
        """The path as a dotted name."""
        return ".".join(self.path)


def read_json_schema(name: str, data: bytes) -> tuple[JsonField, ...]:
    """Return the fields of messages that a schema in `jsonschema` describes."""
    if len(data) > LONGEST_TEXT:
        raise LogError(f"schema {name}: expected up to {LONGEST_TEXT} bytes, found {len(data)}")
    try:
        schema = json.loads(data)
    except (ValueError, RecursionError) as err:
        raise LogError(f"schema {name}: expected JSON, found: {err}") from err
    fields: dict[str, JsonField] = {}
    for field in _Schema(name, schema).list_fields(schema, ()):
        if not field.path or field.name.startswith("#"):
            found = repr(field.name[:40]) if field.path else "no field"
            raise LogError(f"schema {name}: expected an object with named fields, found {found}")
        if field.name in fields:
            raise LogError(f"schema {name}: expected names that differ, found {field.name} twice")
        fields[field.name] = field
        if len(fields) > MOST_FIELDS:
            raise LogError(f"schema {name}: expected up to {MOST_FIELDS} fields, found more")
    return tuple(fields.values())


def decode_objects(
    fields: Sequence[JsonField],
    messages: Sequence[bytes],
    decode: Callable[[int, bytes], dict[str, Any]] | None = None,
) -> dict[str, Column]:
    """Return the fields of messages as columns, by dotted name.

    Without `decode`, a function from the index and bytes of a message to an object, they are JSON.
    Missing numbers are NaN, missing texts empty, other missing values None. Columns of integers or
    truth values with missing values become float columns.
    """
    columns: list[list[Any]] = [[] for _ in fields]
    for row, data in enumerate(messages):  # one at a time: objects are larger than their text
        found = (decode or _decode)(row, data)
        for field, column in zip(fields, columns, strict=True):
            value = _take(field, row, found)
            is_there = value is not _ABSENT and value is not None
            column.append(_convert(field, row, value) if is_there else None)
    pairs = zip(fields, columns, strict=True)
    return {field.name: _build_column(field.kind, column) for field, column in pairs}


class _Schema:
    """A schema with a limited number of look-ups."""

    def __init__(self, name: str, root: Any) -> None:
        self._name, self._root, self._left = name, root, _MOST_PARTS

    def list_fields(self, schema: Any, path: tuple[str, ...]) -> Iterator[JsonField]:
        """Yield the fields of messages, including those of nested objects."""
        schema = self._resolve(schema)
        properties = schema.get("properties")
        if not isinstance(properties, dict):
            yield JsonField(path=path, kind=_find_kind(schema))
            return
        if len(path) > DEEPEST:
            raise LogError(
                f"schema {self._name}: expected types that end, found one that holds itself"
            )
        for key, inner in properties.items():
            yield from self.list_fields(inner, (*path, key))

    def _resolve(self, schema: Any) -> dict[str, Any]:
        """Resolve a schema: the target of a reference, or the only kind apart from null."""
        for _ in range(DEEPEST):
            if not isinstance(schema, dict):
                return {}
            listed = schema.get("anyOf") or schema.get("oneOf")
            listed = listed if isinstance(listed, list) else []
            self._spend(1 + len(listed))
            choices = [choice for choice in listed if choice != {"type": "null"}]
            if "$ref" in schema:
                schema = self._follow(str(schema["$ref"]))
            elif len(choices) == 1:
                schema = choices[0]
            else:
                return schema
        raise LogError(f"schema {self._name}: expected references that end, found one to itself")

    def _spend(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise LogError(
                f"schema {self._name}: its objects refer to each other more than {_MOST_PARTS:,}"
                " times; write a schema with fewer objects"
            )

    def _follow(self, reference: str) -> Any:
        parts = reference.removeprefix("#").split("/")[1:]
        self._spend(len(parts))
        found = self._root
        for part in parts:
            found = found.get(part) if isinstance(found, dict) else None
        if found is None or not reference.startswith("#"):
            raise LogError(f"schema {self._name}: no definition at {reference[:60]!r}")
        return found


def _find_kind(schema: Mapping[str, Any]) -> JsonKind:
    named = schema.get("type")
    kinds = [kind for kind in (named if isinstance(named, list) else [named]) if kind != "null"]
    if set(kinds) == {"integer", "number"}:
        kinds = ["number"]
    return next((kind for kind in _EXPECTED if kinds == [kind]), "any")


def _decode(row: int, data: bytes) -> dict[str, Any]:
    if len(data) > LONGEST_MESSAGE:
        most = LONGEST_MESSAGE
        raise LogError(f"message {row}: expected up to {most} bytes of JSON, found {len(data)}")
    try:
        try:
            found = msgspec.json.decode(data)
        except msgspec.DecodeError:
            # Python writes NaN and Infinity, which JSON does not have.
            found = json.loads(data)
    except (ValueError, RecursionError) as err:
        raise LogError(f"message {row}: expected JSON, found {data[:40]!r}: {err}") from err
    if not isinstance(found, dict):
        raise LogError(f"message {row}: expected a JSON object, found {data[:40]!r}")
    return found


def _take(field: JsonField, row: int, found: Any) -> Any:
    """Return a field's value; `_ABSENT` if an object on its path is absent or null."""
    for depth, key in enumerate(field.path):
        if found is None or found is _ABSENT:
            return _ABSENT
        if not isinstance(found, dict):
            place = ".".join(field.path[:depth])
            text = repr(found)[:40]
            raise LogError(f"message {row}: {place}: expected an object, found {text}")
        found = found.get(key, _ABSENT)
    return found


def _convert(field: JsonField, row: int, value: Any) -> Any:
    """Convert a value, which must have the kind of the field, for its column."""
    kind, is_number = field.kind, isinstance(value, int | float) and not isinstance(value, bool)
    if kind == "any":
        return value
    if kind == "number":
        if is_number:
            return _widen(value)
        if isinstance(value, str) and value in _NUMBERS:
            return _NUMBERS[value]
    elif kind == "integer":
        if is_number and value == value // 1 and abs(value) < math.inf:
            return int(value)
    elif isinstance(value, bool if kind == "boolean" else str):
        return value
    found = repr(value)[:40]
    raise LogError(f"message {row}: {field.name}: expected {_EXPECTED[kind]}, found {found}")


def _widen(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _build_column(kind: JsonKind, values: list[Any]) -> Column:
    if kind in {"any", "string"}:
        column = np.empty(len(values), dtype=object)
        for row, value in enumerate(values):
            column[row] = "" if value is None and kind == "string" else value
        return column
    has_gaps = any(value is None for value in values)
    if kind == "number" or has_gaps:
        return np.array([math.nan if v is None else _widen(v) for v in values], dtype=np.float64)
    try:
        return np.array(values, dtype=np.bool_ if kind == "boolean" else np.int64)
    except OverflowError:
        return np.array([_widen(value) for value in values], dtype=np.float64)
