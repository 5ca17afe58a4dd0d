"""Options of `turtlelog replay`: the mode, and the scenario."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import StepBudgetMs
from turtlelog.cli.output import print_note
from turtlelog.cli.scenario_options import ScenarioOptions, change_scenario, name_by_changes
from turtlelog.errors import UsageError
from turtlelog.files.urls import make_path

if TYPE_CHECKING:
    from turtlelog import Run, Scenario

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


def settle_file(file: Path | None, options: ReplayOptions) -> tuple[Path, str | None]:
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


def require_sound(
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


def choose_replayed(
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
