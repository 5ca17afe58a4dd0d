"""Text of `turtlelog identify`: a robot's delay, its values, and their reliability."""

import math
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import (
    build_table,
    fill_lines,
    fit_body,
    name_explain,
    quote_file,
    read_law,
)
from turtlelog.display import describe_count, join_words
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import RobotModel
    from turtlelog.identify import AxisModel, Estimate, RobotScenario

_DOES: Final = {"speed": "drives at {} speed", "turn_rate": "turns at {} rate"}
_NAV2: Final = {"speed": "model_delay_vx", "turn_rate": "model_delay_wz"}
"""Parameters of Nav2's MPPI controller for the delay of each axis [s]."""

_MOST_EVENTS: Final = 5
_RARE: Final = 0.01
"""Share of the steps above which outliers are not single faults, for example jumps."""

_CURVE: Final = 0.5
"""Whiteness below which the residual is a curve: neighbouring values share half of their error."""

_LITTLE: Final = 0.5
"""Explained share below which commands do not cause most changes of the motion."""

_AS_COMMANDED: Final = 1e-3
"""Largest deviation of a gain from 1 that is not mentioned [1]."""

_NEAR: Final = 0.05
"""Deviation of a gain from 1 below which percentages need decimals [1]."""


def format_robot(
    model: "RobotModel",
    files: Sequence[Path],
    *,
    robot: "RobotScenario | None" = None,
    scenario: Path | None = None,
    shows_details: bool = False,
) -> str:
    """Return the robot's delay, its values, and their reliability."""
    known = [axis for axis in model.axes if axis.is_known]
    parts = [fill_lines(tl.identify.write_robot_headline(model.axes, _name_robot(files)))]
    if known:
        brackets = model.brackets
        if any(axis.doubts for axis in known):
            brackets += ", wider for the doubts below"
        heads = [tl.compare.Column(title=head) for head in tl.identify.HEADS]  # units in the titles
        table = build_table("", heads, map(tl.identify.list_model_values, known))
        told = ["Total delay: dead time plus time constant.", f"In brackets: {brackets}."]
        parts += [f"{fit_body(table)}\n{fill_lines([' '.join(told)])}\n"]
        parts += [fill_lines([_describe_motion(known)])]
    trust = [*_list_trust(model), *_list_unknown(model)]
    trust += _list_details(model) if shows_details else []
    parts += [fill_lines(trust, indent=2)] if trust else []
    parts += _list_nav2(known)
    if robot is not None:
        parts += ["", _describe_scenario(robot, scenario, shows_notes=shows_details)]
    return "\n".join([*parts, "", *_list_next(model, files, scenario, shows_details=shows_details)])


def _describe_scenario(robot: "RobotScenario", path: Path | None, *, shows_notes: bool) -> str:
    """Return the sources of a scenario's numbers, or the file that contains them."""
    if not shows_notes:
        return fill_lines([f"Comments in {path} give the source of each number."])
    notes = [f"- {note}" for note in robot.notes]
    return f"The scenario {path}:\n{fill_lines(notes, indent=2)}"


def _name_robot(files: Sequence[Path]) -> str:
    if len(files) == 1:
        return tl.compare.label_file(files[0])
    return f"{len(files)} runs of one robot"


def _describe_motion(known: "Sequence[AxisModel]") -> str:
    """Return a sentence on the robot's steady-state response to commands."""
    return (
        f"The robot {join_words([f'{describe_gain(axis)}{_tell_bound(axis)}' for axis in known])}."
    )


def _tell_bound(axis: "AxisModel") -> str:
    """Return the rate up to which an axis follows its commands, if it has a bound."""
    return "" if axis.bound is None else f" up to {axis.bound.value:.3g} {axis.bound.unit}"


def describe_gain(axis: "AxisModel") -> str:
    """Return the steady-state response of an axis, with the digits that its interval allows."""
    gain, does = axis.gain, _DOES[axis.axis]
    if gain is None:
        return does.format("an unknown")
    off = max(abs(gain.low - 1.0), abs(gain.high - 1.0))
    if off < _AS_COMMANDED:
        return does.format("the commanded")
    if gain.low <= 1.0 <= gain.high:
        return f"{does.format('the commanded')} to within {100.0 * off:.2g} %"
    percent = 100.0 * gain.value
    return does.format(
        f"{percent:.1f} % of the commanded" if off < _NEAR else f"{percent:.0f} % of the commanded"
    )


def _list_trust(model: "RobotModel") -> Iterator[str]:
    """Yield sentences on the reliability of the values, and on further facts of the motion."""
    for axis in model.axes:
        yield from _describe_axis(axis)
    if model.tick_delays is not None:
        delays = model.tick_delays
        count = describe_count(delays.shown, "command")
        yield (
            f"From {count} to the pose that shows each: least {1e3 * delays.least_s:.1f} ms, median"
            f" {1e3 * delays.median_s:.1f} ms, largest {1e3 * delays.largest_s:.1f} ms."
        )
    doubts = [doubt for axis in model.axes for doubt in axis.doubts]
    yield from (f"Doubt: {note}" if note in doubts else note for note in model.notes)
    yield from _list_events(model)
    clock = model.clock
    if clock is None or not any(axis.is_known for axis in model.axes):
        return
    if clock.used == "log":
        yield "Poses are timed by the recorder's clock: the delays include their transport."
    else:
        yield (
            "Poses are timed by their stamps: the delays include the transport of the fastest"
            " message, which is unknown."
        )


def _describe_axis(axis: "AxisModel") -> Iterator[str]:
    if not axis.is_known or axis.explained is None:
        return
    name = tl.identify.NAMES[axis.axis].capitalize()
    yield (
        f"{name}: the model explains {100.0 * axis.explained:.0f} % of the variance of"
        f" {axis.steps} steps between poses.{_describe_residual(axis)}"
    )
    if _is_sum_only(axis):
        yield (
            f"{name}: the log does not separate dead time from time constant, it shows their sum."
        )
    yield from _describe_second_order(axis)
    yield from _describe_acceleration(axis)
    if axis.bound_beside is not None:
        yield from _describe_wheels(axis, axis.bound_beside)
    elif axis.bound is not None:
        yield f"{name} settles at {_show_limit(axis.bound)} at most: larger commands do no more."
    if axis.deadband is not None:
        yield f"{name}: commands below {_show_limit(axis.deadband)} move nothing."
    if axis.friction is not None:
        yield f"{name}: friction takes {_show_limit(axis.friction)} off each command."
    if axis.reverse_gain is not None:
        gain = tl.identify.format_gain(axis.reverse_gain)
        yield f"{name}: commands below 0 have a gain of {gain}."


def _is_sum_only(axis: "AxisModel") -> bool:
    """Return whether dead time and time constant may each be 0, although their sum may not."""
    parts, total = (axis.dead_time_s, axis.lag_s), axis.total_delay_s
    is_open = all(part is not None and part.low <= 0.0 for part in parts)
    return is_open and total is not None and total.low > 0.0


def _describe_acceleration(axis: "AxisModel") -> Iterator[str]:
    """Yield the limits of how fast the rate changes, in sentences."""
    name = tl.identify.NAMES[axis.axis].capitalize()
    other = tl.identify.NAMES["turn_rate" if axis.axis == "speed" else "speed"]
    if axis.rate_limit is not None:
        where = _WHERE[axis.limit_acts]
        yield f"{name} changes by at most {_show_limit(axis.rate_limit)}, {where}."
    if axis.jerk_time_s is not None:
        time_s = _show_limit(axis.jerk_time_s)
        yield f"{name}: its jerk is limited, so the acceleration reaches its limit within {time_s}."
    if axis.rate_limit_beside is not None:
        yield (
            f"The wheels limit the acceleration of both axes together: a {other} that changes by"
            f" {_show_limit(axis.rate_limit_beside)} reaches this limit alone."
        )


_WHERE: Final = MappingProxyType(
    {"before_lag": "before the lag", "within_lag": "within its velocity loop", "at_wheels": "alone"}
)
"""Where a limit of the acceleration acts, in words."""


def _describe_wheels(axis: "AxisModel", beside: "Estimate") -> Iterator[str]:
    """Yield the limit of the wheels, which both axes share, in sentences."""
    name = tl.identify.NAMES[axis.axis]
    other = tl.identify.NAMES["turn_rate" if axis.axis == "speed" else "speed"]
    ways = {
        "scaled": "a command beyond is reduced on both axes alike",
        "clipped": "a command beyond is clipped at each wheel",
        "yielding": f"a command beyond reduces the {name} only",
    }
    if axis.bound is None:
        yield (
            f"A commanded {other} above {_show_limit(beside)} reduces the {name}, in proportion:"
            " the wheels limit both axes together."
        )
        return
    yield (
        f"The wheels limit both axes together: the {name} settles at {_show_limit(axis.bound)} at"
        f" most without a {other}."
    )
    yield (
        f"A commanded {other} of {_show_limit(beside)} alone reaches this limit, and"
        f" {ways[axis.bound_acts]}."
    )


def _show_limit(found: "Estimate") -> str:
    return f"{found.value:.3g} {found.unit} ({found.low:.3g} to {found.high:.3g})"


def _describe_residual(axis: "AxisModel") -> str:
    said = []
    if axis.explained is not None and axis.explained < _LITTLE:
        said.append(" Most changes of the motion do not follow from the commands.")
    if axis.whiteness is not None and axis.whiteness < _CURVE:
        said.append(" The rest is a curve, not noise: the model lacks something.")
    return "".join(said)


def _describe_second_order(axis: "AxisModel") -> Iterator[str]:
    """Yield text on a second order: two time constants, or an oscillation if that is certain."""
    product, lag, name = axis.lag_product_s2, axis.lag_s, tl.identify.NAMES[axis.axis].capitalize()
    if product is None or lag is None:
        return
    equal = 0.25 * lag.value**2
    if product.low > equal:
        damping = math.sqrt(equal / product.value)
        yield f"{name} is of second order and oscillates: its damping ratio is {damping:.2f}."
    elif product.high > equal:
        half_ms = 500.0 * lag.value
        yield f"{name} is of second order, with two time constants of about {half_ms:.0f} ms."
    else:
        yield (
            f"{name} is of second order: the time constant is the sum of two, whose product is"
            f" {product.value:.3g} s^2 ({product.low:.3g} to {product.high:.3g})."
        )


def _list_unknown(model: "RobotModel") -> Iterator[str]:
    """Yield the reasons why axes are not identified, and test drives."""
    for axis in model.axes:
        if not axis.is_known:
            end = "" if axis.reason.endswith("?") else "."
            name = tl.identify.NAMES[axis.axis].capitalize()
            yield f"{name}: not identifiable: {axis.reason}{end} To know it, {axis.advice}."


def _list_details(model: "RobotModel") -> Iterator[str]:
    """Yield a second estimate of delays: where commands and motion correlate best."""
    for axis in model.axes:
        name, delay = tl.identify.NAMES[axis.axis].capitalize(), axis.correlation_delay_s
        if not axis.is_known or axis.explained is None:
            continue
        if delay is None:
            yield f"{name}: {axis.correlation_reason}."
        else:
            low, high = (f"{1e3 * end:.0f}" for end in (delay.low, delay.high))
            yield f"{name}: commands and motion correlate best at a delay of {low} to {high} ms."


def _list_events(model: "RobotModel") -> list[str]:
    """Return the outliers one by one; many of one axis are in one sentence."""
    said, often = [], []
    for axis in model.axes:
        found = [event for event in model.events if event.axis == axis.axis]
        if len(found) > _RARE * axis.steps:
            often.append(axis.axis)
            worst = max(found, key=lambda event: abs(event.size))
            name = tl.identify.NAMES[axis.axis].capitalize()
            said.append(
                f"{name}: {len(found)} of {axis.steps} steps are off by"
                f" far more than is usual and do not count; the largest: {worst.text}."
            )
    rare = [event for event in model.events if event.axis not in often]
    said += [f"Outlier: {event.text}." for event in rare[:_MOST_EVENTS]]
    if len(rare) > _MOST_EVENTS:
        said.append(f"And {describe_count(len(rare) - _MOST_EVENTS, 'outlier')} more, in --json.")
    return said


def _list_nav2(known: "Sequence[AxisModel]") -> list[str]:
    """Return parameters for Nav2, whose model is a pure delay that includes the time constant."""
    lines = [
        f"  {_NAV2[axis.axis]}: {axis.advised_delay_s:.3f}"
        for axis in known
        if axis.advised_delay_s is not None
    ]
    head = "For Nav2's MPPI controller, dead time and time constant as one delay [s]:"
    if any(axis.doubts for axis in known):
        head = head.replace("[s]:", "[s],\nthe upper end of its interval where there is a doubt:")
    return ["", head, *lines] if lines else []


def _list_next(
    model: "RobotModel", files: Sequence[Path], scenario: Path | None, *, shows_details: bool
) -> Iterator[str]:
    """Yield the next commands to type."""
    words = escape_controls(" ".join(shlex.quote(str(file)) for file in files))
    if scenario is not None:
        target = quote_file(scenario)
        yield f"Next: turtlelog theory {target}"
        yield f"Test it on a bag that it has not seen: turtlelog compare OTHER {target}"
    elif model.tick_delays is not None:
        # `explain` takes one recording.
        yield f"Why? {name_explain(files[0], read_law(files[0]))}"
    elif _is_scenario(model):
        yield f"Simulate it and find gains: turtlelog identify {words} --scenario robot.toml"
    if not shows_details and any(axis.is_known and axis.explained for axis in model.axes):
        more = "" if scenario is None else ", and the source of each number"
        yield f"A second opinion on the delays{more}: --details"


def _is_scenario(model: "RobotModel") -> bool:
    """Return whether the robot can become a scenario: every commanded axis must be known."""
    return any(axis.is_known for axis in model.axes) and all(
        axis.is_known or axis.is_idle for axis in model.axes
    )
