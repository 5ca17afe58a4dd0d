"""Answers of replays through the plant: of runs, and of commands without poses."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import turtlelog as tl
from turtlelog.cli.output import build_table, fill_lines, fit_table, print_note
from turtlelog.cli.replay_answer import (
    GapAnswer,
    JumpAnswer,
    PoseAnswer,
    ReplayAnswer,
    RoundingAnswer,
    SegmentAnswer,
    build_difference,
    build_pose_error,
    tell_time,
)
from turtlelog.cli.scenario_options import ScenarioOptions, change_scenario
from turtlelog.display import describe_count, format_short
from turtlelog.errors import UsageError
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.cli.replay import ReplayOptions
    from turtlelog.replay import CommandReplay, Jump, PlantReplay


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantReplayAnswer(ReplayAnswer):
    """The recorded commands driven through the plant."""

    within_rounding: bool
    heading_bits: int | None
    commands: Mapping[str, Any]


def build_plant(file: Path, run: "Run", found: "PlantReplay") -> PlantReplayAnswer:
    """Return the answer."""
    return PlantReplayAnswer(
        file=str(file),
        name=found.name,
        mode="plant",
        samples=found.samples,
        max_abs_error=build_pose_error(found.max_abs_error),
        first_difference=build_difference(run, found.first_difference),
        within_rounding=found.within_rounding,
        heading_bits=found.heading_bits,
        stretches=tuple(
            SegmentAnswer(
                start_s=tell_time(run, segment.start_ns),
                end_s=tell_time(run, segment.end_ns),
                ticks=segment.ticks,
                max_abs_error=build_pose_error(segment.max_abs_error),
                rounding=RoundingAnswer(position=segment.rounding_m, heading=segment.rounding_rad),
                within_rounding=segment.within_rounding,
            )
            for segment in found.stretches
        ),
        jumps=tuple(
            JumpAnswer(
                at_s=tell_time(run, jump.at_ns),
                kind=jump.kind,
                from_pose=_build_pose(jump.from_pose),
                to_pose=_build_pose(jump.to_pose),
            )
            for jump in found.jumps
        ),
        gaps=tuple(
            GapAnswer(
                start_s=tell_time(run, gap.start_ns),
                end_s=tell_time(run, gap.end_ns),
                missing_ticks=gap.missing_ticks,
            )
            for gap in found.gaps
        ),
        commands=asdict(found.commands),
    )


def _build_pose(pose: "Sequence[float]") -> PoseAnswer:
    return PoseAnswer(x=pose[0], y=pose[1], heading=pose[2])


def format_plant(file: Path, run: "Run", found: "PlantReplay") -> str:
    """Return whether the plant reproduces the poses, with its segments and their breaks."""
    use = found.commands
    and_of_velocities = ", and of velocities used as recorded," if use.unexplained_ticks else ""
    stops = f"; the plant stopped by itself {use.stops} times" if use.stops else ""
    first, *judged = judge_rounding(found)
    sentences = [
        f"{escape_controls(file.name)}: {first[0].lower()}{first[1:]}",
        *judged,
        f"Commands: {use.taken} taken, {use.unseen} that no pose shows{stops}.",
        "Rounding: one step of the 32 bits of a pose, for other platforms."
        if tl.plants.find_plant(run).name == tl.plants.LAGGED
        else f"Rounding: the largest error that the 32 bits of a segment's first pose"
        f"{and_of_velocities} can cause.",
    ]
    if use.never_arrived:
        sentences.append(
            f"The transport lost {use.never_arrived} commands, as the events show: one that equals"
            " the command before it counts as taken."
        )
    if use.disturbed_ticks:
        sentences.append(
            f"In {use.disturbed_ticks} ticks a disturbance acts on the plant: its velocity shows no"
            " command there, and was used as recorded."
        )
    if unexplained := use.unexplained_ticks - use.disturbed_ticks:
        sentences.append(
            f"No recorded command explains {unexplained} ticks: the recorded velocity was used"
            " there."
        )
    start, end = (tl.compare.Column(title=title, unit="s", digits=3) for title in ("from", "to"))
    ways = ("x [m]", "y [m]", "heading [deg]", "rounding [m]", "rounding [deg]")
    rows = (
        (
            tell_time(run, segment.start_ns),
            tell_time(run, segment.end_ns),
            segment.ticks,
            segment.max_abs_error.x_m,
            segment.max_abs_error.y_m,
            degrees(segment.max_abs_error.heading_rad),
            segment.rounding_m,
            degrees(segment.rounding_rad),
        )
        for segment in found.stretches
    )
    title = f"Largest differences between the plant and {run.name}"
    parts = [
        fill_lines(sentences),
        "",
        fit_table(build_table(title, (start, end, "ticks", *ways), rows)),
    ]
    return "\n".join([*parts, *list_breaks(run, found)]).rstrip()


def judge_rounding(found: "PlantReplay") -> list[str]:
    """Return whether rounding explains the differences, and whose arithmetic was used."""
    beyond = sum(not stretch.within_rounding for stretch in found.stretches)
    if found.of_rounding == 0.0:
        sentences = ["The plant reproduces every pose."]
    elif not beyond:
        sentences = ["The largest difference is within what 32-bit poses can tell."]
    else:
        count = len(found.stretches)
        of_all = f", in {beyond} of {count} segments" if count > 1 else ""
        times = f"{found.of_rounding:.3g} times what 32-bit poses can tell"
        sentences = [f"The largest difference is {times}{of_all}."]
    if found.heading_bits == 32:
        sentences.append("This turtlesim kept its heading in 32 bits: it is older than Humble.")
    return sentences


def list_breaks(run: "Run", found: "PlantReplay") -> list[str]:
    """Return a line for each jump and gap, in order of time."""
    lines = [(jump.at_ns, _format_jump(jump)) for jump in found.jumps]
    lines += [
        (
            gap.start_ns,
            f"gap of {(gap.end_ns - gap.start_ns) / 1e9:.3f} s: {gap.missing_ticks} ticks",
        )
        for gap in found.gaps
    ]
    return [f"{tell_time(run, at_ns):.3f} s: {text}" for at_ns, text in sorted(lines)]


def _format_jump(jump: "Jump") -> str:
    to_x_m, to_y_m, to_rad = jump.to_pose
    place = f"x = {to_x_m:.3f} m, y = {to_y_m:.3f} m, heading {degrees(to_rad):.1f} deg"
    return f"jump ({jump.kind}) to {place}"


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReplayAnswer:
    """Motion of a plant that recorded commands drive.

    Attributes:
        file: Name of the file as given.
        name: Name of the run.
        mode: commands.
        plant: Plant that was driven: turtlesim, or lagged, a robot model.
        commands: Number of recorded commands.
        taken: Number of commands that the plant took.
        duration_s: Time for which the plant was simulated [s].
        path_length_m: Length of the plant's path [m].
        end: Last pose of the plant [m, rad].
        wall_s: Time at which the plant met a wall of its world, from the first command [s]; None:
            never.
        output: Written recording; None without a recording.
    """

    file: str
    name: str
    mode: str = "commands"
    plant: str
    commands: int
    taken: int
    duration_s: float
    path_length_m: float
    end: PoseAnswer
    wall_s: float | None
    output: str | None


def replay_commands_alone(
    file: Path,
    run: "Run",
    mode: "ReplayOptions",
    changes: ScenarioOptions | None,
    output: Path | None,
) -> tuple[CommandReplayAnswer, str]:
    """Drive a plant with the commands of a run without poses, and write the plant's path."""
    _require_of_commands(file, mode)
    scenario = tl.Scenario() if mode.scenario is None else tl.load_scenario(mode.scenario)
    found = tl.replay.drive_commands(run, change_scenario(scenario, changes))
    if output is not None:
        tl.write_recording(found.run, output)
        print_note(f"wrote {output}")
    x_m, y_m = map(float, found.run.poses.xy_m[-1])
    answer = CommandReplayAnswer(
        file=str(file),
        name=found.name,
        plant=found.plant,
        commands=len(run.commands),
        taken=found.taken,
        duration_s=(found.run.end_ns - found.run.start_ns) / 1e9,
        path_length_m=found.path_length_m,
        end=PoseAnswer(x=x_m, y=y_m, heading=float(found.run.poses.heading_rad[-1])),
        wall_s=found.wall_s,
        output=None if output is None else str(output),
    )
    return answer, _format(file, found, answer)


def _require_of_commands(file: Path, mode: "ReplayOptions") -> None:
    """Refuse options that compare with recorded poses or samples."""
    given = {"--law": mode.law, "--expect-equal": mode.expect_equal or None}
    for name, value in {**given, "--tolerance": mode.tolerance}.items():
        if value is not None:
            raise UsageError(f"{name}: leave it out, {file} holds commands alone: no poses")


def _format(file: Path, found: "CommandReplay", answer: CommandReplayAnswer) -> str:
    """Return the path length and the end of the plant, and the limits of this answer."""
    kind = "turtlesim" if found.plant == "turtlesim" else "the robot model"
    end, name = answer.end, escape_controls(file.name)
    sentences = [
        f"{name}: the commands drive {kind} {format_short(found.path_length_m, 'm')} in"
        f" {answer.duration_s:.3g} s, to x = {end.x:.4g} m, y = {end.y:.4g} m, heading"
        f" {degrees(end.heading or 0.0):.4g} deg.",
        f"Commands: {describe_count(answer.commands, 'command')}, {answer.taken} taken.",
    ]
    if found.wall_s is not None:
        sentences.append(
            f"At {found.wall_s:.3g} s it runs into a wall of turtlesim's world, 11 m wide: from"
            " there on a robot would drive elsewhere. A robot model has no walls: --scenario"
            " robot.toml, which turtlelog identify --scenario writes, or --scenario lagged."
        )
    sentences.append("No poses were recorded: nothing tells whether the robot went there.")
    lines = [fill_lines(sentences)]
    if answer.output is None:
        lines.append(f"Keep the path: turtlelog replay {shlex.quote(str(file))} -o path.mcap")
    else:
        lines.append(f"Next: turtlelog plot {shlex.quote(answer.output)} -o path.png")
    return "\n".join(lines)
