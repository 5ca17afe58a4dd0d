"""Replay of the recorded commands through the plant, compared with the recorded poses."""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot, inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.plants import LAGGED, Turtle, find_plant
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.replay import differences
from turtlelog.replay.commanded_plant import drive_lagged
from turtlelog.replay.differences import Difference, Pairing, ReplayResult, SignalDifference
from turtlelog.replay.recorded_motion import (
    CommandUse,
    Gap,
    Jump,
    RecordedMotion,
    Velocity,
    find_breaks,
    place_commands,
    read_motion,
)
from turtlelog.run import Run, require_run

_HALF_STEP_M: Final = 2.0**-21
"""Half a 32-bit step of a coordinate between 8 and 16 m, the coarsest step in this world [m]."""

_HALF_STEP_RAD: Final = 2.0**-23
"""Half a 32-bit step of a heading between 2 and 4 rad [rad]."""

_HALF_SHARE: Final = 2.0**-24
"""Half a 32-bit step of a velocity, as a share of the velocity."""

_RIGHT: Final = 1e-9
"""Accuracy of a robot model's position [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseError:
    """Largest magnitudes of the differences between replayed and recorded poses."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantStretch:
    """A part of the recording without a jump or gap, replayed from its first recorded pose.

    Attributes:
        start_ns: Time of the first pose [ns].
        end_ns: Time of the last pose [ns].
        ticks: Number of replayed steps.
        max_abs_error: Largest difference of the poses.
        signals: x, y [m] and heading [rad], with the differences that rounding explains as their
            limits.
        rounding_m: Largest error from 32-bit rounding of the first pose, and of velocities used as
            commands, along the distance driven [m]. The plant's own state has double precision and
            is not recorded. For a robot model, whose start is known, the error is one 32-bit step
            at the largest coordinate.
        rounding_rad: The same for the heading [rad].
    """

    start_ns: int
    end_ns: int
    ticks: int
    max_abs_error: PoseError
    signals: tuple[SignalDifference, ...]
    rounding_m: float
    rounding_rad: float

    @property
    def first_difference(self) -> Difference | None:
        """First difference that rounding does not explain; None if rounding explains all."""
        return differences.find_earliest(found.first_difference for found in self.signals)

    @property
    def within_rounding(self) -> bool:
        """Whether rounding explains all differences."""
        return self.first_difference is None

    @property
    def of_rounding(self) -> float:
        """Largest difference, relative to the one that rounding explains [1]; inf for 0."""
        error = self.max_abs_error
        pairs = (
            (max(error.x_m, error.y_m), self.rounding_m),
            (error.heading_rad, self.rounding_rad),
        )
        return max((found / bound if bound else inf for found, bound in pairs if found), default=0)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PlantReplay(ReplayResult):
    """Motion of the plant under the recorded commands, compared with the recording.

    Attributes:
        name: Name of the run.
        samples: Number of compared poses.
        max_abs_error: Largest difference over all segments.
        first_difference: Earliest difference of all segments; None if rounding explains all
            differences.
        stretches: Segments in order of time.
        jumps: Jumps in order of time.
        gaps: Gaps in order of time.
        commands: Use of the recorded commands.
        heading_bits: Precision of turtlesim's heading: 64 bits, or 32 as before Humble if only 32
            reproduce the poses within rounding.
    """

    name: str
    samples: int
    max_abs_error: PoseError
    first_difference: Difference | None
    stretches: tuple[PlantStretch, ...]
    jumps: tuple[Jump, ...]
    gaps: tuple[Gap, ...]
    commands: CommandUse
    heading_bits: int = 64

    @property
    def within_rounding(self) -> bool:
        """Whether rounding explains all differences in each segment."""
        return self.first_difference is None

    @property
    def of_rounding(self) -> float:
        """Largest difference of all segments as a multiple of its bound [1]."""
        return max(stretch.of_rounding for stretch in self.stretches)

    @property
    def signals(self) -> tuple[SignalDifference, ...]:
        """x, y and heading, segment by segment."""
        return tuple(found for stretch in self.stretches for found in stretch.signals)

    @property
    def others(self) -> tuple[Difference, ...]:
        """Differences that belong to no signal: always empty."""
        return ()


def replay_plant(run: Run) -> PlantReplay:
    """Drive the plant with the commands of a recording and compare the poses.

    For turtlesim, the applied velocities in the poses show in which tick each command was taken.
    After each jump or gap, the plant starts again from the recorded pose. A robot model is driven
    from its start to the end; its scenario determines when a command arrives.

    Raises:
        ReplayError: If the run has no applied velocities, or its poses are not ticks; for a robot
            model, if the run does not contain its whole scenario, start and commands.
    """
    require_run(run)
    if find_plant(run).name == LAGGED:
        return _replay_lagged(run)
    motion = read_motion(run)
    jumps, gaps, starts = find_breaks(motion)
    velocities, use = place_commands(motion, run, frozenset(starts))
    bounds = [*map(slice, [0, *starts], [*starts, len(motion.time_ns)])]

    def drive(*, keeps_32_bits: bool) -> tuple[PlantStretch, ...]:
        ticks = use.unexplained_ticks
        return tuple(
            _replay_stretch(
                motion, velocities, rows, rounded_ticks=ticks, keeps_32_bits=keeps_32_bits
            )
            for rows in bounds
        )

    stretches, heading_bits = drive(keeps_32_bits=False), 64
    first = differences.find_earliest(stretch.first_difference for stretch in stretches)
    if first is not None:
        old = drive(keeps_32_bits=True)
        if all(stretch.within_rounding for stretch in old):
            stretches, heading_bits, first = old, 32, None
    return PlantReplay(
        name=run.name,
        samples=len(motion.time_ns),
        max_abs_error=_find_largest(stretch.max_abs_error for stretch in stretches),
        first_difference=first,
        stretches=stretches,
        jumps=jumps,
        gaps=gaps,
        commands=use,
        heading_bits=heading_bits,
    )


def _replay_stretch(
    motion: RecordedMotion,
    velocities: tuple[Velocity, ...],
    rows: slice,
    *,
    rounded_ticks: int,
    keeps_32_bits: bool,
) -> PlantStretch:
    """Replay a segment. In some ticks the recorded velocity replaces a command."""
    first, after = rows.start, rows.stop
    x_m, y_m = motion.xy_m[first].tolist()
    turtle = Turtle(
        x_m=x_m,
        y_m=y_m,
        heading_rad=float(motion.heading_rad[first]),
        keeps_32_bits=keeps_32_bits,
    )
    states = array("d", turtle.state[:3])
    driven_m = 0.0
    for forward, left, turn_rate in velocities[first + 1 : after]:
        # Taken anew in every tick: when the plant's own watchdog fires depends on the wall clock,
        # and the recorded velocities tell it.
        turtle.take_command(forward, turn_rate, left)
        turtle.step()
        states.extend(turtle.state[:3])
        driven_m += hypot(forward, left) * TICK_S
    # A recorded velocity is off by half a 32-bit step, which adds up over the ticks that use it.
    ticks = min(rounded_ticks, after - first - 1)
    within = motion.speed_m_s[first:after], np.abs(motion.turn_rate_rad_s[first:after])
    off_m, off_rad = (_HALF_SHARE * TICK_S * ticks * float(values.max()) for values in within)
    # A heading of 32 bits is published whole, and nothing of it is lost.
    lost_rad = 0.0 if keeps_32_bits and not ticks else 2.0 * _HALF_STEP_RAD
    rounding_rad = lost_rad + off_rad
    start_rad = max(rounding_rad - _HALF_STEP_RAD, 0.0)
    return _compare_stretch(
        motion.time_ns[first:after],
        recorded=np.column_stack([motion.xy_m, motion.heading_rad])[first:after],
        states=np.frombuffer(states).reshape(-1, 3),
        rounding_m=3.0 * _HALF_STEP_M + off_m + driven_m * start_rad,
        rounding_rad=rounding_rad,
    )


def _replay_lagged(run: Run) -> PlantReplay:
    found, poses = drive_lagged(run), run.poses
    farthest_m = float(np.abs(poses.xy_m).max())
    stretch = _compare_stretch(
        poses.time_ns,
        recorded=np.column_stack([poses.xy_m, poses.heading_rad]),
        states=found.states,
        rounding_m=max(float(np.spacing(np.float32(farthest_m))), _RIGHT),
        rounding_rad=2.0 * _HALF_STEP_RAD,
    )
    return PlantReplay(
        name=run.name,
        samples=len(poses),
        max_abs_error=stretch.max_abs_error,
        first_difference=stretch.first_difference,
        stretches=(stretch,),
        jumps=(),
        gaps=found.gaps,
        commands=found.commands,
    )


def _compare_stretch(
    time_ns: NDArray[np.int64],
    *,
    recorded: NDArray[np.float64],
    states: NDArray[np.float64],
    rounding_m: float,
    rounding_rad: float,
) -> PlantStretch:
    replayed = _round_alike(states, recorded)
    pairs = [*zip(recorded.T, replayed.T, strict=True)]
    places = (Pairing(name, "m", time_ns, *pairs[axis]) for axis, name in enumerate("xy"))
    turn = Pairing("heading", "rad", time_ns, *pairs[2], kind="angle")
    signals = (
        *(differences.compare_pairing(place, tolerance=rounding_m) for place in places),
        differences.compare_pairing(turn, tolerance=rounding_rad),
    )
    return PlantStretch(
        start_ns=int(time_ns[0]),
        end_ns=int(time_ns[-1]),
        ticks=len(time_ns) - 1,
        max_abs_error=find_pose_error(signals),
        signals=signals,
        rounding_m=rounding_m,
        rounding_rad=rounding_rad,
    )


def find_pose_error(signals: Iterable[SignalDifference]) -> PoseError:
    """Return the largest differences of x, y and heading."""
    largest = {found.signal: found.largest for found in signals}
    return PoseError(x_m=largest["x"], y_m=largest["y"], heading_rad=largest["heading"])


def _round_alike(
    replayed: NDArray[np.float64], recorded: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return poses rounded as published. Poses of a recording in double precision do not change."""
    published = replayed.astype(np.float32).astype(np.float64)
    return published if (recorded == recorded.astype(np.float32)).all() else replayed


def _find_largest(errors: Iterable[PoseError]) -> PoseError:
    found = [*errors]
    return PoseError(
        x_m=max(error.x_m for error in found),
        y_m=max(error.y_m for error in found),
        heading_rad=max(error.heading_rad for error in found),
    )
