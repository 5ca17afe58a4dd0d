"""The commands that drive a simulated robot in place of a recorded one, and what is random."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import CompareError
from turtlelog.identify.axis_motion import AXES, Axis, AxisMotion, get_commands
from turtlelog.run import CommandColumns, Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.columns import take_rows
from turtlelog.run.loops import PLANT_KEYS, read_number
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.simulate.streams import RANDOM_KEYS, list_streams

_FADED: Final = 1e-3
"""Share of an earlier rate below which it no longer counts."""

_STANDING: Final = 0.02
"""Mean rate, as a share of the largest command, below which a robot stands."""

_LOOK_S: Final = 0.3
"""For how long a robot must be seen to stand before its first command [s]."""

_BEFORE_S: Final = 60.0
"""Of the commands longer before the first pose the last one is simulated alone [s]."""

_HALF: Final = 0.5

_ROUNDING_NS: Final = 1000
"""What a double of seconds since 1970 cannot tell [ns]: a silence ends before the next command."""


def list_commands(
    run: Run, motions: Mapping[Axis, AxisMotion], scenario: Scenario
) -> CommandColumns:
    """Return the commands while poses are recorded, with a 0 where the robot stops by itself."""
    first_ns, last_ns = int(run.poses.time_ns[0]), int(run.poses.time_ns[-1])
    columns = run.commands
    time_ns, speed, turn_rate = columns.time_ns, columns.speed_m_s, columns.turn_rate_rad_s
    if time_ns[0] >= last_ns:
        raise CompareError(
            f"{run.name}: expected commands while poses are recorded, found them from"
            f" {(time_ns[0] - last_ns) / 1e9:.3g} s after the last pose on"
        )
    begin_ns = first_ns - round(_BEFORE_S * 1e9)
    first = max(int(np.searchsorted(time_ns, begin_ns, side="right")) - 1, 0)
    after = int(np.searchsorted(time_ns, last_ns, side="right"))
    held = {"speed": speed[first:after].copy(), "turn_rate": turn_rate[first:after].copy()}
    time_ns = np.maximum(time_ns[first:after], begin_ns)
    for axis in AXES:
        for stop in motions[axis].stops:
            # It is down to half by then, and the simulated robot takes its own time to get there.
            begun = max(int(np.searchsorted(time_ns, round(stop.begin_s * 1e9), "right")) - 1, 0)
            earlier_s = _find_delay(scenario, axis, float(held[axis][begun]), _HALF)
            stop_ns = round(max(stop.stop_s - earlier_s, stop.begin_s) * 1e9)
            row = int(np.searchsorted(time_ns, stop_ns, side="right"))
            if not row:
                continue
            time_ns = np.insert(time_ns, row, stop_ns)
            held = {name: np.insert(value, row, value[row - 1]) for name, value in held.items()}
            held[axis][row:][time_ns[row:] < round(stop.end_s * 1e9) - _ROUNDING_NS] = 0.0
    commands = CommandColumns(
        time_ns=time_ns,
        speed_m_s=held["speed"],
        lateral_speed_m_s=np.zeros(len(time_ns)),
        turn_rate_rad_s=held["turn_rate"],
    )
    return commands if _counts_commands(scenario) else _drop_repeated(commands)


def find_known(run: Run, scenario: Scenario) -> int:
    """Return from when on the rates follow from recorded commands [ns].

    A robot that stands until its first command is known from the beginning.
    """
    poses, first_ns = run.poses, int(run.commands.time_ns[0])
    earlier = poses.time_ns <= first_ns
    seen_s = (poses.time_ns[earlier][-1] - poses.time_ns[0]) / 1e9 if earlier.any() else 0.0
    if seen_s >= _LOOK_S and all(_stands(run, axis, earlier, seen_s) for axis in AXES):
        return int(poses.time_ns[0])
    delays_s = [
        _find_delay(scenario, axis, float(np.abs(get_commands(run, axis)).max()), _FADED)
        for axis in AXES
    ]
    return first_ns + round(max(delays_s) * 1e9)


def silence(scenario: Scenario) -> Scenario:
    """Return a scenario without its random effects."""
    tables: dict[str, dict[str, float]] = {}
    for key in sorted(RANDOM_KEYS):
        table, _, name = key.partition(".")
        tables.setdefault(table, {})[name] = 0.0
    changes: dict[str, Any] = {
        table: replace(getattr(scenario, table), **names) for table, names in tables.items()
    }
    return replace(scenario, **changes)


def is_random(scenario: Scenario) -> bool:
    """Return whether what is sensed of a driven robot differs by the seed of its scenario.

    Sensed poses are never lost or late there.
    """
    return bool(list_streams(scenario) - {"dropout_lose_pose", "jitter_pose_travel"})


def _counts_commands(scenario: Scenario) -> bool:
    """Return whether a command that repeats the one before may act: by chance, or in a queue."""
    loop = scenario.loop
    return loop.queue_policy != "newest" or loop != silence(scenario).loop


def _drop_repeated(commands: CommandColumns) -> CommandColumns:
    """Return commands without those that repeat the one before, which only take time."""
    changes = np.diff(commands.speed_m_s) != 0.0
    changes |= np.diff(commands.turn_rate_rad_s) != 0.0
    return take_rows(commands, np.concatenate([[True], changes]))


def _find_delay(scenario: Scenario, axis: Axis, command: float, left: float) -> float:
    """Return after what time a share of the rate that a command led to is left [s]."""
    values, loop = flatten_scenario(scenario), scenario.loop
    key = PLANT_KEYS[axis]
    transport_s: float = loop.transport_delay_s
    transport_s += loop.transport_delay_ticks * scenario.plant.facts.period_s
    lag_s = read_number(values, f"{key}lag_s")
    acceleration = read_number(values, f"{key}acceleration", math.inf)
    gains = [read_number(values, f"{key}{name}gain") for name in ("", "reverse_")]
    rate = max(map(abs, gains)) * abs(command)
    rate = min(rate, read_number(values, f"{key}bound", math.inf))
    fading_s, end = 0.0, left * rate
    if acceleration < math.inf:
        bend = min(max(acceleration * lag_s, end), rate)
        fading_s, rate = (rate - bend) / acceleration, bend
    if rate > end:
        fading_s += lag_s * math.log(rate / end)
    return transport_s + read_number(values, f"{key}dead_time_s") + fading_s


def _stands(run: Run, axis: Axis, earlier: NDArray[np.bool_], seen_s: float) -> bool:
    """Return whether a robot stands meanwhile, or an axis is never commanded."""
    largest = float(np.abs(get_commands(run, axis)).max())
    poses = run.poses
    if axis == "speed":
        moved = float(np.hypot(*(poses.xy_m[earlier][-1] - poses.xy_m[0])))
    else:
        moved = abs(float(subtract_headings(poses.heading_rad[earlier][-1], poses.heading_rad[0])))
    return not largest or moved <= _STANDING * largest * seen_s
