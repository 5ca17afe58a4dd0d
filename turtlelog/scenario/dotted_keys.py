"""Keys, types and values of scenario files in words, and nested tables by dotted key."""

import dataclasses
import types
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Union, get_args, get_origin

import msgspec

from turtlelog.errors import ScenarioError

if TYPE_CHECKING:
    from turtlelog.run import Parameter


DEFAULT_LAW: Final = "sequential-p"
"""Default of `law.kind`."""


def nest_parameters(parameters: "Mapping[str, Parameter]") -> dict[str, Any]:
    """Return values by dotted key as nested tables.

    Raises:
        ScenarioError: If a key is both a value and a table.
    """
    tables: dict[str, Any] = {}
    for key, value in parameters.items():
        set_nested(tables, key, value)
    lost = parameters.keys() - flatten_tables(tables).keys()
    if lost:
        raise ScenarioError(f"{min(lost)}: part of this key has a value already")
    return tables


def set_nested(tables: dict[str, Any], key: str, value: Any) -> None:
    """Set a value by its dotted key in nested tables; missing tables are created.

    Raises:
        ScenarioError: If a table of the key is a value, or the key itself is a table.
    """
    *parents, last = key.split(".")
    for depth, parent in enumerate(parents, start=1):
        tables = tables.setdefault(parent, {})
        if not isinstance(tables, dict):
            above = ".".join(parents[:depth])
            raise ScenarioError(f"{above}: expected a value, found a key below it")
    tables[last] = value


def flatten_tables(tables: Mapping[str, Any]) -> "dict[str, Parameter]":
    """Return the values of nested tables by dotted key."""
    found: dict[str, Any] = {}
    for key, value in tables.items():
        if isinstance(value, Mapping):
            found |= {f"{key}.{inner}": one for inner, one in flatten_tables(value).items()}
        else:
            found[key] = value
    return found


_WORDS = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}


def describe_type(hint: Any) -> str:
    """Return a description of a type's values: `a number > 0`, `bearing or heading`, `a table`."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        bounds = next((found for found in args[1:] if isinstance(found, msgspec.Meta)), None)
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


def _describe_bounds(bounds: msgspec.Meta | None) -> str:
    if bounds is None:
        return ""
    if bounds.ge is not None and bounds.le is not None:
        return f" from {bounds.ge:.10g} to {bounds.le:.10g}"
    if bounds.gt is not None and bounds.le is not None:
        return f" > {bounds.gt:g} and up to {bounds.le:g}"
    low = "" if bounds.gt is None else f" > {bounds.gt:g}"
    return low if bounds.ge is None else f" >= {bounds.ge:g}"
