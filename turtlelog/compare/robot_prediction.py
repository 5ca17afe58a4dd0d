"""Comparison of a recorded robot with a simulated one that repeats its commands from many anchors.

The simulation includes the plant, disturbance and sensing of a scenario. The rates of the robot
follow from the commands and do not depend on the pose. Therefore one simulation from the first
command on is enough: moved to the recorded pose at an anchor, it equals a simulation that begins
there with all earlier commands.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from turtlelog.compare import driven_commands
from turtlelog.compare.driven_commands import Rows, Values
from turtlelog.compare.robot_comparison import (
    SEEDS,
    SHORTEST_S,
    ErrorBand,
    ErrorGrowth,
    NoiseLevel,
    Quantity,
    RobotComparison,
    compare_noise,
)
from turtlelog.display import describe_count
from turtlelog.errors import CompareError
from turtlelog.identify.axis_motion import (
    AXES,
    NAMES,
    Axis,
    AxisMotion,
    AxisTraces,
    join_rates,
    measure_axis_steps,
    read_axis_motion,
)
from turtlelog.replay.plant_replay import sense_driven
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.columns import take_rows
from turtlelog.scenario import Scenario

HORIZONS_S: Final = (1.0, 5.0)
"""Times for which a motion is predicted before the next anchor [s]."""

LONGEST_S: Final = 600.0
"""Longest simulated part of a run [s]: 120 pieces of 5 s."""

MOST_TICKS: Final = 30_000
"""Largest number of simulated plant periods: 600 s at 50 Hz, for which 39 seeds take 20 s."""

_FIRST_SEED: Final = 2**32
"""First seed: a recording simulated with a seed of its own differs from all other seeds."""

_MOST_NAMED: Final = 5
"""Largest number of jumps and stops that are named one by one."""

_MOVED: Final = 1e-9
"""Smallest motion between two poses of a moving robot [m] or [rad]; rounding alone moves a robot as
far."""

_QUANTITIES: Final[tuple[Quantity, Quantity]] = ("position", "heading")

_CENTRAL: Final = (0.025, 0.5, 0.975)


def compare_robot(
    run: Run, scenario: Scenario, horizons_s: Sequence[float] = HORIZONS_S
) -> RobotComparison:
    """Return the deviation of a simulated robot from a recorded one, driven by the same commands.

    After each horizon, the simulation is moved to the recorded pose; all earlier commands still
    act. If the scenario has noise, the simulation is repeated over seeds: the noise is right if
    recorded and simulated errors have the same distribution. Use a run to which the scenario was
    not fitted. Sensed poses are used if they are recorded.

    Args:
        run: Run with commands; poses may be irregular or missing.
        scenario: Scenario with the plant `lagged`; its law, goal, start and limits are not used.
        horizons_s: Times after which the simulation is anchored again [s].

    Raises:
        CompareError: If the scenario has another plant, or nothing can be predicted.
        SimulationError: If the simulated robot diverges.
    """
    _require_sense(run, scenario, horizons_s)
    zero_ns = run.start_ns
    run, notes = _take_part(run, scenario)
    motions = {axis: read_axis_motion(run, axis) for axis in AXES}
    recorded, commands = run.poses, driven_commands.list_commands(run, motions, scenario)
    start_ns = min(int(recorded.time_ns[0]), int(commands.time_ns[0]))
    commands = replace(commands, time_ns=commands.time_ns - start_ns)
    times_ns = recorded.time_ns - start_ns
    states = sense_driven(driven_commands.silence(scenario), commands, times_ns)
    simulated = replace(recorded, xy_m=states[:, :2], heading_rad=states[:, 2])
    known_ns = driven_commands.find_known(run, scenario)
    jumps = driven_commands.find_impossible_steps(run, simulated, scenario)
    cuts = {}
    for horizon_s in horizons_s:
        cut, gaps = driven_commands.cut_pieces(recorded.time_ns, round(horizon_s * 1e9), known_ns)
        sound, lost = driven_commands.drop_jumps(cut, jumps)
        notes += _tell_lost(horizon_s, gaps, lost)
        if sound.shape[1]:
            cuts[horizon_s] = sound
        else:
            notes.append(f"No piece of {horizon_s:g} s is left to predict.")
    if not cuts:
        raise CompareError(_tell_too_short(run, horizons_s, known_ns, len(jumps)))
    longest = cuts[max(cuts)]
    short_s = max(SHORTEST_S, float(np.median(np.diff(recorded.time_ns))) / 1e9)
    short, _ = driven_commands.drop_jumps(
        driven_commands.cut_pieces(recorded.time_ns, round(short_s * 1e9), known_ns)[0], jumps
    )
    grown = driven_commands.list_growth_rows(recorded.time_ns, longest, max(cuts))
    rows = np.unique(
        np.concatenate([grown.ravel(), short.ravel(), *(cut.ravel() for cut in cuts.values())])
    )
    worlds = np.array(
        [
            sense_driven(replace(scenario, seed=_FIRST_SEED + seed), commands, times_ns[rows])
            for seed in range(SEEDS if driven_commands.is_random(scenario) else 0)
        ]
    )
    stack = _Stack(recorded, states, rows, worlds)
    return RobotComparison(
        name=run.name,
        scenario=scenario.name,
        seeds=len(worlds),
        clock=run.clock,
        bands=tuple(
            band
            for horizon_s, cut in cuts.items()
            for band in stack.measure_bands(horizon_s, cut, zero_ns)
        ),
        noise=stack.compare_noise(short_s, short, cuts[min(cuts)]),
        growth=stack.measure_growth(grown),
        recorded=recorded,
        simulated=simulated,
        begins=longest[0],
        ends=longest[1],
        traces=tuple(_trace(axis, motions[axis], recorded, simulated) for axis in AXES),
        start_s=zero_ns / 1e9,
        notes=(
            *notes,
            *_tell_start(run, zero_ns, known_ns),
            *_tell_jumps(run, zero_ns, jumps),
            *_tell_motion(run, motions),
        ),
    )


class _Stack:
    """The recorded states, the states without noise, and the states of each seed at given rows."""

    def __init__(
        self, recorded: PoseColumns, predicted: Values, rows: Rows, worlds: Values
    ) -> None:
        self._time_ns, self._rows, self._worlds = recorded.time_ns, rows, worlds
        self._recorded = driven_commands.stack_states(recorded)
        self._predicted = predicted

    def _measure(self, cut: Rows) -> tuple[Values, Values | None]:
        """Return the recorded errors, shape (2, n), and those of each seed, shape (seeds, 2, n)."""
        recorded = driven_commands.measure_errors(self._recorded[cut], self._predicted[cut])
        if not len(self._worlds):
            return recorded, None
        found = self._worlds[:, np.searchsorted(self._rows, cut)]
        return recorded, np.array(
            [driven_commands.measure_errors(one, self._predicted[cut]) for one in found]
        )

    def measure_bands(self, horizon_s: float, cut: Rows, start_ns: int) -> list[ErrorBand]:
        """Return the errors of position and heading at the ends of pieces."""
        recorded, simulated = self._measure(cut)
        time_s = (self._time_ns[cut[1]] - start_ns) / 1e9
        bands = []
        for number, quantity in enumerate(_QUANTITIES):
            band = ErrorBand(
                quantity=quantity, horizon_s=horizon_s, time_s=time_s, recorded=recorded[number]
            )
            if simulated is not None and simulated[:, number].any():
                errors = simulated[:, number]
                band = replace(
                    band,
                    simulated=np.median(errors, axis=0),
                    low=errors.min(axis=0),
                    high=errors.max(axis=0),
                )
            bands.append(band)
        return bands

    def compare_noise(self, after_s: float, short: Rows, long: Rows) -> tuple[NoiseLevel, ...]:
        """Return the noise of position and heading, from pieces in which the robot moves."""
        found = []
        for cut in (short, long):
            moved = np.abs(self._predicted[cut[1]] - self._predicted[cut[0]]).max(axis=1) > _MOVED
            found.append(self._measure(cut[:, moved]))
        (recorded, simulated), (later, simulated_later) = found
        if simulated is None or simulated_later is None:
            return ()
        levels = (
            compare_noise(
                quantity,
                after_s,
                (recorded[number], simulated[:, number]),
                (later[number], simulated_later[:, number]),
            )
            for number, quantity in enumerate(_QUANTITIES)
        )
        return tuple(level for level in levels if level is not None)

    def measure_growth(self, grown: Rows) -> tuple[ErrorGrowth, ErrorGrowth]:
        """Return the growth of errors from the first row of each piece, shape (pieces, points)."""
        begins = np.broadcast_to(grown[:, :1], grown.shape)
        since_s = (self._time_ns[grown] - self._time_ns[begins]).mean(axis=0) / 1e9
        recorded, simulated = self._measure(np.array([begins.ravel(), grown.ravel()]))

        def spread(errors: Values) -> Values:
            by_point = errors.reshape(-1, grown.shape[1])
            return np.asarray(np.quantile(by_point, _CENTRAL, axis=0).T)

        position, heading = (
            ErrorGrowth(
                quantity=quantity,
                since_s=since_s,
                recorded=spread(recorded[number]),
                simulated=None
                if simulated is None or not simulated[:, number].any()
                else spread(simulated[:, number]),
            )
            for number, quantity in enumerate(_QUANTITIES)
        )
        return position, heading


def _require_sense(run: Run, scenario: Scenario, horizons_s: Sequence[float]) -> None:
    if scenario.plant.kind != "lagged":
        raise CompareError(
            f'{scenario.name}: expected a scenario of a robot, with plant.kind = "lagged", found'
            f" {scenario.plant.kind}"
        )
    if not horizons_s or not all(math.isfinite(one) and one > 0.0 for one in horizons_s):
        raise CompareError(
            f"horizons_s: expected times above 0 s, found {[*map(float, horizons_s)]}"
        )
    if not len(run.commands):
        raise CompareError(f"{run.name}: no commands to drive the simulated robot with")


def _take_part(run: Run, scenario: Scenario) -> tuple[Run, list[str]]:
    """Return the comparable part of a run with sensed poses, and the time segments left out."""
    poses, notes = run.poses, []
    longest_s = min(LONGEST_S, MOST_TICKS * scenario.plant.facts.period_s)
    until_ns = poses.time_ns[0] + round(longest_s * 1e9)
    kept = ~poses.dropped_out & (poses.time_ns <= until_ns)
    if not kept.any():
        raise CompareError(f"{run.name}: no poses that were sensed")
    if poses.time_ns[-1] > until_ns:
        whole_s = (poses.time_ns[-1] - poses.time_ns[0]) / 1e9
        notes = [f"The first {longest_s:g} s of {whole_s:.0f} s are compared."]
    sensed = PoseColumns(
        time_ns=poses.time_ns[kept],
        xy_m=poses.read_xy_m[kept],
        heading_rad=poses.read_heading_rad[kept],
    )
    none = take_rows(run.samples, slice(0, 0))
    return replace(run, poses=sensed, samples=none), notes


def _trace(
    axis: Axis, motion: AxisMotion, recorded: PoseColumns, simulated: PoseColumns
) -> AxisTraces:
    time_s, measured, _ = measure_axis_steps(recorded, axis)
    _, modelled, _ = measure_axis_steps(simulated, axis)
    return join_rates(axis, motion, time_s, measured, modelled)


def _tell_lost(horizon_s: float, gaps: int, jumped: int) -> list[str]:
    told = []
    if gaps:
        many = describe_count(gaps, "gap")
        told.append(f"After {horizon_s:g} s: {many} of the poses, over which nothing is predicted.")
    if jumped:
        many = describe_count(jumped, "outlier")
        told.append(f"After {horizon_s:g} s: {many}, as the poses jump meanwhile; not counted.")
    return told


def _tell_too_short(run: Run, horizons_s: Sequence[float], known_ns: int, jumps: int) -> str:
    left_s = max((int(run.poses.time_ns[-1]) - known_ns) / 1e9, 0.0)
    extra = f" with {describe_count(jumps, 'jump')}" if jumps else ""
    return (
        f"{run.name}: expected at least {min(horizons_s):g} s of poses to predict, without gaps and"
        f" jumps, after the robot's rates are known, found {left_s:.3g} s{extra}"
    )


def _tell_start(run: Run, start_ns: int, known_ns: int) -> list[str]:
    first_ns = int(run.poses.time_ns[0])
    if known_ns <= first_ns:
        return []
    return [
        f"Predictions begin at {(known_ns - start_ns) / 1e9:.3g} s: what was commanded before the"
        " first recorded command is not known."
    ]


def _tell_jumps(run: Run, start_ns: int, jumps: Rows) -> list[str]:
    poses, told = run.poses, []
    for row in jumps[:_MOST_NAMED].tolist():
        moved_m = float(np.hypot(*(poses.xy_m[row] - poses.xy_m[row - 1])))
        turned_rad = float(subtract_headings(poses.heading_rad[row], poses.heading_rad[row - 1]))
        told.append(
            f"Jump: the pose at {(poses.time_ns[row] - start_ns) / 1e9:.3f} s lies {moved_m:.3g} m"
            f" and {np.degrees(turned_rad):.3g} deg from the one before."
        )
    more = len(jumps) - len(told)
    return [*told, f"And {describe_count(more, 'jump')} more."] if more else told


def _tell_motion(run: Run, motions: Mapping[Axis, AxisMotion]) -> list[str]:
    told = []
    for axis, motion in motions.items():
        if motion.stops:
            many = describe_count(len(motion.stops), "time")
            told.append(
                f"The {NAMES[axis]} stops by itself where no command comes, {many}; the simulated"
                " robot is stopped then."
            )
    aside = float(np.abs(run.commands.lateral_speed_m_s).max())
    if aside:
        told.append(f"Commands sideways, up to {aside:.3g} m/s, are left out: the plant has none.")
    return told
