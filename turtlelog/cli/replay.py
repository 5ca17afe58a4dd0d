"""`turtlelog replay`: replay of a recording."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.check_answers import format_results
from turtlelog.cli.replay_answer import (
    CommandReplayAnswer,
    LawReplayAnswer,
    LoopReplayAnswer,
    MetricChange,
    PoseAnswer,
    ReplayAnswer,
    answer_law_replay,
    build_loop,
    build_plant,
    format_plant,
    tell_time,
)
from turtlelog.cli.scenario import ScenarioOptions, change_scenario, choose_replayed
from turtlelog.display import describe_count, format_pair, format_short, show_angle
from turtlelog.errors import UsageError
from turtlelog.escapes import escape_controls
from turtlelog.files.urls import make_path
from turtlelog.run.stop_reasons import find_goal_end

if TYPE_CHECKING:
    from turtlelog import Run, Scenario


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
    scenario: Annotated[str | None, Parameter(metavar="SCENARIO")] = None
    tolerance: Annotated[float | None, Parameter(metavar="DIFFERENCE")] = None
    expect_equal: bool = False
    trust_law: bool = False
    step_budget_ms: options.StepBudgetMs = None


def replay(
    file: Annotated[options.Place | None, Parameter(name="FILE")] = None,
    /,
    *,
    mode: ReplayOptions = ReplayOptions(),
    changes: ScenarioOptions = ScenarioOptions(),
    output: options.Output = None,
    topics: options.TopicOptions = options.TopicOptions(),
    json: options.Json = False,
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
    options.require_there([] if file is None else [file])
    _require_sound(mode, changes, output)
    # A word after --law is its KIND. The last word is FILE if there is no other word.
    words = [*(mode.law or ())]
    file = make_path(words.pop()) if file is None and words else file
    if file is None:
        raise UsageError("replay needs a recording: turtlelog replay FILE")
    if len(words) > 1:
        raise UsageError(f"--law: takes one KIND, not {' '.join(words)}")
    options.require_new_target(output, [file], suffix=".mcap")
    (run,) = options.read_runs([file], topics, allow_no_poses=True)
    with options.name_as_typed(file, run):
        if not len(run.poses):
            words = options.list_option_words(mode, changes, topics)
            _print(*_replay_commands(file, run, mode, changes, output, words), json=json)
            return console.EXIT_FINE
        if mode.plant:
            found: tl.replay.LawReplay | tl.replay.LoopReplay | tl.replay.PlantReplay
            found = driven = tl.replay_plant(run)
            answer: ReplayAnswer = build_plant(file, run, driven)
            text = format_plant(file, run, driven)
        else:
            keeps_poses = mode.law is not None
            changed = choose_replayed(
                run, changes, *words, base=mode.scenario, keeps_poses=keeps_poses
            )
            answer, text, found = _replay(file, run, changed, mode, output)
    failed = False
    if mode.expect_equal:
        from turtlelog.check.reference import judge_replay

        results = judge_replay(run, found, file=str(file))
        verdict = tl.check.join_verdicts(results)
        failed = verdict == "FAIL"
        answer = replace(answer, verdict=verdict.value, results=results)
        text = f"{text}\n\n{format_results(results, files=1)}"
    _print(answer, text, json=json)
    return console.EXIT_FAILED if failed else console.EXIT_FINE


def _print(answer: ReplayAnswer | CommandReplayAnswer, text: str, *, json: bool) -> None:
    if json:
        console.print_json(answer)
    else:
        console.print_verdicts(text)


def _replay(
    file: Path,
    run: "Run",
    changed: "tuple[Scenario, str] | None",
    mode: ReplayOptions,
    output: Path | None,
) -> "tuple[ReplayAnswer, str, tl.replay.LawReplay | tl.replay.LoopReplay]":
    """Replay a run through a law or in closed loop, and write the run of the closed loop."""
    settings: dict[str, Any] = {
        "tolerance": mode.tolerance or 0.0,
        "trust_law": mode.trust_law,
        "step_budget_s": options.choose_step_budget(mode.step_budget_ms),
    }
    scenario, change = changed or (None, "")
    if mode.law is not None:
        by_law = tl.replay_law(run, scenario, **settings)
        of_law = answer_law_replay(file, run, by_law)
        return of_law, _format_law(run, by_law, of_law, details=mode.details), by_law
    found = tl.replay_loop(run, scenario, **settings)
    console.write_asked(output, lambda path: tl.write_recording(found.run, path))
    answer = build_loop(file, run, found, output)
    return answer, _format_loop(run, found, answer, change, details=mode.details), found


def _replay_commands(
    file: Path,
    run: "Run",
    mode: ReplayOptions,
    changes: ScenarioOptions,
    output: Path | None,
    words: Sequence[str],
) -> tuple[CommandReplayAnswer, str]:
    """Drive a plant with the commands of a run without poses, and write the plant's path.

    `words` are the given options.
    """
    compared = {"--law": mode.law, "--expect-equal": mode.expect_equal}
    advice = f"leave it out, {file} holds commands alone: no poses"
    options.refuse_given({**compared, "--tolerance": mode.tolerance}, advice)
    scenario = tl.Scenario() if mode.scenario is None else tl.load_scenario(mode.scenario)
    found = tl.replay.drive_commands(run, change_scenario(scenario, changes))
    console.write_asked(output, lambda path: tl.write_recording(found.run, path))
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
    return answer, _format_commands(file, found, answer, words)


def _format_commands(
    file: Path,
    found: "tl.replay.CommandReplay",
    answer: CommandReplayAnswer,
    words: Sequence[str],
) -> str:
    plant = tl.plants.find_plant(found.run)
    kind = "the robot model" if plant.dynamics == "first-order" else plant.name
    end, name = answer.end, escape_controls(file.name)
    sentences = [
        f"{name}: the commands drive {kind} {format_short(found.path_length_m, 'm')} in"
        f" {answer.duration_s:.3g} s, to x = {end.x:.4g} m, y = {end.y:.4g} m, heading"
        f" {degrees(end.heading or 0.0):.4g} deg.",
        f"Commands: {describe_count(answer.commands, 'command')}, {answer.taken} taken.",
    ]
    if found.wall_s is not None:
        sentences.append(
            f"At {found.wall_s:.3g} s it runs into a wall of {plant.name}'s world,"
            f" {plant.high_m - plant.low_m:.0f} m wide: from"
            " there on a robot would drive elsewhere. A robot model has no walls: --scenario"
            " robot.toml, which turtlelog identify --scenario writes, or --scenario lagged."
        )
    sentences.append("No poses were read: nothing tells whether the robot went there.")
    following = f"Keep the path: turtlelog replay {console.quote_file(file, *words)} -o path.mcap"
    if answer.output is not None:
        following = f"Next: turtlelog plot {console.quote_file(answer.output)} -o path.png"
    return console.fill_lines([*sentences, following])


def _require_sound(mode: ReplayOptions, changes: ScenarioOptions, output: Path | None) -> None:
    if mode.plant and mode.law is not None:
        raise UsageError("--plant and --law: choose one")
    given_mode = "--plant" if mode.plant else "--law"
    if mode.plant or mode.law is not None:
        options.refuse_given({"--output": output}, f"leave out {given_mode}, which makes no run")
    given = {
        "--scenario": mode.scenario,
        "--tolerance": mode.tolerance,
        "--trust-law": mode.trust_law or None,
        "--step-budget-ms": mode.step_budget_ms,
        "--commands": changes.commands,
        "--kp": changes.kp,
        "--goal": changes.goal,
        "--set": changes.assignments,
    }
    wrong = [name for name, value in given.items() if value is not None]
    if mode.plant and wrong:
        raise UsageError(
            f"--plant: leave out {wrong[0]}; the recorded commands are used as they are"
        )


def _describe_software(run: "Run", changes: "Sequence[tl.run.SoftwareChange]") -> list[str]:
    """Return whether a run and its replay come from the same software, if the file shows this."""
    if not run.simulated_by:
        return []
    if [one.name for one in changes] == [tl.run.LAW]:
        return ["The code of the law is not the recorded one."]
    if changes:
        return [f"Recorded and replayed by different software: {tl.run.describe_changes(changes)}."]
    return [f"Recorded and replayed by {tl.run.describe_software(run.simulated_by)}."]


def _format_law(
    run: "Run", found: "tl.replay.LawReplay", answer: LawReplayAnswer, *, details: bool
) -> str:
    law, first = escape_controls(found.scenario.law.kind), found.first_difference
    if first is None:
        head = f"{law} commands what was recorded{_describe_slack(found.signals)}"
    else:
        head = f"{law} departs in {_format_difference(run, first, found.signals)}"
    lines = [f"{escape_controls(Path(answer.file).name)}: {head}."]
    command = found.first_command_difference
    if command is not None and command != first:
        lines.append(f"First command: {_format_difference(run, command, found.signals)}.")
    if first is not None:
        differing = [one.signal for one in found.signals if one.differing]
        differing = [name for name in differing if name.startswith("command_")]
        published = "are the law's"
        if differing:
            published = f"differ from the law's in {', '.join(differing)}"
        elif found.commands is not None or "command_speed" in found.absent:
            published = "are not one per sample, and are not compared"
        lines.append(f"The commands as published {published}.")
        others = {"Published command": found.commands, "The end": found.stop}
        lines += [
            f"{name}: {_format_difference(run, one, found.signals)}."
            for name, one in others.items()
            if one is not None and one != first
        ]
    lines += _format_declaration(found)
    is_law_kept = run.parameters.get("law.kind") == found.scenario.law.kind
    if first is not None and is_law_kept and answer.software:
        lines += _describe_software(run, answer.software)
    if found.missing_samples:
        lines.append(f"{found.missing_samples} samples are lost: the law did not see their poses.")
    title = f"{law} on the {found.samples} poses that {run.name} read"
    return f"{console.fill_lines(lines)}\n{_format_signals(run, found, title, details=details)}"


def _format_declaration(found: "tl.replay.LawReplay | tl.replay.LoopReplay") -> list[str]:
    """Return the declaration of the replayed law if another declaration was recorded."""
    told = found.declaration
    if told is None:
        return []
    recorded, replayed = (escape_controls(str(text)) for text in (told.recorded, told.replayed))
    return [f"The law declares itself otherwise. Recorded: {recorded}. Replayed: {replayed}."]


def _format_loop(
    run: "Run",
    found: "tl.replay.LoopReplay",
    answer: LoopReplayAnswer,
    change: str,
    *,
    details: bool,
) -> str:
    first = found.first_difference
    name = escape_controls(Path(answer.file).name)
    if first is None:
        goes_on = any(count.recorded != count.replayed for count in found.counts.values())
        end = ", as far as that goes" if goes_on else ""
        end += _describe_slack(found.signals)
        columns = "every column that it holds" if found.absent else "every column"
        lines = [f"{name}: the replay equals the recording in {columns}{end}."]
    else:
        departs = f"departs in {_format_difference(run, first, found.signals)}."
        lines = [f"{name}: the replay {departs}"]
        if change:
            # For a changed scenario, a difference is expected: its result is the answer.
            change = escape_controls(change)
            result = _describe_result(run, found.run, answer.metrics)
            lines = [f"{name}: {change}, the replay {departs}"]
            if result:
                lines = [f"{name}: {change}, {result}", f"The replay {departs}"]
    lines += _format_declaration(found)
    lines += [] if first is None or change else _describe_software(run, answer.software)
    told = [
        f"{count.recorded} {name}"
        if count.recorded == count.replayed
        else f"{count.recorded} {name}, replayed {count.replayed}"
        for name, count in found.counts.items()
    ]
    ends = run.stop_reason or "not recorded why", found.run.stop_reason or ""
    was, now = (end.replace("_", " ") for end in ends)
    end = f"Both ended: {was}" if was == now else f"It ended: {was}; the replay: {now}"
    counts = [f"Recorded: {'; '.join(told)}.", f"{escape_controls(end)}."]
    rows = "tick by tick" if found.by_tick else "sample by sample"
    title = f"{found.run.name} simulated again, against {run.name}, {rows}"
    parts = [console.fill_lines(lines if change else [*lines, *counts])]
    if first is not None:
        heads = ("metric", "unit", "recorded", "replayed", "difference")
        rows_of_metrics = []
        for one in answer.metrics:
            before = one.recorded_status if one.recorded is None else one.recorded
            after = one.replayed_status if one.replayed is None else one.replayed
            rows_of_metrics.append((one.id, one.unit, before, after, one.difference))
        name = "Metrics of the recording and of the replay"
        parts.append(f"\n{console.fit_table(console.build_table(name, heads, rows_of_metrics))}")
    parts += [console.fill_lines(counts)] if change and counts else []
    return "\n".join([*parts, _format_signals(run, found, title, details=details)])


def _describe_result(run: "Run", replayed: "Run", metrics: "Sequence[MetricChange]") -> str:
    """Return how a replay ended beside the recording, or its most important metric."""
    first, second = find_goal_end(run), find_goal_end(replayed)
    if first is not None and second is not None:
        if (first.error_m, first.duration_s) == (second.error_m, second.duration_s):
            return f"it {second.describe()}, as recorded."
        before, after = (
            (format_short(one.error_m, "m"), f"after {one.duration_s:.3g} s")
            for one in (first, second)
        )
        # A size that reads the same is no difference; the table has more digits.
        told = before if before[0] != after[0] else before[1:]
        beside = "almost" if before == after else f"not {' '.join(told)}"
        return f"it {second.describe()}, {beside} as recorded."
    both = [one for one in metrics if one.difference is not None]
    if not both:
        return ""
    was, now = format_pair(both[0].recorded, both[0].replayed, both[0].unit)
    beside = "as recorded" if both[0].difference == 0.0 else f"recorded {was}"
    return f"{both[0].id} is {now}, {beside}."


_ALWAYS: Final = ("x", "y", "heading", "speed", "turn_rate")
"""Signals that are printed even if they are equal."""


def _format_signals(
    run: "Run", found: "tl.replay.LawReplay | tl.replay.LoopReplay", title: str, *, details: bool
) -> str:
    """Return the table of signals, or the number of differing signals and how to show them."""
    rows: list[tuple[Any, ...]] = []
    equal, differing = [], 0
    for one in found.signals:
        differs = one.largest > 0.0 or one.differing > 0
        differing += differs
        if differs or one.signal in _ALWAYS:
            largest, unit = show_angle(one.largest, one.unit)
            at_s = None if one.at_ns is None else tell_time(run, one.at_ns)
            rows.append((one.signal, unit.strip("1"), largest, at_s, one.differing, one.rows))
        else:
            equal.append(one.signal)
    if not details:
        return f"{differing} of {describe_count(len(found.signals), 'signal')} differ: --details"
    at = tl.compare.Column(title="at", unit="s", digits=3)
    heads = ("signal", "unit", "largest difference", at, "rows that differ", "of")
    others = {"Equal in every row as well": equal, "Not in the recording": found.absent}
    rest = console.fill_lines(
        f"{head}: {', '.join(names)}." for head, names in others.items() if names
    )
    return f"\n{console.fit_table(console.build_table(title, heads, rows))}\n{rest}".rstrip()


def _describe_slack(signals: "Iterable[tl.replay.SignalDifference]") -> str:
    return ", within the tolerance" if any(found.largest > 0.0 for found in signals) else ""


def _format_difference(
    run: "Run", found: "tl.replay.Difference", signals: "Sequence[tl.replay.SignalDifference]"
) -> str:
    unit = next((signal.unit for signal in signals if signal.signal == found.signal), "1")
    was, now = format_pair(found.recorded, found.replayed, unit)
    if found.signal == "stop" and found.recorded is None:
        was = "no end yet"
    place = f"{found.signal.replace('_', ' ')} at {tell_time(run, found.time_ns):.3f} s"
    return f"{place}: recorded {was}, replayed {now}"
