"""The arrays of the compiled loop: what a scenario begins with, its queues, what its run holds."""

from collections.abc import Collection
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.laws.schedule import MOST_ENTRIES
from turtlelog.plants import round_to_float32
from turtlelog.plants.lagged import find_gauss
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.scenario import Scenario
from turtlelog.simulate.compiled.fields import AXIS, NEVER_NS, fill_axes
from turtlelog.simulate.compiled.law_fields import (
    MOST_OF_SIGNAL,
    MOST_PIECES,
    PIECE,
    SCHEDULED,
    fill_pieces,
    fill_schedule,
    fill_signal,
)
from turtlelog.simulate.random_streams import draw_events, list_streams

ROTATE, TRANSLATE, REORIENT = 0, 2, 3
"""Phases by their number in the declaration of the sequential laws; 1 is the pause."""

STOP_REASONS: Final = (
    *("", "within_tolerance", "standstill", "settled", "timeout", "max_duration"),
    *("path_end", "end_of_signal"),
)
"""By number."""
WITHIN_TOLERANCE, STANDSTILL, SETTLED, TIMEOUT, MAX_DURATION, PATH_END, END_OF_SIGNAL = range(1, 8)

EVENT_KINDS: Final = (
    *("poses_lost", "commands_lost", "commands_dropped"),
    *("wall_hit", "poses_dropped", "stop"),
)
"""By number; stretches of the first three are counted."""
POSES_LOST, COMMANDS_LOST, COMMANDS_DROPPED, WALL_HIT, POSES_DROPPED, STOP = range(6)

SPEED, TURN = 0, 1
"""Axes by number."""

OF_TURTLE, OF_LAW = 0, 1
"""Directions by number: the turtle's heading, and that along which the law measures its errors."""

STATE: Final = np.dtype(
    [
        (name, np.int64)
        for name in (
            *("ticks", "samples", "commands", "events", "stop_reason", "has_failed"),
            *("idle_ns", "hit_wall", "was_at_wall", "phase", "begun", "first_ns", "last_ns"),
            *("still_samples", "close_since_ns", "blocked", "free_at", "waits_for", "newest"),
            *("fires_ns", "is_due", "pose_arrived_ns", "command_arrived_ns"),
            *("poses_first", "poses_end", "poses_dropped", "poses_told"),
            *("queue_first", "queue_end", "commands_dropped", "commands_told"),
            *("transport_first", "transport_end", "arrivals_first", "arrivals_end"),
            *("now_ns", "taken_end", "pushes_first", "pushes_end"),
        )
    ]
    + [
        (name, np.float64)
        for name in (
            *("x_m", "y_m", "down_m", "heading_rad", "speed_m_s", "turn_rate_rad_s"),
            *("pushed_speed", "pushed_turn_rate"),
            *("bearing_rad", "heading_error_rad", "world_v_x_m_s", "world_v_y_m_s"),
            *("heading_before_rad", "error_before_x_m", "error_before_y_m"),
            *("arc_m", "begin_m"),
        )
    ]
)
"""Where a simulation stands: how many rows of each kind there are, the first and the end of each
queue, and what plant, law and controller remember. `-1` stands for none."""

LOSS: Final = np.dtype(
    [(name, np.int64) for name in ("since_ns", "count", "finished_since_ns", "finished")]
)
"""A `LossCount`."""

TICK: Final = np.dtype(
    [
        (name, np.float64)
        for name in (
            *("x_m", "y_m", "heading_rad", "applied_speed", "applied_turn_rate"),
            *("sensed_x_m", "sensed_y_m", "sensed_heading_rad"),
            *("noise_x", "noise_y", "noise_heading", "dropout", "sensing_jitter"),
            *("outlier_chance", "outlier_direction", "outlier_side", "push", "turn_push"),
        )
    ]
)
"""The pose of a tick, as published and as sensed, and its random numbers."""

SAMPLE: Final = np.dtype(
    [
        (name, np.int64)
        for name in ("time_ns", "pose_sequence", "phase", "published_ns", "published")
    ]
    + [
        (name, np.float64)
        for name in (
            *("bearing_rad", "heading_error_rad", "error_x_m", "error_y_m", "distance_m"),
            *("world_v_x_m_s", "world_v_y_m_s", "wanted_speed", "wanted_turn_rate"),
            *("shaped_speed", "shaped_turn_rate", "speed", "turn_rate"),
            *("integral_angular", "derivative_angular", "integral_linear", "derivative_linear"),
            *("lyapunov", "reference_x_m", "reference_y_m", "reference_heading_rad"),
            *("transport_jitter", "loss", "repeat", "late"),
        )
    ]
)
"""A sample, and the random numbers of its command; `published`: the n-th command is of which.

States of a law have the names that it declares.
"""

QUEUED: Final = np.dtype(
    [
        (name, np.int64)
        for name in (
            *("poses", "arrivals", "arrival_ns", "transport", "transport_arrival", "queue"),
            *("taken", "taken_ns"),
        )
    ]
)
"""The n-th entry of each queue."""

DIRECTION: Final = np.dtype(
    [(name, np.float64) for name in ("angle_rad", "cosine", "sine")],
)
"""An angle whose cosine and sine were taken last: most are taken of the same again."""

PUSH: Final = np.dtype([("time_ns", np.int64), ("speed", np.float64), ("turn_rate", np.float64)])
"""What a disturbance adds, and from when on."""

_PUSHES_PER_TICK: Final = 3
"""One from its begin, one where the disturbance begins and one where it ends."""

EVENTS_PER_TICK: Final = 7
"""At most: one of each kind, and two of dropped commands, which are told with or without a time."""


class Memory(NamedTuple):
    """The arrays of the loop. What a scenario does not use of them is never written.

    Attributes:
        ticks: Of `TICK`, one for each tick.
        samples: Of `SAMPLE`.
        queued: Of `QUEUED`, longer than any of the queues gets.
        events: Tick, number of `EVENT_KINDS`, and two numbers of the kind, as `event_watch` words
            them, shape (n, 4).
        losses: Of `LOSS`, by the first of `EVENT_KINDS`, shape (3,).
        axes: Of `AXIS`, speed and turn rate, shape (2,).
        directions: Of `DIRECTION`: `OF_TURTLE` and `OF_LAW`, shape (2,).
        pushes: Of `PUSH`, those of a step.
        gauss: Nodes and weights of a quadrature from 0 to 1, shape (n, 2).
        schedule: As `fill_schedule` returns it, then room.
        pieces: As `fill_pieces` returns them, then room.
        signal: As `fill_signal` returns it, then room.
    """

    ticks: NDArray[Any]
    samples: NDArray[Any]
    queued: NDArray[Any]
    events: NDArray[np.float64]
    losses: NDArray[Any]
    axes: NDArray[Any]
    directions: NDArray[Any]
    pushes: NDArray[Any]
    gauss: NDArray[np.float64]
    schedule: NDArray[np.float64]
    pieces: NDArray[Any]
    signal: NDArray[np.float64]


class _Stream(NamedTuple):
    """Where the random numbers of an effect stand, and how they are distributed."""

    fields: tuple[str, ...]
    kind: Literal["uniform", "normal"] = "uniform"


_OF_TICKS: Final = {
    "noise": _Stream(("noise_x", "noise_y", "noise_heading"), "normal"),
    "outlier": _Stream(("outlier_chance", "outlier_direction", "outlier_side")),
    "dropout": _Stream(("dropout",)),
    "sensing_jitter": _Stream(("sensing_jitter",)),
    "disturbance": _Stream(("push", "turn_push"), "normal"),
}
_OF_SAMPLES: Final = {
    name: _Stream((name,)) for name in ("transport_jitter", "loss", "repeat", "late")
}
"""The streams of `RANDOM_KEYS`, by what their numbers belong to."""


def allocate(ticks: int, samples: int) -> Memory:
    """Return arrays for so many ticks and samples; what is not reached takes no memory."""
    return Memory(
        ticks=np.empty(ticks, TICK),
        samples=np.empty(samples, SAMPLE),
        queued=np.empty(ticks + 2 * samples, QUEUED),
        events=np.empty((EVENTS_PER_TICK * ticks, 4)),
        losses=np.zeros(3, LOSS),
        axes=np.zeros(2, AXIS),
        directions=np.full(2, np.nan, DIRECTION),
        pushes=np.zeros(_PUSHES_PER_TICK, PUSH),
        gauss=np.array(find_gauss()),
        schedule=np.empty((MOST_ENTRIES, 1 + len(SCHEDULED))),
        pieces=np.empty(MOST_PIECES, PIECE),
        signal=np.empty((MOST_OF_SIGNAL, 3)),
    )


def prepare(memory: Memory, scenario: Scenario, ticks: int, samples: int) -> None:
    """Begin a scenario, from rest, and draw the random numbers of its effects, event by event."""
    memory.losses[:] = 0
    memory.axes[:] = fill_axes(scenario)
    for rows, table in (
        (memory.schedule, fill_schedule(scenario)),
        (memory.pieces, fill_pieces(scenario.path)),
        (memory.signal, fill_signal(scenario.law.parameters)),
    ):
        rows[: len(table)] = table
    draw_streams(memory, list_streams(scenario), scenario.seed, ticks, samples)


def draw_streams(
    memory: Memory, names: Collection[str], seed: int, ticks: int, samples: int
) -> None:
    """Draw random numbers, event by event."""
    for rows, events, streams in (
        (memory.ticks, ticks, _OF_TICKS),
        (memory.samples, samples, _OF_SAMPLES),
    ):
        for name, stream in streams.items():
            if name not in names:
                continue
            width = len(stream.fields)
            drawn = draw_events(seed, name, events, width=width, kind=stream.kind)
            for place, field in enumerate(stream.fields):
                rows[field][:events] = drawn[:, place]


def begin(scenario: Scenario) -> NDArray[Any]:
    """Return the state in which a scenario starts, shape (1,)."""
    state = np.zeros(1, STATE)
    start, one = scenario.start, state[0]
    x_m, y_m, heading_rad = start.x_m, start.y_m, start.heading_rad
    down_m = WORLD_SIZE_M - y_m
    if start.precision == "float32":
        x_m, y_m, heading_rad = map(round_to_float32, (x_m, y_m, heading_rad))
        down_m = round_to_float32(WORLD_SIZE_M - y_m)
    one["x_m"], one["y_m"], one["down_m"], one["heading_rad"] = x_m, y_m, down_m, heading_rad
    for name in ("phase", "begun", "close_since_ns", "last_ns", "blocked", "newest"):
        one[name] = -1
    one["fires_ns"], one["waits_for"] = NEVER_NS, scenario.loop.start_backlog
    return state
