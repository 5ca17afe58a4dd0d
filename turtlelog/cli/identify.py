"""`turtlelog identify`: a robot's dead time, lag and gain."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.options import Files, Json, Place, TopicOptions, read_runs
from turtlelog.cli.output import format_table, print_json, print_note, print_text
from turtlelog.cli.targets import require_new_target, require_pictures
from turtlelog.display import describe_count

if TYPE_CHECKING:
    from turtlelog import RobotModel
    from turtlelog.identify import AxisModel, Estimate, RobotScenario

_NAMES: Final = {"speed": "speed", "turn_rate": "turn rate"}
_NAV2: Final = {"speed": "model_delay_vx", "turn_rate": "model_delay_wz"}
"""What Nav2's MPPI controller calls the delay of each axis [s]."""

_VALUES: Final = ("gain", "dead_time_s", "lag_s", "total_delay_s")
_MOST_EVENTS: Final = 5
_RARE: Final = 0.01
"""Share of the steps; where more are off, it is not by single faults, such as a jump."""


_WHOLE_MS: Final = 10.0
"""Width of an interval above which tenths of a millisecond tell nothing [ms]."""

_CURVE: Final = 0.5
"""Whiteness below which the residual is a curve: neighbours share half of what they are off."""

_LITTLE: Final = 0.5
"""Explained share below which most of the motion's changes are not those of the commands."""


def identify(
    files: Files,
    /,
    *,
    plot: Place | None = None,
    rrd: Place | None = None,
    scenario: Place | None = None,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Say how a robot follows its commands: gain, dead time and lag of each axis.

    Any log with commands and poses will do: a bag of a real robot, or a recording. Each step
    between two poses is compared with the response to the commands, which hold until the next one:
    rate = gain exp(-dead_time s) / (lag s + 1). Intervals hold the truth in 95 of 100 robots. A
    second lag, or a limit of the acceleration, must change a rate by 2 % and predict a part of the
    log that was held back better. What the log does not tell has no value, but a reason, and what
    to drive instead. Of several files of one robot all are fitted together, and what differs
    between them is told.

    Turtlesim needs no fit: each of its poses tells which command its tick took.

    Example: turtlelog identify robot_bag

    Example: turtlelog identify robot_bag --scenario robot.toml

    With --scenario the robot becomes a scenario whose plant is `lagged`: `run` simulates it,
    `theory` recommends gains, `compare` sets it beside a bag. Comments in the file, and sentences
    of the answer, say where each number comes from. An axis that is commanded and not identifiable
    is refused.

    Delays are between the times of commands and those of poses. Where poses are timed by their
    stamps, the transport of the fastest message remains in them.

    Args:
        files: Bags, recordings or logs of one robot.
        plot: Draw command, motion, model and residual into this .pdf, .png or .svg file.
        rrd: Write the same as a Rerun recording (.rrd).
        scenario: Write the robot as a scenario to this .toml file, to be simulated and given gains.
        json: Print one JSON object instead of tables.
    """
    require_pictures(plot, rrd, files, drawn=files, of="file")
    require_new_target(scenario, files, suffix=".toml")
    runs = read_runs(files, topics)
    model = tl.identify_robot(runs)
    robot = None if scenario is None else tl.identify.build_robot_scenario(model, runs)
    if json:
        print_json(describe_robot(files, model) | _describe_scenario(scenario, robot))
    else:
        print_text(format_robot(model) + _format_scenario(robot))
    if scenario is not None and robot is not None:
        _write_scenario(robot, scenario)
    if plot is not None:
        tl.show.write_robot_figure(model, runs[0], plot)
        print_note(f"wrote {plot}")
    if rrd is not None:
        tl.show.write_robot_rrd(model, runs[0], rrd)
        print_note(f"wrote {rrd}")


def _write_scenario(robot: "RobotScenario", path: Path) -> None:
    from turtlelog.log.complete_files import replace_when_complete

    with replace_when_complete(path) as temporary:
        temporary.write_text(robot.text, encoding="utf-8")
    print_note(f"wrote {path}")


def _describe_scenario(path: Path | None, robot: "RobotScenario | None") -> dict[str, Any]:
    if robot is None:
        return {"scenario": None}
    return {"scenario": {"file": str(path), "notes": [*robot.notes]}}


def _format_scenario(robot: "RobotScenario | None") -> str:
    if robot is None:
        return ""
    lines = [line for note in robot.notes for line in wrap(f"- {note}", 95, subsequent_indent="  ")]
    return "\n".join(["", "", "The scenario:", *lines])


def describe_robot(files: Sequence[Path], model: "RobotModel") -> dict[str, Any]:
    """Return the JSON answer."""
    return {
        "files": [str(file) for file in files],
        "clock": None if model.clock is None else asdict(model.clock),
        "axes": [_describe_axis(axis) for axis in model.axes],
        "tick_delays": None if model.tick_delays is None else asdict(model.tick_delays),
        "events": [asdict(event) | {"text": event.text} for event in model.events],
        "notes": [*model.notes],
    }


def _describe_axis(axis: "AxisModel") -> dict[str, Any]:
    estimates = (*_VALUES, "lag_product_s2", "rate_limit", "correlation_delay_s")
    told: dict[str, Any] = {
        "axis": axis.axis,
        "status": axis.status,
        "reason": axis.reason or None,
        "advice": axis.advice or None,
        "model": axis.model,
    }
    for name in estimates:
        found = getattr(axis, name)
        told[name] = (
            None if found is None else {"value": found.value, "low": found.low, "high": found.high}
        )
    others = (
        "explained",
        "whiteness",
        "outliers",
        "steps",
        "steps_in_all",
        "changes",
    )
    told["correlation_reason"] = axis.correlation_reason or None
    told["silent_stops_s"] = [*axis.silent_stops_s]
    return told | {name: getattr(axis, name) for name in others}


def format_robot(model: "RobotModel") -> str:
    """Return a table of values, and sentences."""
    rows = [
        (_NAMES[axis.axis], *(format_value(getattr(axis, name), name) for name in _VALUES))
        for axis in model.axes
    ]
    name = model.files[0] if len(model.files) == 1 else f"{len(model.files)} runs of one robot"
    heads = ("axis", "gain [1]", "dead time [ms]", "lag [ms]", "dead time + lag [ms]")
    sentences = [text for axis in model.axes for text in _tell_axis(axis)]
    if model.tick_delays is not None:
        delays = model.tick_delays
        sentences.append(
            f"Dead time of {delays.shown} commands: least {1e3 * delays.least_s:.1f} ms, median"
            f" {1e3 * delays.median_s:.1f} ms, largest {1e3 * delays.largest_s:.1f} ms."
        )
    table = tl.compare.Table(
        title=f"{name}: values and intervals of 95 %",
        columns=tuple(tl.compare.Column(title=title) for title in heads),
        rows=tuple(rows),
        notes=(*sentences, *_tell_clock(model), *model.notes, *_tell_events(model)),
    )
    return "\n".join([format_table(table).rstrip("\n"), *_format_nav2(model)])


def format_value(found: "Estimate | None", name: str) -> str:
    """Return a value with its interval, delays in ms; `-` for none."""
    if found is None:
        return "-"
    if name == "gain":
        return f"{found.value:.3f} ({found.low:.3f} to {found.high:.3f})"
    value, low, high = (1e3 * number for number in (found.value, found.low, found.high))
    digits = 0 if high - low > _WHOLE_MS else 1
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def _tell_axis(axis: "AxisModel") -> list[str]:
    name = _NAMES[axis.axis].capitalize()
    if not axis.is_known:
        end = "" if axis.reason.endswith("?") else "."
        return [f"{name}: not identifiable: {axis.reason}{end} To know it, {axis.advice}."]
    if axis.explained is None:
        return []
    told = [
        f"{name}: the model explains {100.0 * axis.explained:.0f} % of the variance of"
        f" {axis.steps} steps between poses.{_tell_residual(axis)}",
        _tell_correlation(axis),
        *_tell_second_order(axis),
    ]
    if axis.rate_limit is not None:
        limit = axis.rate_limit
        told.append(
            f"{name} changes by at most {limit.value:.3g} {limit.unit} ({limit.low:.3g} to"
            f" {limit.high:.3g})."
        )
    return told


def _tell_correlation(axis: "AxisModel") -> str:
    """Return at which delays commands and motion correlate best, or why that says nothing."""
    delay = axis.correlation_delay_s
    if delay is None:
        return f"{_NAMES[axis.axis].capitalize()}: {axis.correlation_reason}."
    low, high = (f"{1e3 * end:.0f}" for end in (delay.low, delay.high))
    return (
        f"{_NAMES[axis.axis].capitalize()}: commands and motion correlate best at a delay of {low}"
        f" to {high} ms."
    )


def _tell_second_order(axis: "AxisModel") -> list[str]:
    """Return what a second order is like: two lags, or an oscillation where it surely is one."""
    product, lag, name = axis.lag_product_s2, axis.lag_s, _NAMES[axis.axis].capitalize()
    if product is None or lag is None:
        return []
    equal = 0.25 * lag.value**2
    if product.low > equal:
        damping = math.sqrt(equal / product.value)
        return [f"{name} is of second order and oscillates: its damping ratio is {damping:.2f}."]
    if product.high > equal:
        half_ms = 500.0 * lag.value
        return [f"{name} is of second order, with two time constants of about {half_ms:.0f} ms."]
    return [
        f"{name} is of second order: the lag is the sum of two time constants. Their product is"
        f" {product.value:.3g} s^2 ({product.low:.3g} to {product.high:.3g})."
    ]


def _tell_residual(axis: "AxisModel") -> str:
    told = []
    if axis.explained is not None and axis.explained < _LITTLE:
        told.append("most of what changes in the motion does not follow from the commands")
    if axis.whiteness is not None and axis.whiteness < _CURVE:
        told.append("what is left is a curve, not noise: the model lacks something")
    return f" Note: {'; '.join(told)}." if told else ""


def _tell_clock(model: "RobotModel") -> list[str]:
    clock = model.clock
    if clock is None or not any(axis.is_known for axis in model.axes):
        return []
    if clock.used == "log":
        return ["Poses are timed by when the recorder received them: transport is in the delays."]
    return [
        "Poses are timed by their stamps: the delays hold the transport of the fastest message,"
        " which no log tells."
    ]


def _tell_events(model: "RobotModel") -> list[str]:
    """Return the outliers one by one, those of an axis that has many in one sentence."""
    told, often = [], []
    for axis in model.axes:
        found = [event for event in model.events if event.axis == axis.axis]
        if len(found) > _RARE * axis.steps:
            often.append(axis.axis)
            worst = max(found, key=lambda event: abs(event.size))
            told.append(
                f"{_NAMES[axis.axis].capitalize()}: {len(found)} of {axis.steps} steps are off by"
                f" far more than is usual and do not count; the largest: {worst.text}."
            )
    rare = [event for event in model.events if event.axis not in often]
    told += [f"Outlier: {event.text}." for event in rare[:_MOST_EVENTS]]
    if len(rare) > _MOST_EVENTS:
        told.append(f"And {describe_count(len(rare) - _MOST_EVENTS, 'outlier')} more, in --json.")
    return told


def _format_nav2(model: "RobotModel") -> list[str]:
    """Return what to paste into Nav2; its model is a pure delay, so the lag counts as delay."""
    lines = [
        f"  {_NAV2[axis.axis]}: {axis.total_delay_s.value:.3f}"
        for axis in model.axes
        if axis.total_delay_s is not None
    ]
    if not lines:
        return []
    return ["", "For Nav2's MPPI controller, dead time and lag as one delay [s]:", *lines]
