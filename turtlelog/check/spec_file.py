"""Specification files: TOML in. Beside tolerances they hold `[checks.NAME]` tables."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

from turtlelog.check.spec import Check, Spec
from turtlelog.check.vocabulary import describe_nearest, require_known_names, require_phase
from turtlelog.compare import ALIGNMENTS, parse_tolerances, read_tables
from turtlelog.compare.ids import could_be_alignment
from turtlelog.errors import CheckError
from turtlelog.expressions import Expression, parse_expression
from turtlelog.scenario import describe_unknown_key
from turtlelog.scenario.describe import describe_value, name_key

CHECK_KEYS: Final = ("expect", "holds", "phase", "when", "reason", "observed")


def load_spec(path: str | Path, *, reference: str | Path | None = None) -> Spec:
    """Return the specification in a TOML file; one of tolerances alone is one, too.

    Args:
        path: The file. Its `reference` is looked for beside it.
        reference: Takes the place of the file's own.

    Raises:
        CheckError: Where a key or value is wrong or nothing is to be checked.
        CompareError: Where the file cannot be read, or a tolerance is wrong.
        ExpressionError: Where a formula does not parse, or names what is not there.
    """
    tables = read_tables(path)
    named = _read_text(tables, "reference", str(path))
    if reference is None and named is not None:
        reference = Path(path).parent / named
    spec = parse_spec(tables, source=str(path))
    return require_reference(
        replace(spec, reference=None if reference is None else Path(reference))
    )


def parse_spec(tables: Mapping[str, Any], *, source: str = "specification") -> Spec:
    """Return the specification in the tables of a file, its reference left out.

    Raises:
        CheckError: As `load_spec`, and so are the others.
    """
    own = {key: tables[key] for key in ("signals", "metrics") if key in tables}
    entries = tables.get("checks", {})
    if not isinstance(entries, Mapping):
        raise CheckError(f"{source}: checks: expected tables, found {describe_value(entries)}")
    spec = Spec(
        checks=tuple(_parse_check(name, entry, source) for name, entry in entries.items()),
        tolerances=parse_tolerances(own, source=source),
        alignment=_read_alignment(tables, source),
        source=source,
    )
    if not spec.checks and not spec.tolerances:
        raise CheckError(
            f"{source}: expected at least one table [checks.NAME], [signals.NAME] or"
            " [metrics.ID], found none"
        )
    return spec


def require_reference(spec: Spec) -> Spec:
    """Refuse tolerances that nothing is compared with.

    Raises:
        CheckError: Where there are tolerances and no reference.
    """
    if spec.tolerances and spec.reference is None:
        raise CheckError(
            f"{spec.source}: reference: expected a recording that tolerances are taken from,"
            " found none"
        )
    return spec


def _parse_check(name: str, entry: Any, source: str) -> Check:
    place = f"{source}: checks.{name_key(name)}"
    if not isinstance(entry, Mapping):
        raise CheckError(f"{place}: expected a table, found {describe_value(entry)}")
    for key in entry:
        if key not in CHECK_KEYS:
            found = describe_unknown_key(key, list(CHECK_KEYS))
            raise CheckError(f"{place}.{name_key(key)}: {found}")
    kind = _choose_kind(entry, place)
    phase = _read_text(entry, "phase", place)
    if phase is not None and kind == "expect":
        raise CheckError(f"{place}.phase: expected holds beside it, found expect")
    if phase is not None:
        _require_phase(phase, place)
    observed = entry.get("observed", False)
    if not isinstance(observed, bool):
        found = describe_value(observed)
        raise CheckError(f"{place}.observed: expected true or false, found {found}")
    formula = _parse_formula(entry, kind, place)
    if formula is None:
        raise CheckError(f"{place}.{kind}: expected a formula, found none")
    return Check(
        name=name,
        kind=kind,
        formula=formula,
        phase=phase,
        when=_parse_formula(entry, "when", place),
        reason=_read_text(entry, "reason", place) or "",
        is_observed=observed,
    )


def _require_phase(phase: str, place: str) -> None:
    try:
        require_phase(phase)
    except CheckError as err:
        raise CheckError(f"{place}.{err}") from err


def _choose_kind(entry: Mapping[str, Any], place: str) -> Literal["expect", "holds"]:
    if ("expect" in entry) == ("holds" in entry):
        found = "both" if "expect" in entry else "none"
        raise CheckError(f"{place}: expected either expect or holds, found {found}")
    return "expect" if "expect" in entry else "holds"


def _parse_formula(entry: Mapping[str, Any], key: str, place: str) -> Expression | None:
    text = _read_text(entry, key, place)
    if text is None:
        return None
    formula = parse_expression(text, source=f"{place}.{key}")
    require_known_names(formula, over_time=key == "holds")
    return formula


def _read_alignment(tables: Mapping[str, Any], source: str) -> str:
    alignment = _read_text(tables, "alignment", source)
    if alignment is not None and not could_be_alignment(alignment):
        raise CheckError(f"{source}: alignment: {describe_nearest(alignment, ALIGNMENTS)}")
    return alignment or "first_sample"


def _read_text(table: Mapping[str, Any], key: str, place: str) -> str | None:
    text = table.get(key)
    if key in table and (not isinstance(text, str) or not text.strip()):
        colon = "." if ": checks." in place else ": "
        raise CheckError(f"{place}{colon}{key}: expected text, found {describe_value(text)}")
    return text
