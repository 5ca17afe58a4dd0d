"""How a replay of commands that were recorded without poses is answered."""

import shlex
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import turtlelog as tl
from turtlelog.cli.output import fill_lines, print_note
from turtlelog.cli.replay_answer import PoseAnswer
from turtlelog.cli.replay_choice import ReplayOptions
from turtlelog.cli.scenario_options import ScenarioOptions, change_scenario
from turtlelog.display import describe_count, format_short
from turtlelog.errors import UsageError
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.replay import CommandReplay


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
        duration_s: Time that the plant was driven [s].
        path_length_m: Length of its path [m].
        end: Its last pose [m, rad].
        wall_s: Time at which it met a wall of its world, from the first command [s]; None: never.
        output: The recording that was written; None without one.
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


def replay_commands(
    file: Path,
    run: "Run",
    mode: ReplayOptions,
    changes: ScenarioOptions | None,
    output: Path | None,
) -> tuple[CommandReplayAnswer, str]:
    """Drive a plant with the commands of a run without poses, and write where it went."""
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


def _require_of_commands(file: Path, mode: ReplayOptions) -> None:
    """Refuse what compares with recorded poses or samples."""
    given = {
        "--law": mode.law is not None,
        "--expect-equal": mode.expect_equal,
        "--tolerance": mode.tolerance is not None,
    }
    wrong = [name for name, is_given in given.items() if is_given]
    if wrong:
        raise UsageError(f"{wrong[0]}: leave it out, {file} holds commands alone: no poses")


def _format(file: Path, found: "CommandReplay", answer: CommandReplayAnswer) -> str:
    """Return how far the plant drives and where it ends, and what that does not tell."""
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
