"""`turtlelog replay`: replay of a recording."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.check_answers import build_results, format_results
from turtlelog.cli.options import (
    Json,
    Output,
    Place,
    TopicOptions,
    choose_step_budget,
    name_as_typed,
    read_runs,
    require_there,
)
from turtlelog.cli.output import EXIT_FAILED, EXIT_FINE, print_json, print_note, print_verdicts
from turtlelog.cli.replay_answer import (
    ReplayAnswer,
    answer_law_replay,
    build_loop,
    format_law,
    format_loop,
)
from turtlelog.cli.replay_choice import ReplayOptions, choose_replayed, require_sound, settle_file
from turtlelog.cli.replay_plant import (
    CommandReplayAnswer,
    build_plant,
    format_plant,
    replay_commands_alone,
)
from turtlelog.cli.scenario_options import ScenarioOptions
from turtlelog.cli.targets import require_new_target

if TYPE_CHECKING:
    from turtlelog import Run, Scenario
    from turtlelog.replay import LawReplay, LoopReplay, PlantReplay


_Answer = tuple[ReplayAnswer, str, "LawReplay | LoopReplay | PlantReplay"]
"""The answer as data and as text, and the replay itself."""


def replay(
    file: Annotated[Place | None, Parameter(name="FILE")] = None,
    /,
    *,
    mode: ReplayOptions | None = None,
    changes: ScenarioOptions | None = None,
    output: Output = None,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> int:
    """Replay a recording and show where the result departs from it.

    By default, the recorded scenario is simulated again in closed loop, with the changes of --set,
    and compared tick by tick and sample by sample. With --law, a law computes commands for the
    recorded poses, and these are compared. With --plant, the recorded commands drive a simulated
    turtlesim, or the robot model of the recording. Times count from the first sample, or from the
    first pose without samples. The commands of a bag without poses drive turtlesim, or the robot
    model of --scenario.

    A law of your own is code. This command executes the code of --law FILE:Class, of --set
    law.kind=FILE:Class, and of a law in a scenario file that you name. The code of a law that only
    the recording names runs only with --trust-law.

    Example: turtlelog replay kp10.mcap --set loop.queue_policy=newest

    The exit code is 0 even if there are differences. With --expect-equal, the answer ends with a
    verdict PASS or FAIL, and the exit code is 1 for FAIL.

    Args:
        file: A recording (.mcap), a ROS 2 bag of turtlesim or of commands alone, or a log of the
            paper.
        output: Write the run of the closed loop, or the path simulated from a bag of commands
            alone, to this .mcap file.
        json: Print one JSON object instead of tables.
    """
    require_there([] if file is None else [file])
    mode = mode or ReplayOptions()
    require_sound(mode, changes, output)
    file, kind = settle_file(file, mode)
    require_new_target(output, [file], suffix=".mcap")
    (run,) = read_runs([file], topics, allow_no_poses=True)
    with name_as_typed(file, run):
        if not len(run.poses):
            _print(*replay_commands_alone(file, run, mode, changes, output), json=json)
            return EXIT_FINE
        if mode.plant:
            answer, text, found = _replay_plant(file, run)
        else:
            scenario = choose_replayed(run, mode, changes, kind)
            replay_as = _replay_loop if mode.law is None else _replay_law
            answer, text, found = replay_as(file, run, scenario, mode, output)
    failed = False
    if mode.expect_equal:
        from turtlelog.check.judge_difference import judge_replay

        results = judge_replay(run, found, file=str(file))
        verdict = tl.check.join_verdicts(results)
        failed = verdict == "FAIL"
        answer = replace(answer, verdict=verdict.value, results=build_results(results))
        text = f"{text}\n\n{format_results(results, files=1)}"
    _print(answer, text, json=json)
    return EXIT_FAILED if failed else EXIT_FINE


def _print(answer: ReplayAnswer | CommandReplayAnswer, text: str, *, json: bool) -> None:
    if json:
        print_json(answer)
    else:
        print_verdicts(text)


def _replay_plant(file: Path, run: "Run") -> _Answer:
    found = tl.replay_plant(run)
    return build_plant(file, run, found), format_plant(file, run, found), found


def _replay_law(
    file: Path, run: "Run", scenario: "Scenario | None", mode: ReplayOptions, _: Path | None
) -> _Answer:
    found = tl.replay_law(
        run,
        scenario,
        tolerance=mode.tolerance or 0.0,
        trust_law=mode.trust_law,
        step_budget_s=choose_step_budget(mode.step_budget_ms),
    )
    return (
        answer_law_replay(file, run, found),
        format_law(file, run, found, details=mode.details),
        found,
    )


def _replay_loop(
    file: Path, run: "Run", scenario: "Scenario | None", mode: ReplayOptions, output: Path | None
) -> _Answer:
    found = tl.replay_loop(
        run,
        scenario,
        tolerance=mode.tolerance or 0.0,
        trust_law=mode.trust_law,
        step_budget_s=choose_step_budget(mode.step_budget_ms),
    )
    if output is not None:
        tl.write_recording(found.run, output)
        print_note(f"wrote {output}")
    text = format_loop(file, run, found, details=mode.details)
    return build_loop(file, run, found, output), text, found
