"""`turtlelog scenario`: printing of a scenario; choice and change of scenarios by options."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.console import print_note, print_text
from turtlelog.cli.list_names import complete_keys, complete_law, complete_preset
from turtlelog.cli.options import (
    MaxDownload,
    Place,
    ReadingOptions,
    TopicOptions,
    read_chosen_run,
    read_runs,
    refuse_given,
)
from turtlelog.cli.usage import Whole
from turtlelog.cli.work import show_progress
from turtlelog.errors import ScenarioError, UsageError
from turtlelog.files.urls import make_path

ScenarioWord = Annotated[str | None, Parameter(name="SCENARIO", completer=complete_preset)]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioOptions:
    """Changes to a scenario, applied in this order.

    Attributes:
        commands: Replace the scenario's law by open-loop, which sends the commands of this
            recording at their recorded times.
        kp: Set the gains that the law declares [1/s].
        goal: Set the goal position [m]. Example: 2,10.
        assignments: Set one key of the scenario; the key's name ends with its unit. Example:
            law.kp_linear=4. Can be repeated.
    """

    commands: Annotated[Place | None, Parameter(metavar="FILE")] = None
    kp: Annotated[float | None, Parameter(metavar="GAIN")] = None
    goal: Annotated[str | None, Parameter(metavar="X,Y")] = None
    assignments: Annotated[
        list[str] | None, Parameter(name="--set", metavar="KEY=VALUE", completer=complete_keys)
    ] = None

    def parse_assignments(self) -> dict[str, Any]:
        """Return the values of --set by key."""
        return tl.scenario.parse_assignments(self.assignments or (), source="--set")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class LawOptions(ScenarioOptions):
    """Changes to a scenario, the law first.

    Attributes:
        law: Use another control law: a built-in kind, path.py:Class or package.module:Class. The
            code of that law runs. Without SCENARIO the scenario is textbook.
        max_download: Largest file to download whole from a URL whose server does not support range
            requests. Example: 500MB. Default: 4GiB.
    """

    law: Annotated[str | None, Parameter(metavar="KIND", completer=complete_law)] = None
    max_download: MaxDownload = None

    def find_law_kind(self) -> str | None:
        """Return the kind of law in --law or --set; refuse two laws, or one beside --commands."""
        kind = self.parse_assignments().get("law.kind")
        if self.law is not None and kind not in (None, self.law):
            raise UsageError(f"--law {self.law} and --set law.kind={kind}: choose one")
        named = self.law or (kind if isinstance(kind, str) else None)
        if self.commands is not None and named is not None:
            raise UsageError(f"--commands: leave out the law {named}")
        return named


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RowOptions:
    """A row of a table in place of SCENARIO.

    Attributes:
        table: Run the scenario of a row of this table, which `turtlelog sweep` wrote.
        row: Number of the row to run, as in the column `row`.
    """

    table: Annotated[Place | None, Parameter(name="--from", metavar="FILE")] = None
    row: Annotated[Whole | None, Parameter(metavar="NUMBER")] = None

    def load(self, scenario: str | None, options: LawOptions) -> "tl.Scenario":
        """Return the scenario to run, with the options applied."""
        if self.table is None:
            refuse_given({"--row": self.row}, "needs --from TABLE")
            return load_changed_scenario(scenario, options)
        if scenario is not None:
            raise UsageError(f"--from: leave out the scenario {scenario}")
        if self.row is None:
            raise UsageError("--from: needs --row NUMBER")
        return apply_options(tl.sweep.load_row_scenario(self.table, self.row), options)


def scenario(scenario: ScenarioWord = None, /, *, changes: LawOptions = LawOptions()) -> None:
    """Print the scenario of a preset, file or recording as a whole file, to edit and run.

    The code of a law of your own is not loaded: only the given keys are printed.

    Example: turtlelog scenario paper-kp10 > mine.toml

    Args:
        scenario: A preset (turtlelog list presets), a scenario file (.toml), or a recording.
            Default: paper; with --law: textbook.
    """
    chosen = load_changed_scenario(scenario, changes)
    print_text(tl.format_scenario(chosen))


_RECORDINGS: Final = frozenset(
    {".mcap", ".parquet", ".json", ".csv", ".db3", ".bag", ".zstd", ".tsv", ".tum"}
)
"""Suffixes of recordings, bags and tables. A file with another suffix is a scenario file."""


def find_scenario_file(name: str | None) -> Path | None:
    """Return the scenario file named by a word; None if the word names anything else."""
    if name is None or name in tl.PRESETS or is_recording(make_path(name)):
        return None
    path = make_path(name)
    return path if path.suffix.lower() == ".toml" or path.is_file() else None


def is_recording(path: Path) -> bool:
    """Return whether a word names a recording, judging by its suffix, or a bag's folder."""
    path, topic = tl.log.split_topic(path)
    return topic is not None or path.suffix.lower() in _RECORDINGS or path.is_dir()


def load_changed_scenario(name_or_path: str | None, options: LawOptions) -> "tl.Scenario":
    """Return a preset, or the scenario of a file or recording, with the options applied.

    The name of the scenario contains the changes. The code of a law is loaded only to set its
    gains. The law of a recording is never loaded, because the recording contains its gains.
    Default: `paper`; with --law `textbook`, whose loop has no effects.
    """
    named = options.find_law_kind()
    name_or_path = name_or_path or ("paper" if options.law is None else "textbook")
    path, declared = make_path(name_or_path), None
    if name_or_path in tl.PRESETS or not is_recording(path):
        base = tl.load_scenario(name_or_path)
        if path.suffix == ".toml" and path.is_file():
            text = path.read_text(encoding="utf-8", errors="replace")
            for note in tl.identify.read_robot_notes(text):
                print_note(note)
    else:
        run = read_chosen_run(path, TopicOptions())
        if not run.scenario_is_complete:
            raise UsageError(
                f"{path} has no whole scenario to simulate; name a preset (turtlelog list presets),"
                " a scenario file (.toml) or a recording by turtlelog run"
            )
        base = tl.scenario.restore_scenario(run, source=str(path))
        declared = None if named else run.declaration
    return apply_options(base, options, declared)


def apply_options(
    base: "tl.Scenario", options: LawOptions, declared: "tl.Declaration | None" = None
) -> "tl.Scenario":
    """Return a scenario with the options applied and named."""
    scenario, said = base, []
    if options.law is not None:
        scenario = tl.override_scenario(base, {"law.kind": options.law}, source="--law")
        said = [_tell(f"law={options.law}")]
    named = name_by_changes(change_scenario(scenario, options, declared), base.name, options, *said)
    return named[0]


_OF_LAW: Final = ("law", "shaping", "limits", "goal")
"""Tables of a scenario that have an effect if poses are given."""


def choose_replayed(
    run: "tl.Run",
    changes: ScenarioOptions,
    law: str | None = None,
    *,
    base: str | None,
    keeps_poses: bool,
) -> "tuple[tl.Scenario, str] | None":
    """Return the scenario to replay, and its changes as text; None for the recording's own.

    Args:
        run: Recorded run.
        changes: Changes to its scenario.
        law: Kind of another law.
        base: Preset or file of another scenario.
        keeps_poses: Whether the poses are the recorded ones, so that only the law can change.
    """
    assigned = changes.parse_assignments()
    for key in assigned if keeps_poses else ():
        if key.partition(".")[0] not in _OF_LAW:
            raise UsageError(
                f"--set {key}: must be a key of {', '.join(_OF_LAW)}, because --law takes the poses"
                " from the recording"
            )
    if changes == ScenarioOptions() and law is None and base is None:
        return None
    named = law or assigned.get("law.kind")
    if isinstance(named, str) and run.parameters.get("law.kind") not in (None, named):
        # The recorded law is replaced, and may be impossible to load.
        kept = {key: value for key, value in run.parameters.items() if not key.startswith("law.")}
        run = replace(run, parameters=kept)
    scenario = _find_base(run, base)
    if law is not None:
        scenario = tl.override_scenario(scenario, {"law.kind": law}, source="--law")
    # Without a given law, the recording's declaration is used, so that no code runs.
    is_recorded = not isinstance(named, str) and base is None
    declared = run.declaration if is_recorded else None
    changed = change_scenario(scenario, changes, declared)
    said = [] if base is None else [f"as {Path(base).stem}"]
    return name_by_changes(changed, run.name, changes, *said)


def _find_base(run: "tl.Run", name_or_path: str | None) -> "tl.Scenario":
    if name_or_path is None:
        return tl.scenario.restore_scenario(run)
    base = tl.load_scenario(name_or_path)
    if run.scenario_is_complete:
        return base
    base = tl.scenario.resolve_scenario(base)
    completed, was = tl.scenario.complete_scenario(run, base), tl.scenario.flatten_scenario(base)
    kept = [
        f"{key} = {value} ({was.get(key, 'none')})"
        for key, value in tl.scenario.flatten_scenario(completed).items()
        if value != was.get(key)
    ]
    if kept:
        print_note(f"known from the log itself (in {name_or_path}): {', '.join(kept)}")
    return completed


def collect_runs(words: Sequence[Path], topics: ReadingOptions) -> "list[tl.Run]":
    """Return recordings, and runs of scenarios and presets, in their order."""
    runs: list[tl.Run] = []
    for is_scenario, group in groupby(words, _is_scenario):
        if is_scenario:
            with show_progress("simulating"):
                runs += [tl.simulate_run(tl.load_scenario(str(word))) for word in group]
        else:
            runs += read_runs([*group], topics, allow_no_poses=True)
    bare = [run.name for run in runs if not len(run.poses)]
    if 0 < len(bare) < len(runs):  # there is no common axis
        raise UsageError(f"{bare[0]} has commands alone, and other files have poses: plot it alone")
    return runs


def _is_scenario(word: Path) -> bool:
    return str(word) in tl.PRESETS or (word.suffix.lower() == ".toml" and word.is_file())


def list_given_keys(options: ScenarioOptions) -> list[str]:
    """Return the keys of a scenario that the options set by name."""
    goal = {} if options.goal is None else _parse_goal(options.goal)
    return [*options.parse_assignments(), *goal]


def name_by_changes(
    scenario: "tl.Scenario", base: str, options: ScenarioOptions, *more: str
) -> "tuple[tl.Scenario, str]":
    """Return a scenario that is named after its base and the changes, and the changes as text.

    A name from --set is kept.
    """
    said = [*more]
    said += [] if options.commands is None else [f"commands={options.commands.stem}"]
    said += [] if options.kp is None else [f"kp={options.kp:g}"]
    said += [] if options.goal is None else [f"goal={options.goal}"]
    said += map(_tell, options.assignments or ())
    if "name" in options.parse_assignments():
        return scenario, f"called {scenario.name}"
    return replace(scenario, name=" ".join([base, *said])), f"with {' '.join(said)}"


def _tell(text: str) -> str:
    """Return a change as text for a name, in one line, whatever its value."""
    return text if text.isprintable() else repr(text)[1:-1]


def change_scenario(
    scenario: "tl.Scenario",
    options: ScenarioOptions,
    declaration: "tl.Declaration | None" = None,
) -> "tl.Scenario":
    """Return a scenario with the options applied."""
    if options.commands is not None:
        run = read_chosen_run(options.commands, TopicOptions(), allow_no_poses=True)
        scenario, declaration = tl.scenario.replay_commands(scenario, run), None
    changes = options.parse_assignments()
    if "law.kind" in changes:
        # Another law has other keys, so it is chosen first.
        kind = {"law.kind": changes.pop("law.kind")}
        scenario = tl.override_scenario(scenario, kind, source="--set")
    if options.kp is not None:
        # The law declares its loops once all required values are set.
        complete = partial(tl.override_scenario, scenario, changes, source="--set")
        gains = (declaration or tl.simulate.declare_scenario(complete())).list_gains()
        if not gains:
            raise UsageError("--kp: this law declares no gain; set its keys with --set")
        scenario = tl.scenario.override_gains(scenario, gains, options.kp, source="--kp")
    if options.goal is not None:
        scenario = tl.override_scenario(scenario, _parse_goal(options.goal), source="--goal")
    try:
        return tl.override_scenario(scenario, changes, source="--set")
    except ScenarioError as err:
        if err.unknown_key != "law.kp":
            raise
        kp, advice = changes[err.unknown_key], re.sub(r"\bkp_", "law.kp_", err.advice)
        problem = f"{scenario.law.kind} has no key law.kp; {advice}"
        raise UsageError(f"{problem} --kp {kp} sets the gain of every loop") from err


def _parse_goal(text: str) -> dict[str, Any]:
    try:
        x_m, y_m = map(float, text.split(","))
    except ValueError as err:
        raise UsageError(f"--goal {text}: must be X,Y in metres") from err
    return {"goal.x_m": x_m, "goal.y_m": y_m}
