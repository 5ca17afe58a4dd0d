"""`turtlelog identify`: a robot's gain, dead time and time constant, with their reliability."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.display import describe_count, join_words


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenOptions:
    """Files to write next to the answer.

    Attributes:
        plot: Draw command, motion, model and residual into this .pdf, .png or .svg file.
        rrd: Write command, motion, model and residual to this Rerun recording (.rrd).
        scenario: Write the robot as a scenario to this .toml file, which `run` simulates and
            `theory` recommends gains for.
    """

    plot: options.Place | None = None
    rrd: options.Place | None = None
    scenario: options.Place | None = None


def identify(
    files: options.Files,
    /,
    *,
    written: WrittenOptions = WrittenOptions(),
    details: bool = False,
    topics: options.TopicOptions = options.TopicOptions(),
    json: options.Json = False,
) -> int:
    """Identify how a robot follows its commands: gain, dead time, time constant of each axis.

    Any log with commands and poses can be used: a bag of a real robot, or a recording. Each step
    between two poses is compared with the model's response to the commands (zero-order hold): rate
    = gain exp(-dead_time s) / (lag s + 1). Intervals contain the true value for 95 of 100 robots.
    Further models have a second time constant, a limit of acceleration or speed, a deadband,
    friction, a drift or a different gain backwards. A further model is accepted only if it changes
    a rate by 2 % (a drift: 0.2 %) and predicts a held-back part of the log better. If no model
    explains the motion, intervals are wider and the output contains a doubt. If a parameter cannot
    be identified, the output gives the reason and suggests a test drive. Several files of one robot
    are fitted together, and differences between them are listed.

    Turtlesim needs no fit: each pose shows which command was applied in its tick.

    The exit code is 1 if no axis can be identified.

    Example: turtlelog identify robot_bag

    Example: turtlelog identify robot_bag --scenario robot.toml

    --scenario writes the robot as a scenario with the plant `lagged`: `run` simulates it, `theory`
    recommends gains, `compare` compares it with a bag. Comments in the file give the source of each
    number. The file is not written if an axis has commands but cannot be identified.

    Delays are measured from the time of a command to the time of the pose that shows its effect. If
    poses are timed by their stamps, the transport of the fastest message remains in the delays.

    Args:
        files: Bags, recordings or logs of one robot.
        details: Also print the delays at which commands and motion correlate best, and the source
            of each number of the scenario.
        json: Print one JSON object instead of text.
    """
    plot, rrd, scenario = written.plot, written.rrd, written.scenario
    options.require_pictures(plot, rrd, files, drawn=files, of="file")
    options.require_new_target(scenario, files, suffix=".toml")
    options.require_there(files)
    runs = options.read_runs(files, topics)
    model = tl.identify_robot(runs)
    robot = None if scenario is None else tl.identify.build_robot_scenario(model, runs)
    if json:
        console.print_json(build_identify_answer(files, model, scenario, robot))
    else:
        words = options.list_option_words(topics)
        console.print_text(
            format_robot(model, files, words, robot=robot, scenario=scenario, shows_details=details)
        )
    if robot is not None:
        text = robot.text
        console.write_asked(scenario, lambda path: console.write_text(path, text))
    is_known = any(axis.is_known for axis in model.axes)
    lack = None if is_known else tl.draw.FIGURES["rates"].find_lack(runs[:1])
    if plot is not None and lack is not None:
        console.print_note(f"identify: {plot} is not written: it needs {lack}")
    else:
        console.write_asked(plot, lambda path: tl.draw.write_robot_figure(model, runs[0], path))
    if rrd is not None and not is_known:
        console.print_note(f"identify: {rrd} is not written: no axis was identified")
    else:
        console.write_asked(rrd, lambda path: tl.draw.write_robot_rrd(model, runs[0], path))
    return console.EXIT_FINE if is_known else console.EXIT_FAILED


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioAnswer:
    """The written scenario, with the sources of its numbers."""

    file: str
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyAnswer:
    """A robot's dynamics."""

    files: list[str]
    clock: "tl.run.Clock | None"
    axes: "tuple[tl.identify.AxisModel, ...]"
    tick_delays: "tl.identify.TickDelays | None"
    events: "tuple[tl.identify.RobotEvent, ...]"
    notes: tuple[str, ...]
    scenario: ScenarioAnswer | None


def build_identify_answer(
    files: Sequence[Path],
    model: "tl.RobotModel",
    scenario: Path | None = None,
    robot: "tl.identify.RobotScenario | None" = None,
) -> IdentifyAnswer:
    """Return the answer as data."""
    return console.copy_fields(
        IdentifyAnswer,
        model,
        files=[*map(str, files)],
        scenario=robot and ScenarioAnswer(file=str(scenario), notes=robot.notes),
    )


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
    model: "tl.RobotModel",
    files: Sequence[Path],
    reading: Sequence[str] = (),
    *,
    robot: "tl.identify.RobotScenario | None" = None,
    scenario: Path | None = None,
    shows_details: bool = False,
) -> str:
    """Return the robot's delay, its values, and their reliability."""
    known = [axis for axis in model.axes if axis.is_known]
    several = f"{len(files)} runs of one robot"
    who = several if len(files) > 1 else tl.compare.label_file(files[0])
    parts = [console.fill_lines(tl.identify.write_robot_headline(model.axes, who))]
    if known:
        brackets = model.brackets
        if any(axis.doubts for axis in known):
            brackets += ", with the doubts below"
        heads = [tl.compare.Column(title=head) for head in tl.identify.HEADS]  # units in the titles
        table = console.build_table("", heads, map(tl.identify.list_model_values, known))
        told = f"Total delay: dead time plus time constant. In brackets: {brackets}."
        parts += [f"{console.fit_body(table)}\n{console.fill_lines([told])}\n"]
        parts += [console.fill_lines([f"The robot {join_words([*map(describe_gain, known)])}."])]
    trust = [*_list_trust(model), *_list_axes(model, shows_details=shows_details)]
    parts += [console.fill_lines(trust, indent=2)] if trust else []
    parts += _list_nav2(known)
    if robot is not None:
        told = console.fill_lines([f"Comments in {scenario} give the source of each number."])
        if shows_details:
            notes = console.fill_lines([f"- {note}" for note in robot.notes], indent=2)
            told = f"The scenario {scenario}:\n{notes}"
        parts += ["", told]
    following = _list_next(model, files, reading, scenario, shows_details=shows_details)
    return "\n".join([*parts, "", *following])


def describe_gain(axis: "tl.identify.AxisModel") -> str:
    """Return the steady-state response of an axis, with the digits that its interval allows.

    An axis with a bound follows its commands up to that rate, and a drift is added.
    """
    gain, does, drift = axis.gain, _DOES[axis.axis], axis.drift
    bound = "" if axis.bound is None else f" up to {axis.bound.value:.3g} {axis.bound.unit}"
    bound = axis.exceptions + bound
    if drift is not None:
        sign = "minus" if drift.value < 0.0 else "plus"
        bound += f" {sign} {abs(drift.value):.3g} {drift.unit}"
    if gain is None:
        return does.format("an unknown") + bound
    off = max(abs(gain.low - 1.0), abs(gain.high - 1.0))
    if gain.low <= 1.0 <= gain.high or off < _AS_COMMANDED:
        within = "" if off < _AS_COMMANDED else f" to within {100.0 * off:.2g} %"
        return f"{does.format('the commanded')}{within}{bound}"
    percent = f"{100.0 * gain.value:.{1 if off < _NEAR else 0}f} %"
    return does.format(f"{percent} of the commanded") + bound


def _list_trust(model: "tl.RobotModel") -> Iterator[str]:
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
    first = tl.identify.list_unit_faults(model.axes)
    yield from (
        f"Doubt: {note}" if note in doubts else note for note in model.notes if note not in first
    )
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


def _name(axis: "tl.identify.AxisModel") -> str:
    """Return the name of an axis for the beginning of a sentence."""
    return tl.identify.NAMES[axis.axis].capitalize()


def _name_other(axis: "tl.identify.AxisModel") -> str:
    return tl.identify.NAMES["turn_rate" if axis.axis == "speed" else "speed"]


def _describe_axis(axis: "tl.identify.AxisModel") -> Iterator[str]:
    if not axis.is_known or axis.explained is None:
        return
    name = _name(axis)
    yield from _describe_fit(axis, axis.explained)
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
    if axis.drift is not None:
        rest = "Gain and limits are those without the drift."
        yield f"{name} drifts by {_show_limit(axis.drift)} at zero command. {rest}"


def _describe_fit(axis: "tl.identify.AxisModel", explained: float) -> Iterator[str]:
    """Yield how much of the motion the model explains, and whether it separates its delays."""
    name, share = _name(axis), f"{100.0 * explained:.0f} %"
    told = (
        f"{name}: the model explains {share} of the variance of {axis.steps} steps between poses."
    )
    if explained < _LITTLE:
        told += " Most changes of the motion do not follow from the commands."
    if axis.whiteness is not None and axis.whiteness < _CURVE:
        told += " The rest is a curve, not noise: the model lacks something."
    yield told
    # Dead time and time constant may each be 0, although their sum may not.
    parts, total = (axis.dead_time_s, axis.lag_s), axis.total_delay_s
    is_open = all(part is not None and part.low <= 0.0 for part in parts)
    if is_open and total is not None and total.low > 0.0:
        yield f"{name}: the log does not separate dead time from time constant, it shows their sum."


def _describe_acceleration(axis: "tl.identify.AxisModel") -> Iterator[str]:
    name = _name(axis)
    if axis.rate_limit is not None:
        places = {"before_lag": "before the lag", "within_lag": "within its velocity loop"}
        where = places.get(axis.limit_acts, "alone")
        yield f"{name} changes by at most {_show_limit(axis.rate_limit)}, {where}."
    if axis.jerk_time_s is not None:
        time_s = _show_limit(axis.jerk_time_s)
        yield f"{name}: its jerk is limited, so the acceleration reaches its limit within {time_s}."
    if axis.rate_limit_beside is not None:
        yield (
            f"The wheels limit the acceleration of both axes together: a {_name_other(axis)} that"
            f" changes by {_show_limit(axis.rate_limit_beside)} reaches this limit alone."
        )


def _describe_wheels(
    axis: "tl.identify.AxisModel", beside: "tl.identify.Estimate"
) -> Iterator[str]:
    name, other = tl.identify.NAMES[axis.axis], _name_other(axis)
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


def _show_limit(found: "tl.identify.Estimate") -> str:
    return f"{found.value:.3g} {found.unit} ({found.low:.3g} to {found.high:.3g})"


def _describe_second_order(axis: "tl.identify.AxisModel") -> Iterator[str]:
    """Yield text on a second order: two time constants, or an oscillation if that is certain."""
    product, lag, name = axis.lag_product_s2, axis.lag_s, _name(axis)
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


def _list_axes(model: "tl.RobotModel", *, shows_details: bool) -> Iterator[str]:
    """Yield why axes are not identified, with test drives; then second estimates of delays."""
    for axis in model.axes:
        if not axis.is_known:
            end = "" if axis.reason.endswith("?") else "."
            advice = f" To know it, {axis.advice}." if axis.advice else ""
            yield f"{_name(axis)}: not identifiable: {axis.reason}{end}{advice}"
    for axis in model.axes if shows_details else ():
        name, delay = _name(axis), axis.correlation_delay_s
        if not axis.is_known or axis.explained is None:
            continue
        if delay is None:
            yield f"{name}: {axis.correlation_reason}."
        else:  # where commands and motion correlate best
            low, high = (f"{1e3 * end:.0f}" for end in (delay.low, delay.high))
            yield f"{name}: commands and motion correlate best at a delay of {low} to {high} ms."


def _list_events(model: "tl.RobotModel") -> list[str]:
    """Return the outliers one by one; many of one axis are in one sentence."""
    said, often = [], []
    for axis in model.axes:
        found = [event for event in model.events if event.axis == axis.axis]
        if len(found) > _RARE * axis.steps:
            often.append(axis.axis)
            worst = max(found, key=lambda event: abs(event.size))
            said.append(
                f"{_name(axis)}: {len(found)} of {axis.steps} steps are off by far more than is"
                f" usual and do not count; the largest: {worst.text}."
            )
    rare = [event for event in model.events if event.axis not in often]
    said += [f"Outlier: {event.text}." for event in rare[:_MOST_EVENTS]]
    if len(rare) > _MOST_EVENTS:
        said.append(f"And {describe_count(len(rare) - _MOST_EVENTS, 'outlier')} more, in --json.")
    return said


def _list_nav2(known: "Sequence[tl.identify.AxisModel]") -> list[str]:
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
    model: "tl.RobotModel",
    files: Sequence[Path],
    reading: Sequence[str],
    scenario: Path | None,
    *,
    shows_details: bool,
) -> Iterator[str]:
    if scenario is not None:
        target, compared = (console.quote_file(scenario, *more) for more in ((), reading))
        yield f"Next: turtlelog theory {target}"
        yield f"Test it on a bag that it has not seen: turtlelog compare OTHER {compared}"
    elif model.tick_delays is not None:
        # `explain` takes one recording.
        if command := console.advise_explain(files[0], reading):
            yield f"Why? {command}"
    elif any(axis.is_known for axis in model.axes) and all(
        axis.is_known or axis.is_idle for axis in model.axes
    ):  # a scenario needs every commanded axis
        command = f"turtlelog identify {console.quote_file(*files, *reading)} --scenario robot.toml"
        yield f"Simulate it and find gains: {command}"
    if not shows_details and any(axis.is_known and axis.explained for axis in model.axes):
        more = "" if scenario is None else ", and the source of each number"
        yield f"A second opinion on the delays{more}: --details"
