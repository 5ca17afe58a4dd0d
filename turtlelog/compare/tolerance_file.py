"""Tolerance files: TOML in.

The file is also that of specifications: tables of other stages may stand beside `signals` and
`metrics`, and each stage reads its own.
"""

import difflib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

from turtlelog.compare.tolerances import (
    Tolerance,
    Tolerances,
    is_known,
    is_label_signal,
    list_nearby,
)
from turtlelog.errors import CompareError
from turtlelog.scenario import describe_unknown_key
from turtlelog.scenario.describe import describe_value, name_key
from turtlelog.text_files import parse_toml, read_text_file

FORMAT: Final = 1
"""The format that is read; older ones would be migrated, newer ones are refused."""

OTHERS: Final = ("checks", "reference", "alignment")
"""Tables and keys of the same file that belong to other stages."""

_OWN: Final = ("signals", "metrics")
_KEYS: Final = {
    "signals": ("abs", "rel", "time_s", "reason"),
    "metrics": ("abs", "rel", "reason"),
}


def load_tolerances(path: str | Path) -> Tolerances:
    """Return the tolerances in a TOML file; tables of other stages are left to them.

    Raises:
        CompareError: Where the file cannot be read, is no TOML, a key or value is wrong, or nothing
            is to be judged.
    """
    tables = read_tables(path)
    own: dict[str, Any] = {key: tables[key] for key in _OWN if key in tables}
    tolerances = parse_tolerances(own, source=str(path))
    if not tolerances:
        raise CompareError(
            f"{path}: expected at least one table [signals.NAME] or [metrics.ID], found none"
        )
    return tolerances


def read_tables(path: str | Path, *, others: Collection[str] = OTHERS) -> dict[str, Any]:
    """Return the tables of a tolerance or specification file, its format checked and left out.

    Args:
        path: A TOML file.
        others: Names that may stand beside `signals` and `metrics`; their contents are not judged.

    Raises:
        CompareError: Where the file cannot be read, is no TOML, is of another format or holds a
            table of another name.
    """
    tables = _read_toml(path)
    _require_format(tables, source=str(path))
    known = [*_OWN, *others]
    for key in tables:
        if key not in known:
            raise CompareError(f"{path}: {name_key(key)}: {describe_unknown_key(key, known)}")
    return tables


def parse_tolerances(tables: Mapping[str, Any], *, source: str = "tolerances") -> Tolerances:
    """Return the tolerances in tables of names `signals` and `metrics`, either may be missing.

    Raises:
        CompareError: `source: place: expected ..., found ...`, for the first key that is wrong.
    """
    own = {kind: _parse_kind(kind, tables.get(kind, {}), source) for kind in _OWN}
    try:
        return Tolerances(**own)
    except CompareError as err:
        raise CompareError(f"{source}: {err}") from err


def _parse_kind(kind: str, table: Any, source: str) -> dict[str, Tolerance]:
    _require_table(table, f"{source}: {kind}")
    return {name: _parse_tolerance(kind, name, entry, source) for name, entry in table.items()}


def _parse_tolerance(kind: str, name: str, entry: Any, source: str) -> Tolerance:
    if not is_known(kind, name):
        raise CompareError(f"{source}: {kind}.{name_key(name)}: {_suggest(kind, name, entry)}")
    place = f'{source}: {kind}."{name}"' if "." in name else f"{source}: {kind}.{name}"
    _require_table(entry, place)
    for key in entry:
        if key not in _KEYS[kind]:
            known = describe_unknown_key(key, list(_KEYS[kind]))
            raise CompareError(f"{place}.{name_key(key)}: {known}")
    reason = entry.get("reason")
    if not isinstance(reason, str) or not reason.strip():
        raise CompareError(f"{place}.reason: expected a reason, found {describe_value(reason)}")
    is_label = kind == "signals" and is_label_signal(name)
    if not is_label and len(entry) < 2:
        wanted = " or ".join(key for key in _KEYS[kind] if key != "reason")
        raise CompareError(f"{place}: expected {wanted}, found none of them")
    try:
        return Tolerance(**entry)
    except CompareError as err:
        raise CompareError(f"{place}.{err}") from err


def _suggest(kind: str, name: str, entry: Any) -> str:
    """Say what an unknown name may have been meant to be.

    TOML takes `[metrics.rotate.overshoot]` for a table in a table: the quotes are missing.
    """
    tables = entry.items() if isinstance(entry, Mapping) else ()
    inner = [f"{name}.{key}" for key, table in tables if isinstance(table, Mapping)]
    meant = [
        found
        for key in inner
        for found in difflib.get_close_matches(key, list_nearby(kind, key), n=1)
    ]
    if meant:
        return f'expected quotes around the id, as in {kind}."{meant[0]}", found none'
    return describe_unknown_key(name, list_nearby(kind, name))


def _require_format(tables: dict[str, Any], *, source: str) -> None:
    found = tables.pop("format", None)
    if not isinstance(found, int) or isinstance(found, bool) or found < 1:
        raise CompareError(f"{source}: format: expected {FORMAT}, found {describe_value(found)}")
    if found > FORMAT:
        raise CompareError(
            f"{source}: format: expected at most {FORMAT}, found {found}, of a newer turtlelog"
        )


def _require_table(table: Any, place: str) -> None:
    if not isinstance(table, Mapping):
        raise CompareError(f"{place}: expected a table, found {describe_value(table)}")


def _read_toml(path: str | Path) -> dict[str, Any]:
    try:
        return parse_toml(read_text_file(path))
    except UnicodeDecodeError as err:
        raise CompareError(f"{path}: expected TOML, found bytes that are no text") from err
    except OSError as err:
        found = err.strerror or err
        raise CompareError(
            f"{path}: expected a specification or tolerance file, found: {found}"
        ) from err
    except ValueError as err:
        raise CompareError(f"{path}: expected TOML, found: {err}") from err
