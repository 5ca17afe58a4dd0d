"""Command metrics: from commands as they hold to a value or the reason for none."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from turtlelog.measure import command
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import Found, Missing, Result, Status
from turtlelog.measure.registry import loop_metric
from turtlelog.measure.response import CommandStretch, Response

OfCommands = Callable[[CommandStretch], Result]


def _command_metric(
    name: str, unit: str, meaning: str, **more: Any
) -> Callable[[OfCommands], OfCommands]:
    """Enter a function of a loop's commands in the registry."""

    def enter(compute: OfCommands) -> OfCommands:
        def compute_of_loop(_: RunContext, response: Response) -> Result:
            return compute(response.commands)

        loop_metric(name, unit, meaning, **more)(compute_of_loop)
        return compute

    return enter


_NO_LIMIT: Final = Missing(status=Status.ABSENT, reason="the recording does not hold the limit")
_NO_WANTED: Final = Missing(
    status=Status.ABSENT, reason="the recording does not hold the wanted command"
)
_ONE_TIME: Final = Missing(status=Status.TOO_SHORT, reason="all commands share one time")


@_command_metric(
    "effort", "{command}^2/s", "Integral of the square of the {command} as it holds.", grows=True
)
def compute_effort(commands: CommandStretch) -> Result:
    """See `command.compute_effort`."""
    return Found(command.compute_effort(commands.held_s, commands.values))


@_command_metric(
    "total_variation",
    "{command}/s",
    "Sum of the magnitudes of all changes of the {command}.",
    grows=True,
)
def compute_total_variation(commands: CommandStretch) -> Result:
    """See `command.compute_total_variation`."""
    return Found(command.compute_total_variation(commands.values))


@_command_metric(
    "largest_jump",
    "{command}/s",
    "Largest change of the {command} from one sample to the next.",
    grows=True,
)
def compute_largest_jump(commands: CommandStretch) -> Result:
    """See `command.find_largest_jump`."""
    jump, row = command.find_largest_jump(commands.values)
    return Found(jump, float(commands.time_s[row]))


@_command_metric(
    "largest_slew_rate",
    "{command}/s^2",
    "Largest such change over the time that it took, bursts as one.",
    grows=True,
)
def compute_largest_slew_rate(commands: CommandStretch) -> Result:
    """See `command.find_largest_slew_rate`."""
    found = command.find_largest_slew_rate(commands.time_s, commands.values)
    return _ONE_TIME if found is None else Found(found[0], float(commands.time_s[found[1]]))


@_command_metric("reversals", "1", "How often the {command} changes its sign.", grows=True)
def compute_reversals(commands: CommandStretch) -> Result:
    """See `command.count_reversals`."""
    return Found(float(command.count_reversals(commands.values)))


@_command_metric(
    "largest_wanted", "{command}/s", "Largest {command} that the law asked for.", grows=True
)
def compute_largest_wanted(commands: CommandStretch) -> Result:
    """The largest magnitude before clipping."""
    wanted = commands.wanted
    if wanted is None:
        return _NO_WANTED
    row = int(np.abs(wanted).argmax())
    return Found(abs(float(wanted[row])), float(commands.time_s[row]))


@_command_metric(
    "saturated_share",
    "1",
    "Share of the samples whose {command} stands at its limit.",
    needs_whole=False,
)
def compute_saturated_share(commands: CommandStretch) -> Result:
    """By samples; taken at the first that is saturated."""
    saturated = commands.is_saturated
    if saturated is None:
        return _NO_LIMIT
    return Found(float(saturated.mean()), _tell_first(commands))


@_command_metric(
    "saturated_time_share",
    "1",
    "Share of the time during which the {command} stands at its limit.",
    needs_whole=False,
)
def compute_saturated_time_share(commands: CommandStretch) -> Result:
    """By time, under hold; taken at the first that is saturated."""
    saturated = commands.is_saturated
    if saturated is None:
        return _NO_LIMIT
    held_s = commands.held_s
    length_s = float(held_s.sum())
    if length_s <= 0.0:
        return _ONE_TIME
    share = min(float(np.dot(held_s, saturated)) / length_s, 1.0)
    return Found(share, _tell_first(commands))


@_command_metric(
    "longest_saturation",
    "s",
    "Longest time for which the {command} stands at its limit without a break.",
    grows=True,
)
def compute_longest_saturation(commands: CommandStretch) -> Result:
    """See `command.find_longest_held`; taken at its start."""
    saturated = commands.is_saturated
    if saturated is None:
        return _NO_LIMIT
    found = command.find_longest_held(commands.held_s, saturated)
    if found is None:
        return Found(0.0)
    return Found(found[0], float(commands.time_s[found[1]]))


def _tell_first(commands: CommandStretch) -> float | None:
    saturated = commands.is_saturated
    if saturated is None or not saturated.any():
        return None
    return float(commands.time_s[saturated.argmax()])
