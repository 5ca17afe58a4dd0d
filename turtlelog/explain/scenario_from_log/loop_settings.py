"""Settings between controller and plant: those that may have produced a log, and what is found."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from turtlelog.explain.scenario_from_log import (
    LOOP_KEYS,
    Certainty,
    Finding,
    bound_value,
    find_exactly,
    fit_value,
    leave_open,
    miss,
)
from turtlelog.explain.scenario_from_log.gain_fit import find_quantile
from turtlelog.explain.scenario_from_log.resimulation import (
    list_lost_commands,
    read_pause,
)
from turtlelog.explain.scenario_from_log.trace import Trace, count_leading
from turtlelog.measure import DeadTime, Missing
from turtlelog.plants.turtlesim import TICK_NS, TICK_S
from turtlelog.run.angles import subtract_headings
from turtlelog.scenario import LoopSettings

if TYPE_CHECKING:
    from turtlelog.explain.scenario_from_log.setting_search import Fits

Guess = Mapping[str, Any]
"""Values by key of the scenario."""

PAUSE_KEY: Final = "law.pause_ticks"

DEPTHS: Final = ("loop.command_queue", "loop.pose_queue")

_LARGEST_BACKLOG: Final = 12
"""Largest tried initial queue if the clock does not show it. Beyond the usual queue depth of 10,
the runs are equal."""

_LARGEST_DELAY: Final = 8
"""Largest tried transport delay if no dead time is known [ticks]."""
_PAUSE_SLACK_TICKS: Final = 2.5
"""Largest difference of a tried pause from the clock's pause: both ends may be a tick late."""

_JITTER_TICKS: Final = 0.75
"""Largest difference of a pause from the clock's pause without contradiction: a callback waits for
less than a tick, and the paper's clocks are wrong by a tenth of a tick."""

_QUICK: Final = 0.5  # share of the usual time between answers below which answers belong to a burst

_DEFAULTS: Final = LoopSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class Hints:
    """Constraints on the loop from time stamps and pose numbers.

    Attributes:
        backlogs: Initial queues that agree with the stamps and numbers.
        pauses: Pauses that agree with the stamps [ticks]; empty if the law's own pause is unknown.
        pause_s: Silence after the rotation, by the clock; None if the rotation does not end.
        burst: Number of poses answered at once after the pause.
        pose_queue: Depth of the pose queue if poses were lost; otherwise None.
    """

    backlogs: tuple[int, ...]
    pauses: tuple[int, ...]
    pause_s: float | None
    burst: int
    pose_queue: int | None


def read_hints(trace: Trace) -> Hints:
    """Return the constraints on the loop from time stamps and pose numbers."""
    step_ns = np.diff(trace.time_ns)
    quick = step_ns < _QUICK * trace.period_ticks * TICK_NS
    ended = trace.rotating - 1
    burst = 1 + count_leading(quick[ended + 1 :]) if trace.shows_pause else 0
    pause_s = float(step_ns[ended]) / 1e9 if trace.shows_pause else None
    return Hints(
        backlogs=_list_backlogs(trace, 1 + count_leading(quick)),
        pauses=_list_pauses(trace, pause_s),
        pause_s=pause_s,
        burst=burst,
        pose_queue=_find_pose_queue(trace, burst),
    )


def _list_backlogs(trace: Trace, answered: int) -> tuple[int, ...]:
    if trace.has_ticks and trace.has_exact_clock:
        waited_ns = trace.time_ns[0] - trace.run.poses.time_ns[0]
        latest = int(waited_ns) // (TICK_NS * trace.period_ticks) + 1
        # If the first samples are lost, the controller began at any earlier pose.
        return tuple(range(1 if trace.number[0] else latest, latest + 1))
    if answered >= _DEFAULTS.pose_queue:
        return tuple(range(answered - 1, answered + 3))
    # The pose after the burst may have arrived just in time.
    return tuple(backlog for backlog in (answered, answered - 1) if backlog >= 1)


def _list_pauses(trace: Trace, pause_s: float | None) -> tuple[int, ...]:
    ended, run = trace.rotating - 1, trace.run
    if pause_s is None:
        silent_ns = int(run.end_ns - trace.time_ns[ended]) if trace.ended_rotation else 0
        return (silent_ns // TICK_NS + 1 if silent_ns else 0,)
    if trace.has_exact_clock and len(run.commands) == len(trace):
        held_ns = run.commands.time_ns[ended] - trace.time_ns[ended]
        if trace.has_ticks or held_ns:
            return (int(held_ns) // TICK_NS,)
    silence = pause_s * 1e9 / TICK_NS
    # A pause shorter than the usual time between answers is invisible.
    apart = {
        pause: abs(max(pause, trace.period_ticks) - silence) for pause in range(round(silence) + 4)
    }
    near = [pause for pause, ticks in apart.items() if ticks <= _PAUSE_SLACK_TICKS]
    return tuple(sorted(near, key=apart.__getitem__)) or (round(silence),)


def agrees_with_clock(pause_ticks: int, hints: Hints, trace: Trace) -> bool:
    """Return whether a pause agrees with the clock, within its jitter."""
    if hints.pause_s is None:
        return True
    silence = hints.pause_s * 1e9 / TICK_NS
    return abs(max(pause_ticks, trace.period_ticks) - silence) <= _JITTER_TICKS


def _find_pose_queue(trace: Trace, burst: int) -> int | None:
    if not (trace.has_ticks and trace.has_exact_clock):
        return None
    read = trace.run.samples.pose_sequence
    # The first pose answered is the oldest one that the queue kept.
    lost = int(read[0]) // trace.period_ticks
    if lost and int(trace.number[0]) == 0:
        return _list_backlogs(trace, 1)[-1] - lost
    if trace.shows_pause:
        first = trace.rotating
        # A burst at the end of the log does not show how many poses waited.
        is_whole = first + burst < len(trace)
        if is_whole and read[first] - read[first - 1] > trace.period_ticks:
            return burst
    return None


def list_queues(
    trace: Trace, hints: Hints, rotate: DeadTime | Missing, translate: DeadTime | Missing
) -> list[list[Guess]]:
    """Return the settings of initial queue and queues that agree with the dead times, in tiers.

    First the usual queue depths, then depths that could cause a dead time or a burst, then all
    other depths of the command queue. In each tier, settings without a transport delay come first.
    """
    before = rotate.ticks if isinstance(rotate, DeadTime) else None
    after = translate.ticks if isinstance(translate, DeadTime) else None
    depth, pose_queue = _DEFAULTS.command_queue, hints.pose_queue or _DEFAULTS.pose_queue
    depths = _list_unique(depth, *(d + 1 for d in (after, before) if d))
    pose_queues = _list_unique(pose_queue, *(d for d in (hints.burst, hints.burst - 1) if d > 0))
    pose_queues += [backlog for backlog in hints.backlogs if backlog > max(pose_queues)]
    usual, *rarer = product(depths, pose_queues)
    others = product((d for d in range(2, max(depths)) if d not in depths), pose_queues)
    tiers = [
        _list_guesses(trace, hints, (before, after), pairs) for pairs in ([usual], rarer, [*others])
    ]
    # If noise or a change hides the true dead time, all settings are tried.
    return tiers if any(tiers) else [_list_guesses(trace, hints, (None, None), [usual])]


def _list_guesses(
    trace: Trace,
    hints: Hints,
    dead_times: tuple[int | None, int | None],
    depths: list[tuple[int, int]],
) -> list[Guess]:
    before, after = dead_times
    backlogs = _list_unique(*hints.backlogs, *((before + 1,) if before is not None else ()))
    if not (trace.has_ticks and trace.has_exact_clock):
        # An initial queue longer than the queue's depth gives the dead time of a full queue.
        depth = min((depth for depth, _ in depths), default=1)
        least = 1 if before is None else min(before + 1, depth)
        is_open = before is None or least == depth
        backlogs = _list_unique(*backlogs, *range(least, _LARGEST_BACKLOG + 1 if is_open else 0))
    policies = ("newest", "one-per-tick") if not before else ("one-per-tick", "newest")
    guesses: list[Guess] = []
    for (depth, pose_queue), policy, backlog in product(depths, policies, backlogs):
        # If answers are more than a tick apart, the queue drains.
        drains = policy == "newest" or trace.period_ticks > 1
        waiting = 0 if drains else min(backlog, pose_queue, depth) - 1
        if before is not None and policy == "one-per-tick" and drains:
            delays = [*range(before, -1, -1)]
        elif before is not None:
            delays = [before - waiting]
        else:
            delays = _list_unique(0, after, *range(1, _LARGEST_DELAY + 1))
        guesses += [
            {
                "loop.period_ticks": trace.period_ticks,
                "loop.start_backlog": backlog,
                "loop.pose_queue": pose_queue,
                "loop.command_queue": depth,
                "loop.queue_policy": policy,
                "loop.transport_delay_ticks": delay,
            }
            for delay in delays
            if delay >= 0
        ]
    return sorted(guesses, key=lambda guess: bool(guess["loop.transport_delay_ticks"]))


def _list_unique(*values: int | None) -> list[int]:
    return [*dict.fromkeys(value for value in values if value is not None)]


def list_neighbours(guess: Guess) -> list[Guess]:
    """Return the settings that differ in one value by one step."""
    counts = {"loop.start_backlog": 1, **dict.fromkeys(DEPTHS, 1), "loop.transport_delay_ticks": 0}
    near = [
        {**guess, key: guess[key] + step}
        for key, least in counts.items()
        for step in (-1, 1)
        if guess[key] + step >= least
    ]
    policies = {"newest": "one-per-tick", "one-per-tick": "newest"}
    return [*near, {**guess, "loop.queue_policy": policies[guess["loop.queue_policy"]]}]


def set_pause(guess: Guess, ticks: int | None) -> Guess:
    """Return a guess with this pause; unchanged for None, which is a law without a known pause."""
    return guess if ticks is None else {**guess, PAUSE_KEY: ticks}


START_KEYS: Final = ("start.x_m", "start.y_m", "start.heading_rad")

_QUEUES: Final = ("loop.queue_policy", "loop.command_queue", "loop.pose_queue")
"""Settings that get the default as their single value, because the clock does not show them."""

_LIKE_A_LAG: Final = {
    "loop.start_backlog": 1,
    "loop.transport_delay_ticks": 0,
    "law.pause_ticks": 0,
}
"""Settings that a time constant of the robot may imitate, with their smallest values."""


def describe_loop(trace: Trace, fits: "Fits", lag_slack: int = 0) -> dict[str, Finding]:
    """Return findings on the settings between controller and plant, and on lost commands.

    If no setting is exact and the residual is not noise, the best fit is not a finding. `lag_slack`
    is the number of ticks of the dead times that may be a time constant of the robot.
    """
    keys = [key for key in LOOP_KEYS if key in fits.guesses[0]]
    poses = np.column_stack([trace.xy_m, trace.heading_rad])
    if not np.ptp(poses, axis=0).any():
        reason = "the robot never moves in this log"
        findings = {key: miss(reason, fits.guesses[0][key]) for key in keys}
        return {**findings, "lost_commands": miss(reason)}
    findings = {key: _describe_setting(trace, fits, key) for key in keys}
    if lag_slack and not fits.is_reproduced:
        findings |= _allow_lag(findings, lag_slack)
    for key in _QUEUES:
        if fits.is_driven and len(fits.ranges[key]) == 1:
            findings[key] = miss("no other value was tried", fits.guesses[0][key])
    if fits.is_exact:
        likeliest, *others = list_lost_commands(fits.scenarios)
        lost = find_exactly(likeliest, "the re-simulation's plant never takes them")
        if counts := {*others} - {likeliest}:
            because = "the settings that fit lose different numbers"
            lost = leave_open(sorted({likeliest, *counts}), because, likeliest)
    else:
        never = "no setting reproduces every sample"
        lost = miss("only a re-simulation shows" if fits.is_driven else never)
    findings["lost_commands"] = lost
    if "law.pause_ticks" in keys and not trace.shows_pause:
        assumed = fits.guesses[0]["law.pause_ticks"]
        seen = f": at least {assumed - 1} ticks" if assumed else ""
        findings["law.pause_ticks"] = miss(f"the log does not show the end of it{seen}", assumed)
    return findings


def describe_pause(trace: Trace, hints: Hints, fits: "Fits") -> dict[str, Finding]:
    """Return the silence after the rotation, the command held in it, and what follows it."""
    keys = ("pause.seconds", "pause.held_turn_rate_rad_s", "pause.turned_rad", "pause.burst")
    if hints.pause_s is None:
        return dict.fromkeys(keys, miss("the log does not show the end of a rotation"))
    reason = "no setting reproduces every sample"
    held, burst = miss(reason), miss(f"{reason}; by the clock {hints.burst - 1} or {hints.burst}")
    if fits.is_exact:
        again = [read_pause(scenario) for scenario in fits.scenarios]
        rates, bursts = ([*dict.fromkeys(values)] for values in zip(*again, strict=True))
        if 0 in bursts:
            held = burst = miss("the re-simulation has no pause")
        else:
            burst = _settle(bursts, "poses answered at once after it")
            reason = "the queue is not empty before the pause ends: no command is held"
            last = "the last command before the rotation's end"
            held = miss(reason) if None in rates else _settle(rates, last)
    return {
        "pause.seconds": find_exactly(hints.pause_s, "from the last answer to the next one"),
        "pause.held_turn_rate_rad_s": held,
        "pause.burst": burst,
        "pause.turned_rad": _describe_turn(trace, fits),
    }


def _describe_turn(trace: Trace, fits: "Fits") -> Finding:
    """Return the robot's turn from the rotation's last sample to the last sample of the log."""
    ended = trace.rotating - 1
    jumped = [row for row in trace.jumps if row > ended]
    if jumped:
        return miss("the pose jumps after the rotation: how far the robot turned is unknown")
    turned = subtract_headings(float(trace.heading_rad[-1]), float(trace.heading_rad[ended]))
    evidence = "heading at the end, less at the rotation's"
    if fits.is_reproduced:
        return find_exactly(turned, evidence)
    if not (fits.is_fitted and fits.drive):
        return miss("no setting explains the motion")
    # Each of the two headings has its own noise.
    reach = find_quantile(fits.drive.rows) * float(np.sqrt(2.0)) * fits.drive.noise[2]
    return fit_value(turned, evidence, (turned - reach, turned + reach))


def _settle(values: list[Any], evidence: str) -> Finding:
    if len(values) == 1:
        return find_exactly(values[0], evidence)
    return leave_open(tuple(values), "the settings that fit differ in it", values[0])


def _describe_setting(trace: Trace, fits: "Fits", key: str) -> Finding:
    values, chosen = fits.list_values(key), fits.guesses[0][key]
    if reason := _find_obstacle(fits, key, chosen):
        return miss(reason, chosen)
    if len(values) > 1:
        how = "reproduces every sample" if fits.is_reproduced else "leaves as little as the others"
        return leave_open(values, f"each {how}", chosen)
    also = _name_alike(key, chosen)
    if fits.is_exact:
        if key == "loop.period_ticks":
            return find_exactly(chosen, "the usual distance of the poses answered")
        return find_exactly(chosen, f"reproduces all {len(trace)} samples{also}")
    evidence = f"likeliest of {fits.tried} settings; none is exact"
    if fits.is_driven:
        evidence = f"likeliest of {fits.tried} settings, the plant driven with the log's commands"
        also = also.replace("so does", "as likely is")
    if fits.is_close:
        evidence = f"reproduces all {len(trace)} samples to rounding, none bit for bit"
    is_number = isinstance(chosen, int)
    return fit_value(chosen, evidence + also, (chosen, chosen) if is_number else None)


def _find_obstacle(fits: "Fits", key: str, chosen: Any) -> str:
    """Return why a setting has no value; empty if it has a value."""
    if not (fits.is_reproduced or fits.is_fitted):
        if fits.is_driven and fits.drive is None:
            return f"none of {fits.tried} settings answers the poses that were answered"
        return f"none of {fits.tried} settings explains the motion; {chosen} is the nearest one's"
    if fits.is_partial and not fits.is_reproduced:
        return "the log is too long to try all settings that may explain it"
    return "a deeper queue gives the same run" if key in fits.hidden else ""


def _allow_lag(findings: Mapping[str, Finding], ticks: int) -> dict[str, Finding]:
    """Widen intervals by a time constant, which is never longer than the dead time it imitates."""
    waits = [findings[key].used for key in _LIKE_A_LAG if key in findings and key != PAUSE_KEY]
    ticks = min(ticks, sum(waits))
    return {
        key: replace(
            findings[key],
            interval=(max(findings[key].value - ticks, least), findings[key].value + ticks),
            evidence=f"{findings[key].evidence}; up to {ticks} ticks may be a lag of the robot",
        )
        for key, least in _LIKE_A_LAG.items()
        if key in findings and findings[key].certainty is Certainty.FITTED
    }


def _name_alike(key: str, chosen: Any) -> str:
    """Return the other settings that give the same run; empty if no others do."""
    if key == "loop.transport_delay_ticks" and chosen:
        low_s, high_s = chosen * TICK_S, (chosen + 1) * TICK_S
        return f"; so does any delay from {low_s:.3g} s to below {high_s:.3g} s"
    if key == "loop.pose_queue" and chosen == 1:
        return "; so does a timer that reads the newest pose"
    return "; so does a command queue of 1" if chosen == "newest" else ""


_GOAL_KEYS: Final = ("goal.x_m", "goal.y_m")


def read_start(trace: Trace) -> dict[str, Any]:
    """Return the initial settings to simulate with, by key of the scenario: the first pose read."""
    values = np.column_stack([trace.run.poses.xy_m, trace.run.poses.heading_rad])
    precision = "float32" if (values == values.astype(np.float32)).all() else "float64"
    first = (*trace.xy_m[0].tolist(), float(trace.heading_rad[0]))
    return {**dict(zip(START_KEYS, first, strict=True)), "loop.pose_precision": precision}


def describe_goal(trace: Trace) -> dict[str, Finding]:
    """Return the goal in the log."""
    if trace.goal_xy_m is None:
        return dict.fromkeys(_GOAL_KEYS, miss("the log does not hold the goal"))
    evidence = "as recorded" if trace.run.goal_xy_m else "position plus error, as recorded"
    return {
        key: find_exactly(value, evidence)
        for key, value in zip(_GOAL_KEYS, trace.goal_xy_m, strict=True)
    }


def describe_start(trace: Trace, fits: "Fits") -> dict[str, Finding]:
    """Return the start and the precision of the poses, by key of the scenario."""
    read = read_start(trace)
    precision = read.pop("loop.pose_precision")
    if fits.bounds is not None:
        evidence = "between the steps of logged poses; all poses agree with it"
        bounds = zip(read, fits.bounds.middle, fits.bounds.low, fits.bounds.high, strict=True)
        found = {key: bound_value(value, evidence, (low, high)) for key, value, low, high in bounds}
    elif fits.is_exact:
        found = {key: find_exactly(value, "first pose read") for key, value in read.items()}
    elif fits.drive is None or not fits.is_fitted or fits.drive.is_rounding:
        reason = "no setting explains the motion"
        if fits.drive is not None and fits.is_fitted:
            reason = "the rounding of the poses does not bound it"
        reason += "; taken from the first pose read"
        found = {key: miss(reason, value) for key, value in read.items()}
    else:
        evidence, sides = "least squares of all poses, 95 %", (fits.drive.start, fits.drive.reach)
        found = {
            key: fit_value(value, evidence, (value - reach, value + reach))
            for key, value, reach in zip(read, *sides, strict=True)
        }
    find = find_exactly if fits.is_exact else fit_value
    known = find(precision, "every pose is a 32-bit float")
    if precision == "float64":
        reason = "poses have more than 32 bits"
        hidden = f"{reason}, which noise may have added"
        known = find_exactly(precision, reason) if fits.is_exact else miss(hidden, precision)
    return {**found, "loop.pose_precision": known}
