"""`turtlelog tune`: the best values of keys, their neighbourhood, and their robustness."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.list_names import complete_keys, complete_metrics
from turtlelog.cli.scenario import LawOptions, ScenarioWord, list_given_keys, load_changed_scenario
from turtlelog.cli.tune_answer import build_tune_answer, format_tune_answer
from turtlelog.cli.usage import Whole
from turtlelog.cli.work import WorkOptions, show_progress
from turtlelog.errors import UsageError
from turtlelog.files.urls import make_path

if TYPE_CHECKING:
    from turtlelog.sweep.tune import TunedScenario, Variation
    from turtlelog.sweep.tune_candidates import SearchedKey, TuningGoal

_MOST_VARIANTS: Final = 1_000_000


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class GoalOptions:
    """Options for the keys and the goal of tuning.

    Attributes:
        grid: A key with its bounds, and perhaps a step. Examples: law.kp_linear=0.5:12,
            law.kp_linear=1:12:0.5, kp=0.5:12 (all gains together). Can be repeated.
        minimise: A metric, or a formula of metrics and keys, that should be small.
        maximise: A metric, or a formula of metrics and keys, that should be large.
        subject_to: Constraint. Example: "rotate.overshoot <= 2". Can be repeated.
        evaluations: Approximate number of candidates of the search. Default: 300 for each key. The
            neighbourhood of the best takes 112 or more for each key, and again as many if it
            contains a better candidate.
        seed: Seed of the search and of --monte-carlo. Default: 0.
    """

    grid: Annotated[
        list[str] | None, Parameter(metavar="KEY=A:B[:STEP]", completer=complete_keys)
    ] = None
    minimise: Annotated[str | None, Parameter(metavar="EXPRESSION", completer=complete_metrics)] = (
        None
    )
    maximise: Annotated[str | None, Parameter(metavar="EXPRESSION", completer=complete_metrics)] = (
        None
    )
    subject_to: Annotated[list[str] | None, Parameter(metavar="EXPRESSION")] = None
    evaluations: Annotated[Whole | None, Parameter(metavar="COUNT")] = None
    seed: Annotated[Whole | None, Parameter(metavar="NUMBER")] = None

    def parse_goal(self) -> "TuningGoal":
        """Return the goal of tuning."""
        if self.minimise is not None and self.maximise is not None:
            raise UsageError("tune takes --minimise or --maximise, not both")
        if self.minimise is None and self.maximise is None:
            raise UsageError(
                "tune needs --grid KEY=A:B and --minimise or --maximise, for example: turtlelog"
                " tune paper --grid law.kp_linear=0.5:12 --minimise run.duration"
            )
        text = self.maximise if self.minimise is None else self.minimise
        return tl.sweep.tune_candidates.parse_goal(
            text or "", self.subject_to or (), is_maximised=self.minimise is None
        )

    def count_evaluations(self, keys: int) -> int:
        """Return the requested number of candidates."""
        found = tl.sweep.tune.FOR_EACH_KEY * keys if self.evaluations is None else self.evaluations
        if found < tl.sweep.tune.FEWEST:
            raise UsageError(f"--evaluations {found}: must be at least {tl.sweep.tune.FEWEST}")
        return found

    def choose_seed(self) -> int:
        """Return the seed."""
        if (self.seed or 0) < 0:
            raise UsageError(f"--seed {self.seed}: must be 0 or greater")
        return self.seed or 0


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RobustnessOptions:
    """Options for testing the best values with variants of the loop.

    Attributes:
        monte_carlo: Number of variants of the best candidate to simulate: with other seeds, if the
            scenario has random effects, and with one tick of transport delay more or less.
        spread: Also choose this key at random between A and B in each simulation. Example:
            plant.turn_gain=0.9:1. Can be repeated.
        robot: Choose the robot's gains, dead times and time constants at random from the intervals
            in this file, written by `turtlelog identify --json`.
    """

    monte_carlo: Annotated[Whole | None, Parameter(metavar="COUNT")] = None
    spread: Annotated[list[str] | None, Parameter(metavar="KEY=A:B", completer=complete_keys)] = (
        None
    )
    robot: Annotated[options.Place | None, Parameter(metavar="FILE")] = None

    def count_runs(self) -> int:
        """Return the requested number of variants; 0 without a request."""
        if self.monte_carlo is None:
            given = {"--spread": self.spread, "--robot": self.robot}
            options.refuse_given(given, "needs --monte-carlo COUNT")
            return 0
        if not 1 <= self.monte_carlo <= _MOST_VARIANTS:
            bounds = f"from 1 to {_MOST_VARIANTS:,}"
            raise UsageError(f"--monte-carlo {self.monte_carlo}: must be {bounds}")
        return self.monte_carlo

    def list_variations(self, scenario: "tl.Scenario", varied: list[str]) -> "list[Variation]":
        """Return the keys chosen at random for each variant, in addition to seeds and delays."""
        found: list[Variation] = []
        if self.robot is not None:
            found += tl.sweep.tune.read_intervals(self.robot, scenario)
        if self.spread:
            known = tl.scenario.flatten_scenario(tl.scenario.resolve_scenario(scenario))
            given = tl.sweep.tune.parse_searched_keys(self.spread, known, source="--spread")
            names = {one.key for one in given}
            found = [one for one in found if one.key not in names]
            found += [console.copy_fields(tl.sweep.tune.Variation, one) for one in given]
        for one in found:
            if one.key in varied:
                raise UsageError(f"--spread: {one.key} is tuned by --grid; leave one of them out")
        return found


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class TuneOptions(WorkOptions):
    """Options for the work, and files to write.

    Attributes:
        output: Write the scenario with the best values to this .toml file.
        trust_law: Run the code of the law that a recording names, if the law is not built in.
        step_budget_ms: A candidate fails if its law computes longer than this in one step
            (wall-clock time). Default: 10000. Unit: ms. Without the option, built-in laws have no
            limit.
    """

    output: options.Output = None
    trust_law: bool = False
    step_budget_ms: options.StepBudgetMs = None


def tune(
    base: ScenarioWord = None,
    /,
    *,
    goal: GoalOptions = GoalOptions(),
    robustness: RobustnessOptions = RobustnessOptions(),
    changes: LawOptions = LawOptions(),
    work: TuneOptions = TuneOptions(),
    json: options.Json = False,
) -> int:
    """Search the best values of a scenario's keys, and show how far each value can move.

    Candidates are simulated, many at a time. The better of two candidates fulfils the constraints;
    if both do, the objective decides. A candidate for which a metric has no value is rejected, for
    example a run that does not settle.

    Then one key at a time is moved until the objective is a tenth worse or a constraint fails. With
    --monte-carlo, variants of the best candidate show how much the result depends on noise, delay
    and robot.

    The exit code is 1 if no candidate fulfils the constraints.

    Example: turtlelog tune paper --grid law.kp_linear=1:9 --minimise run.duration

    --subject-to adds a constraint, for example "rotate.overshoot <= 2".

    Args:
        base: A preset (turtlelog list presets), a scenario file (.toml), also one written by
            `identify`, or a recording. Default: paper; with --law: textbook.
        json: Print one JSON object instead of tables.
    """
    runs, wanted, seed = robustness.count_runs(), goal.parse_goal(), goal.choose_seed()
    options.require_new_target(
        work.output, [] if base is None else [make_path(base)], suffix=".toml"
    )
    scenario = load_changed_scenario(base, changes)
    scenario, keys = _parse_keys(scenario, goal.grid or [], changes, trust_law=work.trust_law)
    more = robustness.list_variations(scenario, [key.key for key in keys])
    running: dict[str, Any] = {
        "trust_law": work.trust_law,
        "step_budget_s": options.choose_step_budget(work.step_budget_ms),
    }
    with work.find_any_place() as place:
        running["jobs"] = place
        most = goal.count_evaluations(len(keys))
        found, spread = _search(scenario, keys, wanted, most, seed, running), None
        if "name" not in list_given_keys(changes):
            told = [f"{key}={value:.6g}" for key, value in found.values.items()]
            name = " ".join([found.scenario.name, *told])
            found = replace(found, scenario=replace(found.scenario, name=name))
        if work.output is not None:
            console.write_text(work.output, tl.scenario.format_scenario(found.scenario))
        if runs and found.is_feasible:
            variations = tl.sweep.tune.choose_variations(found.scenario, runs, more)
            with show_progress("simulated", runs, "variants", has_rate=True) as progress:
                spread = tl.sweep.tune.simulate_variants(
                    found.scenario,
                    found.goal,
                    variations,
                    runs=runs,
                    seed=seed,
                    watch=progress.set,
                    **running,
                )
    if json:
        console.print_json(build_tune_answer(found, spread))
    else:
        console.print_text(format_tune_answer(found, spread))
    return console.EXIT_FINE if found.is_feasible else console.EXIT_FAILED


def _parse_keys(
    scenario: "tl.Scenario", vary: list[str], changes: LawOptions, *, trust_law: bool
) -> "tuple[tl.Scenario, tuple[SearchedKey, ...]]":
    """Return the keys, and the scenario with a value for each, because laws may lack defaults."""
    given = list_given_keys(changes)
    for key in tl.sweep.tune.parse_searched_keys(vary, tl.scenario.flatten_scenario(scenario)):
        if key.key == "kp" and changes.kp is not None:
            raise UsageError("--kp: the gains are tuned by --grid kp; leave one of them out")
        if key.key in given:
            raise UsageError(f"--set: {key.key} is tuned by --grid; leave one of them out")
    return tl.sweep.tune.complete_searched(scenario, vary, source="--grid", trust_law=trust_law)


def _search(
    scenario: "tl.Scenario",
    keys: "tuple[SearchedKey, ...]",
    goal: "TuningGoal",
    most: int,
    seed: int,
    running: dict[str, Any],
) -> "TunedScenario":
    """Return the best of about `most` candidates and its neighbourhood."""
    expected = most + tl.sweep.tune_search.NEIGHBOURS * len(keys)
    with show_progress("simulated", expected, "candidates", has_rate=True) as progress:
        candidates = tl.sweep.tune_candidates.Candidates(
            scenario,
            [key.key for key in keys],
            goal,
            expected=expected,
            watch=progress.set,
            tell=_tell_late,
            source="--grid",
            **running,
        )
        try:
            return tl.sweep.tune.tune_candidates(candidates, keys, evaluations=most, seed=seed)
        except KeyboardInterrupt:
            if candidates.evaluations:
                values = zip(keys, tl.sweep.tune_search.find_best(candidates).point, strict=True)
                told = ", ".join(f"{key.key} = {value:.6g}" for key, value in values)
                console.print_note(
                    f"the best of {candidates.evaluations} candidates so far: {told}"
                )
            raise


def _tell_late(late: str) -> None:
    console.print_note(
        f"{late}. Every such candidate takes as long; --step-budget-ms 100 ends it sooner"
    )
