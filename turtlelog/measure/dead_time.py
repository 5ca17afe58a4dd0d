"""The dead time of a loop in a log, and a run's loops as models of theory."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import MeasureError, suggest_names
from turtlelog.measure.metric import Missing, Status
from turtlelog.measure.motion import (
    CERTAIN,
    COARSE,
    WHITE,
    LoopMotion,
    describe_follower,
    find_lags,
    fit_way,
    is_within_steps,
    measure_whiteness,
    read_loop_motion,
)
from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours
from turtlelog.measure.response import describe_no_phase, find_loop_samples
from turtlelog.plants import PLANTS, find_plant, read_plant
from turtlelog.run import Parameter, Run
from turtlelog.run.loops import ControlLoop, read_number

if TYPE_CHECKING:
    from turtlelog.theory import LoopModel, MeasuredTiming, PidGains

LARGEST_TICKS: Final = 40
"""Largest dead time that is searched [ticks]."""

_CANDIDATES: Final = range(LARGEST_TICKS + 1)

_BEGUN: Final = 0.1
"""Share of the motion after which a loop's first commands, which may be lost, no longer matter."""

_EXPLAINED: Final = 0.05
"""Residual as a share of the motion above which nothing is explained."""

_KNOWN: Final = 0.5
"""Smallest share of steps with known commands if a dead time explains these steps exactly."""

_SCREENED: Final = 64
"""Number of steps, over the whole segment, that rule out most dead times with a tenth of the
work."""

_FEW: Final = 8
"""Largest number of dead times that are tested one by one; more dead times are tested together."""

_TELLING_STEPS: Final = 3
"""Number of steps that every other dead time must fail to explain where the dead time changes.
During a constant command, all dead times explain all steps except one or two at its beginning."""

_FEWEST_STEPS: Final = 12
"""Smallest number of steps of a segment with another dead time."""


@dataclass(frozen=True, slots=True)
class LagInstead(Missing):
    """Reason why a dead time is missing: a time constant explains the motion better."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadTimeChange:
    """A change of the dead time within a loop's segment.

    Attributes:
        time_ns: Time of the first pose with the later dead time [ns].
        before: Dead time before [ticks].
        after: Dead time after [ticks].
    """

    time_ns: int
    before: int
    after: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadTime:
    """Dead time of a loop: delay from the pose that was read to the motion caused by its command.

    Attributes:
        ticks: d: the command that answers pose i first moves the plant in the step from pose i + d
            to pose i + d + 1; 0 is the minimum. Value at the end of the segment.
        residual: Root mean square of the motion that the commands do not explain [rad for a turn
            rate, m for a speed]. For an exact fit it refers to single steps; with noise, to the
            cumulated motion.
        margin: Ratio of the residuals of the second-best and the best dead time.
        rows: Steps compared.
        is_exact: Whether the dead time explains every step to the rounding of the poses.
        changes: Changes of the dead time within the segment, in order.
        whiteness: Mean square of the changes of the residuals divided by twice their mean square: 1
            for noise, near 0 for a curve. The value is also 1 if every step is explained, or if
            only rounding remains.
        least_ticks: Smallest dead time that explains the motion as well, together with a time
            constant. Noise hides which of the two is right. The value is `ticks` if the plant is
            known to have no time constant.
    """

    ticks: int
    residual: float
    margin: float
    rows: int
    is_exact: bool
    changes: tuple[DeadTimeChange, ...] = ()
    whiteness: float = 1.0
    least_ticks: int | None = None

    @property
    def lag_slack(self) -> int:
        """Number of ticks of the dead time that may be a time constant instead."""
        return 0 if self.least_ticks is None else self.ticks - self.least_ticks


def find_dead_time(
    run: Run, loop: ControlLoop | str, *, is_short: bool = False
) -> DeadTime | Missing:
    """Return the dead time of a loop's command, or the reason why the log does not show it.

    Every dead time up to `LARGEST_TICKS` predicts the motion of each step between two poses.
    Without noise, one dead time agrees to the rounding of the poses. With noise, the dead time with
    the least squared error of the cumulated motion is returned, if it is clearly better than the
    others and what it leaves is noise. The standstill before a loop's first command acts is not
    evidence, because commands may be lost. A robot with a time constant gets no dead time here,
    because dead time and time constant look alike. A robot model with time constant 0 gets one if a
    whole number of its periods explains every step. Disturbances in the scenario are known. Random
    disturbances add up along the motion; then only a dead time that explains every step counts.

    Args:
        run: Run with samples.
        loop: Loop of the run's law, or the name of a loop.
        is_short: Whether to stop as soon as exactly one dead time explains every step. Then
            `residual` and `margin` are NaN, and the search is ten times faster.

    Raises:
        MeasureError: If the law declares no loop with that name.
    """
    if not len(run.samples):
        return Missing(Status.ABSENT, "no samples of a controller were read")
    if isinstance(loop, str):
        known = {one.name: one for one in run.declaration.loops}
        if loop not in known:
            raise MeasureError(f"loop {loop!r}: expected {suggest_names(loop, [*known])}")
        loop = known[loop]
    motion = read_loop_motion(run, loop)
    if motion is None:
        return Missing(Status.NO_PHASE, describe_no_phase(run, loop))
    follower = describe_follower(run, loop)
    if follower:
        return Missing(Status.UNDETERMINED, f"it cannot be separated from {follower}")
    moves = np.abs(motion.moved) > motion.rounding
    if np.count_nonzero(moves) < 2:
        return Missing(Status.TOO_SHORT, f"nothing moves in {loop.name}")
    # In a step of several ticks, the robot may have moved during some of them only.
    first = int(moves.argmax()) + (motion.step_ticks > 1)
    may_lag = not run.scenario_is_complete
    found = (_find_only(motion, first) if is_short else None) or _choose(
        motion, first, may_lag=may_lag
    )
    if isinstance(found, Missing) or found.is_exact:
        return found
    reason = _find_doubt(run, loop) or _find_pattern(found)
    return Missing(Status.UNDETERMINED, reason) if reason else found


def _find_doubt(run: Run, loop: ControlLoop) -> str:
    """Return the scenario's objection to a dead time that does not explain every step, or ""."""
    if read_number(run.parameters, f"disturbance.noise_{loop.command}", 0.0) > 0.0:
        return "the disturbance is random and adds up along the way"
    if not find_plant(run).has_live_logs:
        return f"no whole number of periods up to {LARGEST_TICKS} explains every step"
    return ""


def _find_pattern(found: DeadTime) -> str:
    """Return why what a dead time leaves is not noise, or ""."""
    if abs(found.whiteness - 1.0) < WHITE:
        return ""
    is_slow = found.whiteness < 1.0
    why = "commands were lost, or their delay changed" if is_slow else "its error alternates"
    return f"no single dead time explains the motion ({found.ticks} ticks come nearest): {why}"


def _find_only(motion: LoopMotion, first: int) -> DeadTime | None:
    """Return the only dead time that explains every step; None if there are none or several."""
    # A few steps rule out most dead times; the remaining ones are tested on all steps.
    count = len(motion.moved) - first
    some = slice(first, None, max(count // _SCREENED, 1))
    left = np.flatnonzero(_find_fits(motion, _CANDIDATES, some)[0].all(axis=1))
    if not 0 < len(left) <= _FEW or count < 1:
        return None
    exact = []
    for ticks in left.tolist():
        fits, sure = _find_fits(motion, range(ticks, ticks + 1), slice(first, None))
        if fits.all() and sure.mean() >= _KNOWN:
            exact.append(ticks)
    if len(exact) != 1:
        return None
    nan = float("nan")
    return DeadTime(ticks=exact[0], residual=nan, margin=nan, rows=count, is_exact=True)


def _find_fits(
    motion: LoopMotion, ticks: range, rows: slice
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where dead times explain steps or the answer is unknown, and where it is certain."""
    predicted, sure = motion.predict(ticks, rows)
    errors = np.abs(motion.moved[rows] - predicted)
    return (errors <= motion.rounding[rows]) | ~sure, sure


def _choose(motion: LoopMotion, first: int, *, may_lag: bool) -> DeadTime | Missing:
    """Judge every dead time by all steps; `first` is the first step that moves."""
    predicted, sure = motion.predict(_CANDIDATES)
    errors = motion.moved - predicted
    fits = (np.abs(errors) <= motion.rounding) | ~sure
    fits[:, :first] = True
    # A dead time with unknown commands for most steps would fit any motion.
    fits &= sure[:, first:].mean(axis=1, keepdims=True) >= _KNOWN
    exact = np.flatnonzero(fits.all(axis=1))
    if len(exact) > 1:
        alike = f"dead times of {_list_ticks(exact)} ticks fit alike"
        return Missing(Status.UNDETERMINED, f"the commands hardly change: {alike}")
    stretches = [(0, int(exact[0]))] if len(exact) else _split_exactly(fits)
    if stretches:
        return _describe_exact(motion, errors, stretches, first)
    return _fit_least_squares(motion, errors, may_lag=may_lag)


def _list_ticks(ticks: NDArray[np.int64]) -> str:
    if len(ticks) == ticks[-1] - ticks[0] + 1:
        return f"{ticks[0]} to {ticks[-1]}"
    return ", ".join(map(str, ticks))


def _describe_exact(
    motion: LoopMotion, errors: Values, stretches: list[tuple[int, int]], first: int
) -> DeadTime:
    began, ticks = stretches[-1]
    size: Values = np.sqrt(np.mean(errors[:, max(began, first) :] ** 2, axis=1))
    return DeadTime(
        ticks=ticks,
        residual=float(size[ticks]),
        margin=_compute_margin(size, ticks),
        rows=errors.shape[1] - first,
        is_exact=True,
        changes=tuple(
            DeadTimeChange(time_ns=int(motion.time_ns[row]), before=before, after=after)
            for (_, before), (row, after) in pairwise(stretches)
        ),
    )


def _split_exactly(fits: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first row and dead time of each segment; empty if steps remain unexplained."""
    # The search runs backward from the end: it finds the dead time that explains the most last
    # steps, then repeats this for the steps before them.
    stretches: list[tuple[int, int]] = []
    end = fits.shape[1]
    while end > 0:
        backward = fits[:, :end][:, ::-1]
        lengths = np.where(backward.all(axis=1), end, (~backward).argmax(axis=1))
        best = np.flatnonzero(lengths == lengths.max())
        if lengths.max() < min(_FEWEST_STEPS, end):
            return []
        others = np.delete(fits[:, end - int(lengths.max()) : end], best, axis=0)
        if not stretches and (~others).sum(axis=1).min(initial=_FEWEST_STEPS) < _TELLING_STEPS:
            return []
        # If several dead times fit equally, the one nearest to the neighbouring segment's is taken.
        near = stretches[0][1] if stretches else int(best[0])
        end -= int(lengths.max())
        stretches.insert(0, (end, int(best[np.abs(best - near).argmin()])))
    return stretches


def _fit_least_squares(motion: LoopMotion, errors: Values, *, may_lag: bool) -> DeadTime | Missing:
    """Fit the cumulated motion, not single steps, because the noise of poses does not add up."""
    way = np.cumsum(motion.moved)
    span = float(np.ptp(way))
    rows = np.flatnonzero(np.arange(len(way)) >= (np.abs(way) > _BEGUN * span).argmax())
    rows = rows[~_find_after_gaps(motion)[rows]]
    if not len(rows):
        reason = f"gaps of the poses come no more than {LARGEST_TICKS} ticks after each other"
        return Missing(Status.UNDETERMINED, reason)
    left, size = fit_way(motion, errors, rows)
    best, second = np.argsort(size, kind="stable")[:2].tolist()
    alike = np.flatnonzero(is_within_steps(np.ptp(left, axis=1), best, motion.grain))
    margin = _compute_margin(size, best)
    if size[best] > _EXPLAINED * span:
        reason = f"no dead time up to {LARGEST_TICKS} ticks explains the motion"
        return Missing(Status.UNDETERMINED, reason)
    least_ticks, is_better = best, False
    if may_lag:
        least_ticks, is_better = find_lags(motion, errors, rows, best, float(size[best]))
    if is_better:
        better = "with a lag a shorter dead time explains the motion better than"
        return LagInstead(Status.UNDETERMINED, f"{better} {best} ticks without a lag")
    if len(rows) * np.log(margin) < CERTAIN:
        return Missing(Status.UNDETERMINED, f"dead times of {best} and {second} ticks fit alike")
    if len(alike) > 1:
        listed = _list_ticks(alike)
        reason = f"the poses have coarse steps: dead times of {listed} ticks fit alike"
        return Missing(Status.UNDETERMINED, reason)
    # Rounding to coarse steps is a pattern, not noise: it may be slow, and it may alternate.
    is_rounding = size[best] <= motion.rounding.max()
    is_rounding |= float(np.ptp(left[best])) <= COARSE * motion.grain
    return DeadTime(
        ticks=best,
        residual=float(size[best]),
        margin=margin,
        rows=len(rows),
        is_exact=False,
        whiteness=1.0 if is_rounding else float(measure_whiteness(left[best])),
        least_ticks=least_ticks,
    )


def _find_after_gaps(motion: LoopMotion) -> NDArray[np.bool_]:
    """Return which steps follow a gap so closely that lost commands may still act."""
    tick = motion.tick
    gaps = np.flatnonzero(subtract_neighbours(tick) > motion.step_ticks) + 1
    since = np.full(len(tick), LARGEST_TICKS)
    for first, after in pairwise([*gaps.tolist(), len(tick)]):
        since[first:after] = tick[first:after] - tick[first]
    return since < LARGEST_TICKS


def _compute_margin(size: Values, best: int) -> float:
    second = float(np.delete(size, best).min())
    return second / float(size[best]) if size[best] > 0.0 else float("inf")


def model_run_loops(
    run: Run, *, identified: Mapping[str, Parameter] | None = None, place: str = "the recording"
) -> "tuple[LoopModel, ...]":
    """Return the loops of a run as `theory` models them, one per declared loop.

    Gains and plant come from the scenario, period and dead time from the samples and poses. A time
    constant looks like dead time. Therefore the timing comes from the scenario for a robot with a
    time constant, or a law triggered by a timer. It also does if it cannot be measured, but the
    scenario determines it.

    Args:
        run: Any run.
        identified: Identified parameters for keys that the run lacks.
        place: What the timing is measured in, in words.
    """
    parameters = {**(identified or {}), **run.parameters}
    return tuple(_model(run, loop, parameters, place) for loop in run.declaration.loops)


def _model(
    run: Run, loop: ControlLoop, parameters: Mapping[str, Parameter], place: str
) -> "LoopModel":
    from turtlelog.theory import model_loop  # it loads the laws

    sources = {}
    if loop.gain not in run.parameters:
        sources["gains"] = "identified from the commands"
    if "loop.period_ticks" not in run.parameters and "plant.kind" not in parameters:
        sources["plant"] = "assumed, as the recording names no plant"
    plant = read_plant(parameters)
    is_plain = plant.dynamics == "integrator" and parameters.get("plant.kind", plant.name) in PLANTS
    is_plain = is_plain and parameters.get("loop.trigger", "pose") == "pose"
    timing = _measure_timing(run, loop, f"measured in {place}") if is_plain else None
    found = model_loop(loop, parameters, timing=timing, sources=sources)
    if isinstance(timing, str) and run.scenario_is_complete:
        planned = model_loop(loop, parameters, sources=sources)
        # Lost commands shorten a queue, so a loop that ran may differ from its scenario.
        if planned.most_dead_time_s is None or find_loop_samples(run, loop) is None:
            found = planned if planned.reason else replace(planned, unmeasured=timing)
    against = _contradict(run, loop, found.gains)
    return replace(found, gains=None, reason=against) if against else found


_FAR: Final = 0.05
"""Largest difference of a proportional command from gain times error, as a share of it. Commands
from poses of 32 bits are within 1e-3 of it; a gain off by 5 % changes no advice."""


def _contradict(run: Run, loop: ControlLoop, gains: "PidGains | None") -> str:
    """Return how most commands of a heading loop contradict its declared gain, or ""."""
    rows = find_loop_samples(run, loop)
    wanted, error = run.samples.wanted_turn_rate_rad_s, run.samples.heading_error_rad
    if gains is None or rows is None or not (loop.has_theory and loop.signal == "heading"):
        return ""
    if wanted is None or error is None or not _has_error(run, loop, rows, error):
        return ""
    ratios = wanted[rows] / np.where(error[rows] == 0.0, math.nan, gains.kp * error[rows])
    ratios = ratios[np.isfinite(ratios)]
    if not len(ratios) or np.mean(np.abs(ratios - 1.0) > _FAR) <= 0.5:
        return ""
    times = f"its recorded commands are {float(np.median(ratios)):.3g} times"
    return f"{times} {loop.gain} times the error (median), not 1 as the law declares"


def _has_error(run: Run, loop: ControlLoop, rows: slice, error_rad: Values) -> bool:
    """Return whether the recorded heading error is that of a loop: a law need not give its own."""
    if loop.reference == "goal_heading":
        wanted_rad = read_number(run.parameters, "goal.heading_rad", math.nan)
        turned_rad = wanted_rad - run.poses.heading_rad[run.samples.pose_sequence[rows.start]]
        return abs(math.remainder(turned_rad - error_rad[rows.start], math.tau)) < _FAR
    speed = run.samples.wanted_speed_m_s
    stands = speed is not None and not speed[rows].any()
    return loop.reference == "bearing_now" or (loop.reference == "goal_bearing" and stands)


def _measure_timing(run: Run, loop: ControlLoop, measured: str) -> "MeasuredTiming | str":
    periods_ns = np.diff(run.samples.time_ns)
    periods_ns = periods_ns[periods_ns > 0]  # without those of a burst
    if not len(periods_ns) or len(run.poses) < 2:
        return "the recording holds no two samples at different times"
    found = find_dead_time(run, loop)
    if isinstance(found, Missing):
        return f"the dead time cannot be measured: {found.reason}"
    from turtlelog.theory import MeasuredTiming

    tick_s = compute_median(np.diff(run.poses.time_ns)) / 1e9
    changes = " at the end" if found.changes else ""
    words = f"{measured}, {found.ticks} tick{'' if found.ticks == 1 else 's'}"
    return MeasuredTiming(
        period_s=compute_median(periods_ns) / 1e9,
        dead_time_s=found.ticks * tick_s,
        sources={"period_s": measured, "dead_time_s": words + changes},
    )
