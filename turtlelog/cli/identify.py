"""`turtlelog identify`: a robot's gain, dead time and time constant."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.identify_answer import format_robot
from turtlelog.cli.options import Files, Json, Place, TopicOptions, read_runs, require_there
from turtlelog.cli.output import (
    EXIT_FAILED,
    EXIT_FINE,
    copy_fields,
    print_json,
    print_note,
    print_text,
    write_text,
)
from turtlelog.cli.targets import require_new_target, require_pictures

if TYPE_CHECKING:
    from turtlelog import RobotModel
    from turtlelog.identify import AxisModel, RobotScenario, TickDelays
    from turtlelog.run import Clock


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

    plot: Place | None = None
    rrd: Place | None = None
    scenario: Place | None = None


def identify(
    files: Files,
    /,
    *,
    written: WrittenOptions | None = None,
    details: bool = False,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> int:
    """Identify how a robot follows its commands: gain, dead time, time constant of each axis.

    Any log with commands and poses can be used: a bag of a real robot, or a recording. Each step
    between two poses is compared with the model's response to the commands (zero-order hold): rate
    = gain exp(-dead_time s) / (lag s + 1). Intervals contain the true value for 95 of 100 robots.
    Further models have a second time constant, a limit of acceleration or speed, a deadband,
    friction or a different gain backwards. A further model is accepted only if it changes a rate by
    2 % and predicts a held-back part of the log better. If no model explains the motion, intervals
    are wider and the output contains a doubt. If a parameter cannot be identified, the output gives
    the reason and suggests a test drive. Several files of one robot are fitted together, and
    differences between them are listed.

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
    written = written or WrittenOptions()
    plot, rrd, scenario = written.plot, written.rrd, written.scenario
    require_pictures(plot, rrd, files, drawn=files, of="file")
    require_new_target(scenario, files, suffix=".toml")
    require_there(files)
    runs = read_runs(files, topics)
    model = tl.identify_robot(runs)
    robot = None if scenario is None else tl.identify.build_robot_scenario(model, runs)
    if json:
        print_json(build_identify_answer(files, model, scenario, robot))
    else:
        print_text(
            format_robot(model, files, robot=robot, scenario=scenario, shows_details=details)
        )
    if scenario is not None and robot is not None:
        write_text(scenario, robot.text)
        print_note(f"wrote {scenario}")
    if plot is not None:
        tl.draw.write_robot_figure(model, runs[0], plot)
        print_note(f"wrote {plot}")
    if rrd is not None:
        tl.draw.write_robot_rrd(model, runs[0], rrd)
        print_note(f"wrote {rrd}")
    return EXIT_FINE if any(axis.is_known for axis in model.axes) else EXIT_FAILED


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisAnswer:
    """One axis, with the fields of `AxisModel`; a field is None if its value is not known."""

    axis: str
    status: str
    reason: str | None
    advice: str | None
    model: str
    gain: Interval | None
    dead_time_s: Interval | None
    lag_s: Interval | None
    total_delay_s: Interval | None
    lag_product_s2: Interval | None
    rate_limit: Interval | None
    limit_acts: str | None
    rate_limit_beside: Interval | None
    jerk_time_s: Interval | None
    bound: Interval | None
    bound_acts: str | None
    bound_beside: Interval | None
    deadband: Interval | None
    reverse_gain: Interval | None
    friction: Interval | None
    doubts: tuple[str, ...]
    correlation_delay_s: Interval | None
    correlation_reason: str | None
    silent_stops_s: tuple[float, ...]
    explained: float | None
    whiteness: float | None
    outliers: int
    steps: int
    steps_in_all: int
    changes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EventAnswer:
    """A place in the log that no command explains, with the fields of `RobotEvent`."""

    file: str
    axis: str
    time_s: float
    size: float
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioAnswer:
    """The written scenario, with the sources of its numbers."""

    file: str
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyAnswer:
    """A robot's dynamics."""

    files: list[str]
    clock: "Clock | None"
    axes: list[AxisAnswer]
    tick_delays: "TickDelays | None"
    events: list[EventAnswer]
    notes: tuple[str, ...]
    scenario: ScenarioAnswer | None


def build_identify_answer(
    files: Sequence[Path],
    model: "RobotModel",
    scenario: Path | None = None,
    robot: "RobotScenario | None" = None,
) -> IdentifyAnswer:
    """Return the answer as data."""
    written = None
    if robot is not None:
        written = ScenarioAnswer(file=str(scenario), notes=robot.notes)
    return IdentifyAnswer(
        files=[str(file) for file in files],
        clock=model.clock,
        axes=[_build_axis(axis) for axis in model.axes],
        tick_delays=model.tick_delays,
        events=[copy_fields(EventAnswer, event) for event in model.events],
        notes=model.notes,
        scenario=written,
    )


_MAY_BE_EMPTY: Final = ("reason", "advice", "limit_acts", "bound_acts", "correlation_reason")
"""Texts of an axis that are null in the answer if they are empty."""


def _build_axis(axis: "AxisModel") -> AxisAnswer:
    from turtlelog.identify import Estimate

    texts = {name: getattr(axis, name) or None for name in _MAY_BE_EMPTY}
    found = {one.name: getattr(axis, one.name) for one in fields(axis)}
    intervals = {
        name: copy_fields(Interval, value)
        for name, value in found.items()
        if isinstance(value, Estimate)
    }
    return copy_fields(AxisAnswer, axis, **texts, **intervals)
