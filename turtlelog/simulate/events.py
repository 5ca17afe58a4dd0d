"""What happened in a tick, in words."""

from collections.abc import Callable
from typing import Any, Final

from turtlelog.run import Event
from turtlelog.simulate.rows import (
    COMMANDS_DROPPED,
    EVENT_KINDS,
    POSES_DROPPED,
    STOP,
    WALL_HIT,
)

_LOSSES: Final = {
    "poses_lost": ("Sensing lost", "pose"),
    "commands_lost": ("The transport lost", "command"),
    "commands_dropped": ("The plant's queue dropped", "command"),
}
"""Who lost what."""


def describe_event(
    row: Any, period_ns: int, name_stop: Callable[[int], str], *, because: str = ""
) -> Event:
    """Return an event in words.

    Args:
        row: Of `EventRow`.
        period_ns: Of the clock [ns].
        name_stop: Returns a stop reason by number.
        because: Goes on after the stop reason.
    """
    number, first, second = int(row.kind), row.first, row.second
    kind = EVENT_KINDS[number]
    if number == WALL_HIT:
        text = f"The turtle hit the wall at x = {first:.3f} m, y = {second:.3f} m."
    elif number == POSES_DROPPED:
        text = f"The controller's queue dropped {int(second)} poses."
    elif number == COMMANDS_DROPPED and first < 0.0:
        text = f"The plant's queue dropped {int(second)} commands."
    elif number == STOP:
        text = describe_stop(name_stop(int(second)), because)
    else:
        text = _describe_loss(kind, int(first), int(second))
    return Event(time_ns=int(row.tick) * period_ns, kind=kind, text=text)


def describe_stop(stop_reason: str, because: str = "") -> str:
    """Return why the run ended."""
    return f"The run ended: {stop_reason.replace('_', ' ')}{because}."


def _describe_loss(kind: str, since_ns: int, lost: int) -> str:
    """Return what a stretch of losses was."""
    who, what = _LOSSES[kind]
    when = f"{what}s from" if lost > 1 else f"{what} at"
    return f"{who} {lost} {when} {since_ns / 1e9:.3f} s{' on' if lost > 1 else ''}."
