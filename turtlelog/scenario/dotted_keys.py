"""Nested tables <-> values by dotted key, as in `law.kp_linear`. Loads no law and no plant."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

from turtlelog.errors import ScenarioError

if TYPE_CHECKING:
    from turtlelog.run import Parameter

DEFAULT_LAW: Final = "sequential-p"
"""The value of `law.kind` where a scenario has none."""


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
    """Set a value by its dotted key in nested tables, which are made where they are missing.

    Raises:
        ScenarioError: If a key on the way holds a value, or the key itself a table.
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
    return dict(_walk(tables, ""))


def _walk(tables: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in tables.items():
        if isinstance(value, Mapping):
            yield from _walk(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
