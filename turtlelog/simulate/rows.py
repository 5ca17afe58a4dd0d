"""The data of the loop: its settings, its state, a row of each kind, and events in words.

In ordinary Python the data are objects, in compiled code records with the same fields.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, partial
from typing import Any, Final, TypeVar

from turtlelog.arithmetic import begin_row, called
from turtlelog.laws.base import LawRow
from turtlelog.parts import NEVER_NS
from turtlelog.run import Event
from turtlelog.run.stop_reasons import name_stop

COMMAND_FAILED, NUMBERS_FAILED, REFERENCE_FAILED, STATES_FAILED, RUNS_AWAY = 1, 2, 3, 4, 5
"""Kinds of failures: an invalid command, error, reference pose or state, and a plant that exceeds
the range of a pose."""

_EVENT_KINDS: Final = (
    *("poses_lost", "commands_lost", "commands_dropped"),
    *("wall_hit", "poses_dropped", "stop"),
)
"""Kinds of events by number."""
POSES_LOST, COMMANDS_LOST, COMMANDS_DROPPED, WALL_HIT, POSES_DROPPED, STOP = range(6)


@dataclass(slots=True, kw_only=True)
class Scene:
    """Settings that the loop reads from a scenario, and that its parts share.

    Attributes:
        period_ns: Step of the plant's clock [ns].
        period_s: The same step [s].
        tick_ns: Period of the plant's own steps, for which laws block [ns].
        block: The same period in the unit of the loop: nanoseconds if poses travel, otherwise steps
            of the clock.
        watchdog_ns: Time after a command at which the plant stops [ns].
        last_tick: Number of the last tick.
        end_ns: End of the run plus 1 [ns].
        timer_ns: Period of the controller's timer [ns]; 0: the controller answers poses.
        first_s: Time before the first sample [s].
        causal_ns: Offset from the end of a step to the time before which a command must arrive to
            act in this step [ns]: 0 for turtlesim, 1 minus the period for a robot model.
        is_exact: Whether poses are published in 64 bits.
        newest_only: Whether the plant takes only the newest command, and drops the others.
        is_timed: Whether command delays are in nanoseconds instead of whole ticks.
        acts_in_steps: Property of the plant, as in `Plant`.
        acts_on_arrival: Whether a command acts from its arrival on.
        delays_poses: Whether poses travel, or a timer triggers answers.
        senses: Whether sensed poses differ from published ones.
        is_pushed: Whether there are disturbances of the plant.
        shapes: Whether commands are shaped.
        has_goal: Whether the law has a goal.
        has_reference: Whether every sample has a reference pose.
        has_states: Whether the law has states of its own.
    """

    period_ns: int = 0
    period_s: float = 0.0
    tick_ns: int = 0
    block: int = 1
    watchdog_ns: float = math.inf
    last_tick: int = 0
    end_ns: int = 0
    timer_ns: int = 0
    first_s: float = 0.0
    causal_ns: int = 0
    is_exact: bool = False
    newest_only: bool = True
    is_timed: bool = False
    acts_in_steps: bool = True
    acts_on_arrival: bool = False
    delays_poses: bool = False
    senses: bool = False
    is_pushed: bool = False
    shapes: bool = False
    has_goal: bool = True
    has_reference: bool = False
    has_states: bool = False


@dataclass(slots=True)
class Losses:
    """Losses by segments; one event for each loss would fill a log.

    Attributes:
        kind: Kind of `_EVENT_KINDS`.
        since_ns: Start of the present segment [ns].
        count: Number of losses in the present segment so far.
        finished_since_ns: Start of the first finished segment that is not recorded yet [ns].
        finished: Number of losses in finished segments that are not recorded yet.
    """

    kind: int = 0
    since_ns: int = 0
    count: int = 0
    finished_since_ns: int = 0
    finished: int = 0


@dataclass(slots=True)
class Progress:
    """State of the loop.

    Attributes:
        ticks: Number of rows of ticks so far; `samples` and `events` are counted likewise.
        published: Number of published commands, which belong to the first samples.
        stop: Stop reason; 0 while the loop runs.
        failure: Kind of failure; 0 without a failure.
        waits_for: Number of poses to wait for before the first answer.
        blocked: Sample whose command waits while the law blocks; -1: no sample.
        free_at: End of the block.
        last_ns: Time of the last answer [ns]; -1: no answer so far.
        poses_first: First pose that may be in the queue.
        poses_count: Number of poses in the queue.
        poses_arrived: First pose that may be on its way.
        pose_arrived_ns: Arrival time of the last pose [ns].
        poses_dropped: Number of poses that the full queue dropped. Events contain
            `poses_reported` of them.
        newest: Newest pose that arrived, for the timer; -1: no pose.
        fires_ns: Next time of the timer [ns].
        is_due: Whether the timer has fired.
        queue_first: First sample whose command may be in the plant's queue.
        queue_count: Number of commands in the queue.
        commands_arrived: First sample whose command may be on its way.
        command_arrived_ns: Arrival time of the last command [ns].
        newest_command: Sample of the newest command that arrived.
        commands_dropped: Number of commands that the full queue dropped. Events contain
            `commands_reported` of them.
        has_losses: Whether a pose or command was lost so far.
        was_at_wall: Whether the plant was at the wall in the previous tick.
        disturbance_speed: Present disturbance of the plant's speed [m/s].
        disturbance_turn_rate: Present disturbance of the plant's turn rate [rad/s].
    """

    ticks: int = 0
    samples: int = 0
    events: int = 0
    published: int = 0
    stop: int = 0
    failure: int = 0
    waits_for: int = 1
    blocked: int = -1
    free_at: int = 0
    last_ns: int = -1
    poses_first: int = 0
    poses_count: int = 0
    poses_arrived: int = 0
    pose_arrived_ns: int = 0
    poses_dropped: int = 0
    poses_reported: int = 0
    newest: int = -1
    fires_ns: int = NEVER_NS
    is_due: bool = False
    queue_first: int = 0
    queue_count: int = 0
    commands_arrived: int = 0
    command_arrived_ns: int = 0
    newest_command: int = -1
    commands_dropped: int = 0
    commands_reported: int = 0
    has_losses: bool = False
    was_at_wall: bool = False
    disturbance_speed: float = 0.0
    disturbance_turn_rate: float = 0.0
    lost_poses: Losses = field(default_factory=partial(Losses, POSES_LOST))
    lost_commands: Losses = field(default_factory=partial(Losses, COMMANDS_LOST))
    dropped_commands: Losses = field(default_factory=partial(Losses, COMMANDS_DROPPED))


@dataclass(slots=True)
class TickRow:
    """A pose as published and as sensed (NaN if it dropped out), and the plant's motion.

    Attributes:
        x_m: x in the world frame [m]; likewise `y_m`.
        heading_rad: Heading, counter-clockwise from +x [rad].
        speed_m_s: Magnitude of the applied velocity [m/s].
        turn_rate_rad_s: Applied turn rate [rad/s].
        arrival_ns: Time of arrival at the controller [ns]; -1: the pose does not arrive, or is not
            queued.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    speed_m_s: float = 0.0
    turn_rate_rad_s: float = 0.0
    sensed_x_m: float = math.nan
    sensed_y_m: float = math.nan
    sensed_heading_rad: float = math.nan
    arrival_ns: int = -1


@dataclass(slots=True)
class SampleRow(LawRow):
    """One controller callback: the values that the law writes, and those of the loop.

    Attributes:
        time_ns: Time at which the pose was answered [ns].
        sequence: Number of the sample, from 0.
        pose_sequence: Number of the pose that the sample read, from 0.
        published_ns: Time at which the command is published [ns]; later than the answer if the law
            blocks.
        arrival_ns: Time [ns] or tick at which the command arrives; -1: never.
        arrivals: Number of times that the command arrives.
        queued: Number of copies of the command in the plant's queue.
        wanted_speed_m_s: Command before shaping and limits [m/s]; likewise
            `wanted_turn_rate_rad_s`.
        shaped_speed_m_s: Command after shaping, before the limits [m/s]; likewise
            `shaped_turn_rate_rad_s`.
        speed_m_s: Command after the limits [m/s]; likewise `turn_rate_rad_s`.
    """

    time_ns: int = 0
    sequence: int = 0
    pose_sequence: int = 0
    published_ns: int = 0
    arrival_ns: int = -1
    arrivals: int = 0
    queued: int = 0
    wanted_speed_m_s: float = math.nan
    wanted_turn_rate_rad_s: float = math.nan
    shaped_speed_m_s: float = math.nan
    shaped_turn_rate_rad_s: float = math.nan
    speed_m_s: float = math.nan
    turn_rate_rad_s: float = math.nan


@dataclass(slots=True)
class EventRow:
    """An event in a tick: its number in `_EVENT_KINDS`, and two numbers that depend on the kind."""

    tick: int = 0
    kind: int = 0
    first: float = 0.0
    second: float = 0.0


_Row = TypeVar("_Row")


@cache
def find_maker(kind: type[_Row]) -> Callable[[], _Row]:
    """Return a function that makes a row with its defaults, in half the time of its class."""
    names: dict[Any, list[str]] = {}
    for one in fields(kind):  # type: ignore[arg-type]
        names.setdefault(repr(one.default), []).append(f"row.{one.name}")
    lines = [f"    {' = '.join(same)} = {default}" for default, same in names.items()]
    text = "\n".join(["def make():", "    row = new(kind)", *lines, "    return row"])
    scope: dict[str, Any] = {"new": object.__new__, "kind": kind, "nan": math.nan}
    exec(text, scope)
    made: Callable[[], _Row] = scope["make"]
    return made


# Events of the loop, which is also compiled.


def add_event(now: Any, rows: Any, tick: int, kind: int, first: float, second: float) -> None:
    """Add an event of a tick, with its two numbers as in `describe_event`."""
    event = begin_row(rows.events, rows.new[0].event, now.events)
    event.tick, event.kind, event.first, event.second = tick, kind, first, second
    now.events += 1


@called
def add_losses(now: Any, losses: Any, rows: Any, tick: int) -> None:
    """Record ended segments of losses once; at the end of the run, all segments."""
    if now.stop != 0:
        end_loss_segment(losses)
    if losses.finished > 0:
        since_ns, count = float(losses.finished_since_ns), float(losses.finished)
        add_event(now, rows, tick, losses.kind, since_ns, count)
        losses.finished = 0


def count_loss(now: Any, losses: Any, time_ns: int) -> None:
    """Count a pose or command lost at a time [ns], in a segment of losses."""
    now.has_losses = True
    if losses.count == 0:
        losses.since_ns = time_ns
    losses.count += 1


def end_loss_segment(losses: Any) -> None:
    """End a segment of losses when something arrives. The segments of a tick become one event."""
    if losses.count > 0:
        if losses.finished == 0:
            losses.finished_since_ns = losses.since_ns
        losses.finished += losses.count
        losses.count = 0


_LOSSES: Final = {
    "poses_lost": ("Sensing lost", "pose"),
    "commands_lost": ("The transport lost", "command"),
    "commands_dropped": ("The plant's queue dropped", "command"),
}
"""Sources of losses, and words for lost items."""


def describe_event(row: Any, period_ns: int, stops: Sequence[str], *, because: str = "") -> Event:
    """Return a sentence on an event.

    Args:
        row: Row of `EventRow`.
        period_ns: Period of the clock [ns].
        stops: Stop reasons of the law, in order.
        because: Text after the stop reason.
    """
    number, first, second = int(row.kind), row.first, row.second
    kind = _EVENT_KINDS[number]
    if number == WALL_HIT:
        text = f"The turtle hit the wall at x = {first:.3f} m, y = {second:.3f} m."
    elif number == POSES_DROPPED:
        text = f"The controller's queue dropped {int(second)} poses."
    elif number == COMMANDS_DROPPED and first < 0.0:
        text = f"The plant's queue dropped {int(second)} commands."
    elif number == STOP:
        text = describe_stop(name_stop(int(second), stops), because)
    else:
        who, what = _LOSSES[kind]
        lost, since_s = int(second), int(first) / 1e9
        when = f"{what}s from {since_s:.3f} s on" if lost > 1 else f"{what} at {since_s:.3f} s"
        text = f"{who} {lost} {when}."
    return Event(time_ns=int(row.tick) * period_ns, kind=kind, text=text)


def describe_stop(stop_reason: str, because: str = "") -> str:
    """Return a sentence on the end of the run."""
    return f"The run ended: {stop_reason.replace('_', ' ')}{because}."
