"""A law's declaration in a recording: its entry in the metadata record, and its topics."""

import re
from collections.abc import Mapping
from typing import Any, Final

import msgspec

from turtlelog.errors import LogError, RunError
from turtlelog.laws.sequential_p import DECLARATION as SEQUENTIAL_P
from turtlelog.log.recording.schemas import SCHEMAS, define_states
from turtlelog.log.recording.topics import (
    AFTER_SAMPLES,
    BEFORE_STATES,
    LAW_STATE,
    REFERENCE,
    REFERENCE64,
    Topic,
)
from turtlelog.loops import ControlLoop, Declaration
from turtlelog.scenario import DEFAULT_LAW

_OTHER_LAW: Final = Declaration(phases=dict.fromkeys(("rotate", "pause", "translate", "done"), ()))
"""What is known of another law in format 1: the phases that there were, for everybody."""

_PACKAGE: Final = "turtlelog_msgs/msg"
_LONGEST_TYPE: Final = 60
"""Letters of a type's name; a class may be called anything."""

_LONGEST_REASON: Final = 300
"""Letters of an error line; what is found may be as long as the record."""


class _Loop(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    name: str
    signal: str
    command: str
    reference: str
    gain: str | None = None
    limit: str | None = None


class _Phase(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    loops: tuple[str, ...]


class _Entry(msgspec.Struct, forbid_unknown_fields=True):
    loops: tuple[_Loop, ...]
    phases: tuple[_Phase, ...]
    states: tuple[str, ...]
    uses_goal: bool


def format_declaration(declaration: Declaration) -> str:
    """Return a declaration as JSON; phases are a list, for their order counts."""
    entry = _Entry(
        loops=tuple(
            _Loop(
                name=loop.name,
                signal=loop.signal,
                command=loop.command,
                reference=loop.reference,
                gain=loop.gain,
                limit=loop.limit,
            )
            for loop in declaration.loops
        ),
        phases=tuple(_Phase(name=name, loops=of) for name, of in declaration.phases.items()),
        states=declaration.states,
        uses_goal=declaration.uses_goal,
    )
    return msgspec.json.encode(entry).decode()


def parse_declaration(text: str) -> Declaration:
    """Return the declaration in a JSON text.

    Raises:
        LogError: With what was expected and found; a place in it is as in JSON.
    """
    try:
        entry = msgspec.json.decode(text, type=_Entry)
        return Declaration(
            loops=tuple(ControlLoop(**msgspec.structs.asdict(loop)) for loop in entry.loops),
            phases=_name_phases(entry.phases),
            states=entry.states,
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


def declare_format1(tables: Mapping[str, Any], *, has_samples: bool) -> Declaration:
    """Return what is known of the law of a recording of format 1, which holds no declaration.

    Args:
        tables: The attached tables; what they leave out has the default, so that an imported log
            is one of the sequential law.
        has_samples: Whether it holds samples; without a law's name and samples nothing is known.
    """
    law = tables.get("law")
    kind = law.get("kind") if isinstance(law, Mapping) else None
    if kind is None and not has_samples:
        return Declaration()
    return SEQUENTIAL_P if kind is None or kind == DEFAULT_LAW else _OTHER_LAW


def list_topics(declaration: Declaration | None, kind: object = DEFAULT_LAW) -> tuple[Topic, ...]:
    """Return the topics of a recording in the order in which messages of one time stand.

    Args:
        declaration: None where there is none, as in format 1.
        kind: The law's name, which the type of its states is called after.
    """
    if declaration is None:
        return (*BEFORE_STATES, *AFTER_SAMPLES)
    states = (Topic(LAW_STATE, name_state_type(kind)),) if declaration.states else ()
    references = (REFERENCE, REFERENCE64) if declaration.has_reference else ()
    return (*BEFORE_STATES, *states, *references, *AFTER_SAMPLES)


def define_types(declaration: Declaration, kind: object = DEFAULT_LAW) -> Mapping[str, str]:
    """Return the `ros2msg` text of every type that a recording may hold."""
    if not declaration.states:
        return SCHEMAS
    return {**SCHEMAS, name_state_type(kind): define_states(declaration.states)}


def name_state_type(kind: object) -> str:
    """Return the type of a law's states: `file.py:TurnAndDrive` gives `TurnAndDriveState`."""
    words = re.findall(r"[A-Za-z0-9]+", str(kind).rpartition(":")[2])
    name = "".join(word[0].upper() + word[1:] for word in words)[:_LONGEST_TYPE]
    return f"{_PACKAGE}/{name if name[:1].isalpha() else f'Law{name}'}State"


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST_REASON else f"{text[: _LONGEST_REASON - 3]}..."
