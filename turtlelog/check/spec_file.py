"""Specification files in TOML: `[checks.NAME]`, and tolerances in `[signals.*]`, `[metrics.*]`."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args

from turtlelog.check.spec import (
    ASSOCIATIONS,
    FORMAT,
    READ_TEXTS,
    USUAL_TRAJECTORY,
    Check,
    Spec,
    Tolerances,
    describe_nearest,
    is_known,
    is_label_signal,
    list_nearby,
    require_known_names,
    require_phase,
)
from turtlelog.compare import ALIGNMENTS, Tolerance, TrajectorySettings, parse_delta
from turtlelog.compare.common_clock import could_be_alignment
from turtlelog.compare.trajectory_comparison import ALIGN_IN
from turtlelog.display import LATEST_S
from turtlelog.errors import CheckError, CompareError, LogError, TurtlelogError
from turtlelog.expressions import Expression, Until, iterate_nodes, parse_expression
from turtlelog.files.text_files import (
    describe_missing,
    describe_value,
    name_key,
    parse_toml,
    read_text_file,
)
from turtlelog.files.urls import is_url, make_path
from turtlelog.log import ReadChoice
from turtlelog.log.read_choice import TimeSource, parse_goal_option, parse_wheelbase, parse_wheels
from turtlelog.run import Run
from turtlelog.scenario import describe_unknown_key

_KINDS: Final = ("signals", "metrics")
_KNOWN: Final = (*_KINDS, "checks", "reference", "alignment", "trajectory", "read")
_KEYS: Final = {"signals": ("abs", "rel", "time_s", "reason"), "metrics": ("abs", "rel", "reason")}

MOST_PARTS: Final = 20_000
"""Largest number of names, numbers and operators in all formulas. `always(speed < 1)` has 4 and
takes 1.2 ms if it fails; the largest number takes 6 s of processor time for a recording of 800
samples."""

_UNTIL: Final = 20
"""Number of parts that each further `until` counts as."""

_Known = TypeVar("_Known", bound=str)

CHECK_KEYS: Final = ("expect", "holds", "phase", "when", "reason", "observed")


def load_spec(path: str | Path, *, reference: str | Path | None = None) -> Spec:
    """Return the specification in a TOML file, which may consist of tolerances alone.

    Args:
        path: The file. A relative `reference` is searched in the folder of the specification.
        reference: Reference to use instead of the file's own reference.

    Raises:
        CheckError: If a key or value is wrong, or the file has no check.
        CompareError: If the file cannot be read, or a tolerance is wrong.
        ExpressionError: If a formula does not parse, or names something unknown.
    """
    tables = read_tables(path)
    named = _read_text(tables, "reference", str(path))
    if reference is None and named is not None:
        reference = make_path(named) if is_url(named) else make_path(path).parent / named
    spec = parse_spec(tables, source=str(path))
    return require_reference(
        replace(spec, reference=None if reference is None else make_path(reference))
    )


def parse_spec(text: str | Mapping[str, Any], *, source: str = "specification") -> Spec:
    """Return the specification in a TOML text or its tables, without loading its reference.

    Raises:
        CheckError: For the reasons given in `load_spec`, which also names the other possible
            errors.
    """
    tables = text
    if isinstance(tables, str):
        tables = _require_known(_parse_toml(tables, source=source), source=source)
    entries = tables.get("checks", {})
    if not isinstance(entries, Mapping):
        raise CheckError(f"{source}: checks: expected tables, found {describe_value(entries)}")
    checks = _parse_checks(entries, source)
    tolerances = parse_tolerances(tables, source=source)
    alignment = _read_text(tables, "alignment", source)
    if alignment is not None and not could_be_alignment(alignment):
        raise CheckError(f"{source}: alignment: {describe_nearest(alignment, ALIGNMENTS)}")
    spec = Spec(
        checks=checks,
        tolerances=tolerances,
        alignment=alignment or "first_sample",
        trajectory=_parse_trajectory(tables.get("trajectory", {}), source),
        read=_parse_read(tables.get("read", {}), source),
        source=source,
    )
    if not spec.checks and not spec.tolerances:
        raise CheckError(f"{source}: has no table [checks.NAME], [signals.NAME] or [metrics.ID]")
    return spec


def require_reference(spec: Spec) -> Spec:
    """Return a specification; raise CheckError if its tolerances have no reference."""
    if spec.tolerances and spec.reference is None:
        raise CheckError(
            f"{spec.source}: tolerances need a recording to compare with: reference = FILE in the"
            " file, or --reference FILE"
        )
    return spec


def load_tolerances(path: str | Path) -> Tolerances:
    """Return the tolerances in a specification file; its other tables are ignored.

    Raises:
        CompareError: If the file cannot be read, is not TOML, has a wrong key or value, or has no
            tolerance.
    """
    tolerances = parse_tolerances(read_tables(path), source=str(path))
    if not tolerances:
        raise CompareError(f"{path}: has no table [signals.NAME] or [metrics.ID]")
    return tolerances


def read_tables(path: str | Path) -> dict[str, Any]:
    """Return the tables of a specification file without its format, which is checked here."""
    try:
        tables = _parse_toml(read_text_file(path), source=str(path))
    except UnicodeDecodeError as err:
        raise CompareError(f"{path}: not TOML, not even text") from err
    except FileNotFoundError as err:
        raise CompareError(f"{path}: {describe_missing(path)}") from err
    except OSError as err:
        expected = "a specification or tolerance file"
        raise CompareError(f"{path}: expected {expected}, found: {err.strerror or err}") from err
    except ValueError as err:
        raise CompareError(f"{path}: not TOML: {err}") from err
    return _require_known(tables, source=str(path))


def _require_known(tables: dict[str, Any], *, source: str) -> dict[str, Any]:
    found = tables.pop("format", None)
    if found is None:
        raise CompareError(f"{source}: the first line of a specification is missing: format = 1")
    if not isinstance(found, int) or isinstance(found, bool) or found < 1:
        raise CompareError(f"{source}: format: expected {FORMAT}, found {describe_value(found)}")
    if found > FORMAT:
        raise CompareError(
            f"{source}: format: expected at most {FORMAT}, found {found}, of a newer turtlelog"
        )
    for key in tables:
        if key not in _KNOWN:
            raise CompareError(
                f"{source}: {name_key(key)}: {describe_unknown_key(key, list(_KNOWN))}"
            )
    return tables


def parse_tolerances(tables: Mapping[str, Any], *, source: str = "tolerances") -> Tolerances:
    """Return the tolerances in the tables `signals` and `metrics`; either may be missing."""
    own = {}
    for kind in _KINDS:
        table = tables.get(kind, {})
        _require_table(table, f"{source}: {kind}", error=CompareError)
        own[kind] = {name: _parse_tolerance(kind, name, one, source) for name, one in table.items()}
    try:
        return Tolerances(**own)
    except CompareError as err:
        raise CompareError(f"{source}: {err}") from err


def _parse_checks(entries: Mapping[str, Any], source: str) -> tuple[Check, ...]:
    checks, parts = [], 0
    for name, entry in entries.items():
        check = _parse_check(name, entry, source)
        parts += count_parts(check)
        if parts > MOST_PARTS:
            raise CheckError(
                f"{source}: the formulas of {len(entries):,} checks have more than {MOST_PARTS:,}"
                " names, numbers and operators, which is the most for one specification. Split the"
                " specification into several files"
            )
        checks.append(check)
    return tuple(checks)


def count_parts(check: Check) -> int:
    """Return the number of names, numbers and operators in formulas; `until` counts as several."""
    nodes = [
        node
        for formula in (check.formula, check.when)
        if formula is not None
        for node in iterate_nodes(formula.root)
    ]
    return len(nodes) + _UNTIL * sum(isinstance(node, Until) for node in nodes)


_MOST_PART_ROWS: Final = 150_000_000
"""Largest product of formula parts and samples. A window takes about 10 ns for each of its four
parts and each sample. All four parts together take 2 s, on a busy machine 5 s."""
_EXPECT: Final = 6
"""Number of additional parts that a bound on a metric counts as, because its violation is searched
by bisection of the run."""
_ANY_PARTS: Final = 400
"""Number of names, numbers and operators that are always allowed, however long the recording is."""


def require_few_parts(spec: Spec, run: Run, file: str) -> None:
    """Refuse checks that would take too long for the rows of a recording."""
    rows = max(len(run.poses), len(run.commands), len(run.samples), 1)
    most = max(_ANY_PARTS, _MOST_PART_ROWS // rows)
    bounds = sum(check.kind == "expect" for check in spec.checks)
    parts = sum(map(count_parts, spec.checks)) + _EXPECT * bounds
    if parts > most:
        raise CheckError(
            f"{file}: the checks of {spec.source} take as long as {parts:,} names, numbers and"
            f" operators; {most:,} are the most for a recording of {rows:,} samples. Split the"
            " specification into several files, or the recording into parts"
        )


def _parse_check(name: str, entry: Any, source: str) -> Check:
    place = f"{source}: checks.{name_key(name)}"
    _require_table(entry, place, CHECK_KEYS)
    if ("expect" in entry) == ("holds" in entry):
        both = ", not both" if "expect" in entry else ""
        raise CheckError(f"{place}: needs expect or holds{both}")
    kind: Literal["expect", "holds"] = "expect" if "expect" in entry else "holds"
    phase = _read_text(entry, "phase", place)
    if phase is not None and kind == "expect":
        raise CheckError(f"{place}.phase: expected holds beside it, found expect")
    if phase is not None:
        try:
            require_phase(phase)
        except CheckError as err:
            raise CheckError(f"{place}.{err}") from err
    observed = _read_truth(entry, "observed", place)
    formula = _parse_formula(entry, kind, place)
    if formula is None:
        raise CheckError(f"{place}.{kind}: the formula is missing")
    return Check(
        name=name,
        kind=kind,
        formula=formula,
        phase=phase,
        when=_parse_formula(entry, "when", place),
        reason=_read_text(entry, "reason", place) or "",
        is_observed=observed,
    )


def _parse_formula(entry: Mapping[str, Any], key: str, place: str) -> Expression | None:
    text = _read_text(entry, key, place)
    if text is None:
        return None
    formula = parse_expression(text, source=f"{place}.{key}")
    require_known_names(formula, over_time=key == "holds")
    return formula


def _parse_trajectory(table: Any, source: str) -> TrajectorySettings:
    place = f"{source}: trajectory"
    keys = ("align", "associate", "max_difference_s", "time_offset_s", "rpe", "all_pairs")
    _require_table(table, place, keys)
    align = _choose(table, "align", place, ALIGN_IN)
    associate = _choose(table, "associate", place, ASSOCIATIONS)
    overlaps = _read_truth(table, "all_pairs", place)
    most_s = _read_time(table, "max_difference_s", place, USUAL_TRAJECTORY.most_apart_s)
    if most_s < 0.0:
        raise CheckError(f"{place}.max_difference_s: expected a time of at least 0, found {most_s}")
    is_start = table.get("time_offset_s") == "start"
    length = table.get("rpe")
    try:
        deltas = USUAL_TRAJECTORY.deltas if length is None else (parse_delta(str(length)),)
    except CompareError as err:
        raise CheckError(f"{place}.rpe: {err}") from err
    return TrajectorySettings(
        align=align,
        interpolates=associate == "linear",
        most_apart_s=most_s,
        offset_s=None if is_start else _read_time(table, "time_offset_s", place, 0.0),
        deltas=deltas,
        overlaps=overlaps,
    )


def _choose(
    table: Mapping[str, Any], key: str, place: str, known: tuple[_Known, ...]
) -> _Known | None:
    """Return the known value for a key; None if the key is missing."""
    value = table.get(key)
    found = next((one for one in known if one == value), None)
    if key in table and found is None:
        raise CheckError(f"{place}.{key}: {describe_nearest(str(value), known)}")
    return found


def _read_truth(table: Mapping[str, Any], key: str, place: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise CheckError(f"{place}.{key}: expected true or false, found {describe_value(value)}")
    return value


def _read_time(table: Mapping[str, Any], key: str, place: str, usual: float) -> float:
    value = table.get(key, usual)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) < LATEST_S:
        raise CheckError(f"{place}.{key}: expected a time in s, found {describe_value(value)}")
    return float(value)


def _parse_read(table: Any, source: str) -> ReadChoice:
    place = f"{source}: read"
    _require_table(table, place, (*READ_TEXTS, "goal", "wheels", "wheelbase", "time", "columns"))
    texts: dict[str, Any] = {name: _read_text(table, name, place) for name in READ_TEXTS}
    time, times = table.get("time", "auto"), get_args(TimeSource)
    if time not in times:
        raise CheckError(
            f"{place}.time: expected {' or '.join(times)}, found {describe_value(time)}"
        )
    columns = table.get("columns", {})
    _require_table(columns, f"{place}.columns")
    numbers: dict[str, Any] = {key: _read_numbers(table, key, place) for key in _NUMBERS}
    return ReadChoice(
        **texts,
        **numbers,
        time=time,
        columns={name: _read_text(columns, name, f"{place}.columns") or "" for name in columns},
    )


_NUMBERS: Final = {
    "goal": "[x, y] in m, or [x, y, heading] with the heading in rad",
    "wheels": "[radius, track] above 0 in m",
    "wheelbase": "a length above 0 in m",
}
"""Keys of `[read]` with numbers, and what is expected."""


def _read_numbers(table: Mapping[str, Any], key: str, place: str) -> Any:
    value = table.get(key)
    if value is None:
        return None
    values = value if isinstance(value, list) else [value]
    are_numbers = all(type(one) in {int, float} for one in values)
    try:
        if key == "wheelbase":
            return parse_wheelbase(value if are_numbers and values is not value else 0.0)
        given = tuple(value) if are_numbers and values is value else ()
        if key == "wheels":
            return parse_wheels(given)
        parse_goal_option(given)
    except LogError as err:
        expected, found = _NUMBERS[key], describe_value(value)
        raise CheckError(f"{place}.{key}: expected {expected}, found {found}") from err
    return tuple(map(float, given))


def _read_text(table: Mapping[str, Any], key: str, place: str) -> str | None:
    text = table.get(key)
    if key in table and (not isinstance(text, str) or not text.strip()):
        colon = "." if re.search(r": (?:checks\.|read)", place) else ": "
        raise CheckError(f"{place}{colon}{key}: expected text, found {describe_value(text)}")
    return text


def _parse_tolerance(kind: str, name: str, entry: Any, source: str) -> Tolerance:
    if not is_known(kind, name):
        raise CompareError(f"{source}: {kind}.{name_key(name)}: {_suggest(kind, name, entry)}")
    place = f'{source}: {kind}."{name}"' if "." in name else f"{source}: {kind}.{name}"
    _require_table(entry, place, _KEYS[kind], error=CompareError)
    reason = entry.get("reason")
    if not isinstance(reason, str) or not reason.strip():
        raise CompareError(f"{place}.reason: expected a reason, found {describe_value(reason)}")
    is_label = kind == "signals" and is_label_signal(name)
    if not is_label and len(entry) < 2:
        wanted = " or ".join(key for key in _KEYS[kind] if key != "reason")
        raise CompareError(f"{place}: needs {wanted}")
    try:
        return Tolerance(**entry)
    except CompareError as err:
        raise CompareError(f"{place}.{err}") from err


def _suggest(kind: str, name: str, entry: Any) -> str:
    """Return a suggestion for an unknown name.

    The quotes may be missing: TOML reads `[metrics.rotate.overshoot]` as a nested table.
    """
    tables = entry.items() if isinstance(entry, Mapping) else ()
    inner = [f"{name}.{key}" for key, table in tables if isinstance(table, Mapping)]
    for key in inner:
        if meant := difflib.get_close_matches(key, list_nearby(kind, key), n=1):
            return f'needs quotes around the id: {kind}."{meant[0]}"'
    return describe_unknown_key(name, list_nearby(kind, name))


def _require_table(
    table: Any, place: str, known: Sequence[str] = (), *, error: type[TurtlelogError] = CheckError
) -> None:
    """Raise an error for a value that is no table, or for a key that is not known."""
    if not isinstance(table, Mapping):
        raise error(f"{place}: expected a table, found {describe_value(table)}")
    for key in table:
        if known and key not in known:
            raise error(f"{place}.{name_key(key)}: {describe_unknown_key(key, list(known))}")


def _parse_toml(text: str, *, source: str) -> dict[str, Any]:
    try:
        return parse_toml(text)
    except ValueError as err:
        raise CompareError(f"{source}: not TOML: {err}") from err
