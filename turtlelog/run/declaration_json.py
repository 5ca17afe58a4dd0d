"""A law's declaration as JSON: in recordings, and in the metadata of tables."""

from dataclasses import asdict
from typing import Final

import msgspec

from turtlelog.errors import LogError, RunError
from turtlelog.run.loops import ControlLoop, Declaration

_LONGEST_REASON: Final = 300
"""Largest number of characters in an error line: a found value may be as long as the record."""


class _Loop(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    name: str
    signal: str
    command: str
    reference: str
    gain: str | None = None
    limit: str | None = None
    is_proportional: bool = True
    integral_gain: str | None = None
    derivative_gain: str | None = None
    derivative_filter: str | None = None


class _Phase(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    loops: tuple[str, ...]


class _Entry(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    loops: tuple[_Loop, ...]
    phases: tuple[_Phase, ...]
    states: tuple[str, ...]
    uses_goal: bool
    state_units: dict[str, str] = {}


def format_declaration(declaration: Declaration) -> str:
    """Return a declaration as JSON; phases are a list because their order matters."""
    entry = _Entry(
        loops=tuple(_Loop(**asdict(loop)) for loop in declaration.loops),
        phases=tuple(_Phase(name=name, loops=of) for name, of in declaration.phases.items()),
        states=declaration.states,
        uses_goal=declaration.uses_goal,
        state_units={**declaration.state_units},
    )
    return msgspec.json.encode(entry).decode()


def parse_declaration(text: str) -> Declaration:
    """Return the declaration in a JSON text.

    Raises:
        LogError: If the text is not a valid declaration; the message gives the place in the JSON
            text.
    """
    try:
        entry = msgspec.json.decode(text, type=_Entry)
        return Declaration(
            loops=tuple(ControlLoop(**msgspec.structs.asdict(loop)) for loop in entry.loops),
            phases=_name_phases(entry.phases),
            states=entry.states,
            state_units=entry.state_units,
            uses_goal=entry.uses_goal,
        )
    except msgspec.MsgspecError as err:
        raise LogError(f"{_shorten(str(err))}, found {text[:60]!r}") from err
    except RunError as err:
        raise LogError(_shorten(str(err))) from err


def _name_phases(phases: tuple[_Phase, ...]) -> dict[str, tuple[str, ...]]:
    named: dict[str, tuple[str, ...]] = {}
    for phase in phases:
        if phase.name in named:
            raise RunError(f"phases: expected each name once, found {phase.name!r} twice")
        named[phase.name] = phase.loops
    return named


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST_REASON else f"{text[: _LONGEST_REASON - 3]}..."
