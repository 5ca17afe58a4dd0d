"""Settings between controller and plant that could have produced a log."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np

from turtlelog.explain.scenario_from_log.trace import Trace, count_leading
from turtlelog.measure import DeadTime, Missing
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.scenario import LoopSettings

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
_QUICK: Final = 0.5
"""Share of the usual time between answers below which answers belong to a burst."""

_DEFAULTS: Final = LoopSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class Hints:
    """Constraints on the loop from time stamps and pose numbers.

    Attributes:
        backlogs: Initial queues that agree with the stamps and numbers.
        pauses: Pauses that agree with the stamps [ticks]; empty if the law's own pause is unknown.
        pause_s: Silence after the rotation, by the clock [s]; None if the rotation does not end.
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

    The first tier has the usual queue depths. The second has depths that could cause a dead time or
    a burst, the third all other depths of the command queue. In each tier, settings without a
    transport delay come first.
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


def drop_pause(guess: Guess) -> Guess:
    """Return a guess without a pause setting."""
    return {key: value for key, value in guess.items() if key != PAUSE_KEY}
