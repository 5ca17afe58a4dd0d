"""`turtlelog replay`: replay of a recording."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.check_answers import build_results, format_results
from turtlelog.cli.options import (
    Json,
    Output,
    Place,
    StepBudgetMs,
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
from turtlelog.cli.replay_plant import (
    CommandReplayAnswer,
    build_plant,
    format_plant,
    replay_commands_alone,
)
from turtlelog.cli.scenario_options import ScenarioOptions, change_scenario, name_by_changes
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import UsageError
from turtlelog.files.urls import make_path

if TYPE_CHECKING:
    from turtlelog import Run, Scenario
    from turtlelog.replay import LawReplay, LoopReplay, PlantReplay


_OF_LAW: Final = ("law", "shaping", "limits", "goal")
"""Tables of a scenario that have an effect if poses are given."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """Options for the kind of replay, and for judging the result.

    Attributes:
        plant: Simulate the plant with the recorded commands.
        details: Print every signal with its largest difference.
        law: Compute a law's commands for the recorded poses: the recorded law, or KIND, which is a
            built-in kind, path.py:Class or package.module:Class.
        scenario: Preset or scenario file to use instead of the recorded scenario. The part of a
            scenario that a log contains is kept.
        tolerance: Largest difference that counts as equal, in the signal's unit [m, rad, m/s,
            rad/s].
        expect_equal: Exit with code 1 if there is a difference.
        trust_law: Run the code of the law that the recording names, if it is not built in.
        step_budget_ms: End the replay if the law computes longer than this in one step (wall-clock
            time). Default: 10000. Unit: ms. Without the option, built-in laws have no limit.
    """

    plant: bool = False
    details: bool = False
    law: Annotated[list[str] | None, Parameter(consume_multiple=(0, 2), metavar="[KIND]")] = None
    scenario: str | None = None
    tolerance: float | None = None
    expect_equal: bool = False
    trust_law: bool = False
    step_budget_ms: StepBudgetMs = None


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
    _require_sound(mode, changes, output)
    file, kind = _settle_file(file, mode)
    require_new_target(output, [file], suffix=".mcap")
    (run,) = read_runs([file], topics, allow_no_poses=True)
    with name_as_typed(file, run):
        if not len(run.poses):
            _print(*replay_commands_alone(file, run, mode, changes, output), json=json)
            return EXIT_FINE
        if mode.plant:
            found: LawReplay | LoopReplay | PlantReplay
            found = driven = tl.replay_plant(run)
            answer: ReplayAnswer = build_plant(file, run, driven)
            text = format_plant(file, run, driven)
        else:
            scenario = _choose_replayed(run, mode, changes, kind)
            answer, text, found = _replay(file, run, scenario, mode, output)
    failed = False
    if mode.expect_equal:
        from turtlelog.check.reference import judge_replay

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


def _replay(
    file: Path, run: "Run", scenario: "Scenario | None", mode: ReplayOptions, output: Path | None
) -> "tuple[ReplayAnswer, str, LawReplay | LoopReplay]":
    """Replay a run through a law or in closed loop, and write the run of the closed loop."""
    settings: dict[str, Any] = {
        "tolerance": mode.tolerance or 0.0,
        "trust_law": mode.trust_law,
        "step_budget_s": choose_step_budget(mode.step_budget_ms),
    }
    if mode.law is not None:
        by_law = tl.replay_law(run, scenario, **settings)
        text = format_law(file, run, by_law, details=mode.details)
        return answer_law_replay(file, run, by_law), text, by_law
    found = tl.replay_loop(run, scenario, **settings)
    if output is not None:
        tl.write_recording(found.run, output)
        print_note(f"wrote {output}")
    text = format_loop(file, run, found, details=mode.details)
    return build_loop(file, run, found, output), text, found


def _settle_file(file: Path | None, options: ReplayOptions) -> tuple[Path, str | None]:
    """Return the recording, and the law that replaces the recorded one.

    A word after --law is its KIND. The last word is FILE if there is no other word.
    """
    words = list(options.law or ())
    if file is None and words:
        file = make_path(words.pop())
    if file is None:
        raise UsageError("replay needs a recording: turtlelog replay FILE")
    if len(words) > 1:
        raise UsageError(f"--law: takes one KIND, not {' '.join(words)}")
    return file, words[0] if words else None


def _require_sound(
    options: ReplayOptions, changes: ScenarioOptions | None, output: Path | None
) -> None:
    """Refuse options that cannot be combined."""
    by_law = options.law is not None
    if options.plant and by_law:
        raise UsageError("--plant and --law: choose one")
    if (options.plant or by_law) and output is not None:
        mode = "--plant" if options.plant else "--law"
        raise UsageError(f"--output: leave out {mode}, which makes no run")
    given = {
        "--scenario": options.scenario,
        "--tolerance": options.tolerance,
        "--trust-law": options.trust_law or None,
        "--step-budget-ms": options.step_budget_ms,
        **_name_changes(changes),
    }
    wrong = [name for name, value in given.items() if value is not None]
    if options.plant and wrong:
        raise UsageError(
            f"--plant: leave out {wrong[0]}; the recorded commands are used as they are"
        )


def _choose_replayed(
    run: "Run", options: ReplayOptions, changes: ScenarioOptions | None, kind: str | None
) -> "Scenario | None":
    """Return the scenario to replay; None for the unchanged scenario of the recording."""
    if options.law is not None:
        _require_keys_of_law(changes)
    if changes is None and kind is None and options.scenario is None:
        return None
    named = kind or _find_named_law(changes)
    if named is not None:
        run = _replace_law(run, named)
    scenario = _find_base(run, options.scenario)
    if kind is not None:
        scenario = tl.override_scenario(scenario, {"law.kind": kind}, source="--law")
    # Without a given law, the recording's declaration is used, so that no code runs.
    declared = run.declaration if named is None and options.scenario is None else None
    changed = change_scenario(scenario, changes, declared)
    said = [] if options.scenario is None else [f"as {Path(options.scenario).stem}"]
    return name_by_changes(changed, run.name, changes, *said)


def _find_base(run: "Run", name_or_path: str | None) -> "Scenario":
    """Return the scenario before any change."""
    if name_or_path is None:
        return tl.scenario.restore_scenario(run)
    base = tl.load_scenario(name_or_path)
    if run.scenario_is_complete:
        return base
    base = tl.scenario.resolve_scenario(base)
    completed = tl.scenario.complete_scenario(run, base)
    _print_conflicts(completed, base, name_or_path)
    return completed


def _find_named_law(changes: ScenarioOptions | None) -> str | None:
    """Return the law in --set, so that the recorded law is not checked if --set replaces it."""
    if changes is None:
        return None
    kind = tl.scenario.parse_assignments(changes.assignments or (), source="--set").get("law.kind")
    return kind if isinstance(kind, str) else None


def _replace_law(run: "Run", kind: str) -> "Run":
    """Return a run without data of its law of another kind, which may be impossible to load."""
    if run.parameters.get("law.kind") in (None, kind):
        return run
    kept = {key: value for key, value in run.parameters.items() if not key.startswith("law.")}
    return replace(run, parameters=kept)


def _print_conflicts(completed: "Scenario", base: "Scenario", name: str) -> None:
    was = tl.scenario.flatten_scenario(base)
    kept = [
        f"{key} = {value} ({was.get(key, 'none')})"
        for key, value in tl.scenario.flatten_scenario(completed).items()
        if value != was.get(key)
    ]
    if kept:
        print_note(f"known from the log itself (in {name}): {', '.join(kept)}")


def _require_keys_of_law(changes: ScenarioOptions | None) -> None:
    for key in tl.scenario.parse_assignments(
        (changes and changes.assignments) or (), source="--set"
    ):
        if key.partition(".")[0] not in _OF_LAW:
            raise UsageError(
                f"--set {key}: must be a key of {', '.join(_OF_LAW)}, because --law takes the poses"
                " from the recording"
            )


def _name_changes(changes: ScenarioOptions | None) -> dict[str, object]:
    if changes is None:
        return {}
    given: dict[str, object] = {"--commands": changes.commands}
    return given | {"--kp": changes.kp, "--goal": changes.goal, "--set": changes.assignments}
