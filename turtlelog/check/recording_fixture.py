"""A recording for tests: read on first use, or simulated."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias, Unpack

from turtlelog.check import spec
from turtlelog.check.failure_report import describe_failure
from turtlelog.check.formula_trace import find_loss
from turtlelog.check.judge_formula import judge_check
from turtlelog.check.reference import (
    AnyReference,
    AnyTolerance,
    ReferenceFile,
    judge_replay,
    match_run,
)
from turtlelog.check.result import CheckOutcome, CheckResult, fail_recording, watch_metric
from turtlelog.compare import Tolerance
from turtlelog.errors import CheckError, LogError, MissingValueError, PartialLogError
from turtlelog.expressions import parse_expression
from turtlelog.files.urls import make_path
from turtlelog.identify import AxisModel, Estimate, RobotModel, identify_robot
from turtlelog.laws import AnyLaw, Law, LawPart
from turtlelog.log import ReadChoice, ReadOptions, read_as_chosen, write_recording
from turtlelog.measure import Metric, find_metric_kind, list_ids_like, list_metrics
from turtlelog.replay import LawReplay, replay_law
from turtlelog.run import Run
from turtlelog.scenario import (
    LawChoice,
    Scenario,
    complete_scenario,
    load_scenario,
    override_gains,
    override_scenario,
)
from turtlelog.simulate import declare_scenario, simulate_run
from turtlelog.simulate.step_budget import STEP_BUDGET_S

Watch: TypeAlias = Callable[["Recording", CheckResult | None], None]
"""Function that is called for every check, and with None if a recording has only been used."""


class UnknownMetricError(CheckError, AttributeError):
    """A metric that a loop does not have.

    The error is an AttributeError, because metrics are attributes.
    """


class Recording:
    """A recording that is read on first use.

    Args:
        path: A recording, a bag or a log; FILE:TOPIC, as in `bag:/odom_kf`, selects a topic of
            poses.
        name: Name in messages. Default: the path.
        trust_law: Whether `driven_by()` may run a recorded law that is not built in.
        watch: Object that is called with every check.
        options: Fields of a `ReadChoice`: topics of third-party files, the goal, and whether the
            recording may be incomplete (`allow_partial`).
    """

    def __init__(
        self,
        path: str | Path,
        *,
        name: str | None = None,
        trust_law: bool = False,
        watch: Watch | None = None,
        **options: Unpack[ReadOptions],
    ) -> None:
        self.path = make_path(path)
        self.file = name or str(path)
        self._choice = ReadChoice(**options)
        self._allow_partial = self._choice.allow_partial
        self._trust_law, self._watch = trust_law, watch

    def __repr__(self) -> str:
        return f"<recording {self.file}>"

    @property
    def run(self) -> Run:
        """Run of the recording.

        Raises:
            PartialLogError: If the recording is incomplete and this is not allowed.
            LogError: If the recording cannot be read.
        """
        try:
            run = self._run
        except LogError as err:
            reason = str(err).removeprefix(f"{self.path}: ")
            self._note(fail_recording(self.file, reason))
            raise
        if self._watch is not None:
            self._watch(self, None)
        lost = None if self._allow_partial else find_loss(run)
        if lost is not None:
            self._note(fail_recording(self.file, lost))
            raise PartialLogError(f"{self.file}: {lost}; allow_partial=True lets it pass")
        return run

    @cached_property
    def _run(self) -> Run:
        # The note on losses decides whether an incomplete recording is allowed.
        choice = replace(self._choice, allow_partial=True, allow_no_poses=True)
        return read_as_chosen(self.path, choice)

    def metric(self, name: str, **settings: Any) -> Metric:
        """Return a metric by its id, measured with settings of `MeasureSettings`.

        The metric of an undeclared loop has a reason instead of a value.

        Raises:
            CheckError: If there is no such metric. The message has the nearest ids.
        """
        if find_metric_kind(name) is None:
            known = dict.fromkeys([*list_metrics(self.run.declaration), *list_ids_like(name)])
            raise CheckError(f"metric: {spec.describe_nearest(name, tuple(known))}")
        return watch_metric(self.run, self.file, name, self._note, settings)

    def phase(self, name: str) -> "PhaseMetrics":
        """Return the metrics of a loop of the run's law (`rotate`), of `final` or `run`.

        Raises:
            CheckError: If the law declares no such loop. The message lists the declared loops.
        """
        ids = list_metrics(self.run.declaration)
        parts = tuple(dict.fromkeys(known.rpartition(".")[0] for known in ids))
        if name not in parts:
            raise CheckError(f"phase: {spec.describe_nearest(name, parts)}")
        return PhaseMetrics(self, name)

    def robot(self) -> "RobotValues":
        """Return the dynamics of the recorded robot, as `turtlelog.identify_robot` does."""
        return RobotValues(identify_robot(self.run), self.file)

    def holds(self, formula: str, *, phase: str | None = None) -> CheckOutcome:
        """Return whether a formula over signals, metrics and parameters holds.

        Args:
            formula: Expression, such as `always(abs(cross_track) <= 0.05)`.
            phase: Phase to which the check is limited. Default: the whole run. If the run has no
                such phase, the check is undecided.

        Raises:
            ExpressionError: If the formula does not parse or contains an unknown name.
            CheckError: If the name of a phase is misspelled.
        """
        parsed = parse_expression(formula, source="holds")
        if phase is not None:
            spec.require_phase(phase, self.run)
        spec.require_known_names(parsed, over_time=True, run=self.run)
        is_measured = phase is None and spec.names_metrics_alone(parsed)
        kind: Literal["expect", "holds"] = "expect" if is_measured else "holds"
        check = spec.Check(name="", kind=kind, formula=parsed, phase=phase)
        result = judge_check(check, self.run, file=self.file)
        return self._conclude([replace(result, check=result.expected)])

    def matches(
        self, reference: "Recording | AnyReference", *, tolerance: AnyTolerance = None
    ) -> CheckOutcome:
        """Return whether the recording agrees with a reference.

        Args:
            reference: A recording, a run, a path to one or to metrics as `turtlelog metrics --json`
                prints them, or the fixture `reference`.
            tolerance: Tolerance of every signal or metric; `Tolerances` or a tolerance file select
                the signals and metrics to judge. None: signals may differ by 1e-6, and metrics may
                be worse by a millionth.

        Raises:
            CheckError: If there is no reference, or the tolerance does not fit it.
            CompareError: If the runs do not overlap.
        """
        run = self.run
        if isinstance(reference, ReferenceFile) and reference.claims is not None:
            reference.accept(run, self.path)
            return CheckOutcome(results=())
        if isinstance(reference, Recording):
            reference = reference.run
        return self._conclude(match_run(run, reference, tolerance, file=self.file))

    def driven_by(self, law: Law | Scenario | None = None) -> "DrivenRecording":
        """Return the response of a law to the recorded poses.

        Args:
            law: A law with its parameters, or a scenario with a law. Default: the recorded law,
                which runs if it is built in or `trust_law` is set.

        Raises:
            CheckError: If `law` is not a law with its parameters.
        """
        is_made = not isinstance(law, type | LawPart) and hasattr(law, "step")
        if not (law is None or isinstance(law, Scenario) or is_made):
            expected = "a law with its parameters, as in MyLaw(Parameters(kp=2)), or a scenario"
            found = law.name if isinstance(law, LawPart) else f"{law!r:.60}"
            raise CheckError(f"driven_by: expected {expected}, found {found}")
        return DrivenRecording(
            self.run, law, self._conclude, file=self.file, trust_law=self._trust_law
        )

    def explain_failures(self, results: Sequence[CheckResult]) -> Sequence[CheckResult]:
        """Return results.

        One failed result gets the reason why the run differs from its reference.
        """
        reference = next((one.reference for one in results if one.reference is not None), None)
        if reference is None:
            return results
        from turtlelog.check.failure_report import explain_failures

        return explain_failures(self.run, reference, results, trust_law=self._trust_law)

    def describe(self, *results: CheckResult) -> list[str]:
        """Return a full description of failed checks, line by line."""
        return describe_failure(self._run, *results)

    def _conclude(self, results: Sequence[CheckResult]) -> CheckOutcome:
        for result in results:
            self._note(result)
        return CheckOutcome(results=tuple(results))

    def _note(self, result: CheckResult) -> None:
        if self._watch is not None:
            self._watch(self, result)


class PhaseMetrics:
    """Metrics of one loop, the end or the run as attributes: `rotate.overshoot`."""

    def __init__(self, recording: Recording, name: str) -> None:
        self._recording, self._name = recording, name

    def __bool__(self) -> bool:
        raise CheckError(f"phase {self._name}: assert one of its metrics")

    def __getattr__(self, name: str) -> Metric:
        if name.startswith("__"):
            raise AttributeError(name)
        ids = list_metrics(self._recording.run.declaration)
        if f"{self._name}.{name}" in ids:
            return self._recording.metric(f"{self._name}.{name}")
        prefix = f"{self._name}."
        known = tuple(found.removeprefix(prefix) for found in ids if found.startswith(prefix))
        raise UnknownMetricError(f"metric of {self._name}: {spec.describe_nearest(name, known)}")


class RobotValues:
    """Identified values of a robot by axis: `speed.gain`, `turn_rate.dead_time_s`."""

    def __init__(self, model: RobotModel, file: str) -> None:
        self.model = model
        self.speed = AxisValues(model.speed, file)
        self.turn_rate = AxisValues(model.turn_rate, file)

    def __bool__(self) -> bool:
        raise CheckError("robot: assert a value of one of its axes")

    def __repr__(self) -> str:
        return repr(self.model)


class AxisValues:
    """Values of one axis; a value that is not identified raises an error with the reason."""

    def __init__(self, model: AxisModel, file: str) -> None:
        self._model, self._file = model, file

    def __bool__(self) -> bool:
        raise CheckError(f"{self._model.axis}: assert one of its values")

    def __repr__(self) -> str:
        return f"<{self._model.axis} of {self._file}: {self._model.status}>"

    @property
    def gain(self) -> Estimate:
        """Steady-state rate per command [1]."""
        return self._require("gain", self._model.gain)

    @property
    def dead_time_s(self) -> Estimate:
        """Time from a command until the rate begins to follow [s]."""
        return self._require("dead_time_s", self._model.dead_time_s)

    @property
    def lag_s(self) -> Estimate:
        """Time constant of the response [s]."""
        return self._require("lag_s", self._model.lag_s)

    @property
    def total_delay_s(self) -> Estimate:
        """Sum of dead time and time constant [s]."""
        return self._require("total_delay_s", self._model.total_delay_s)

    def _require(self, name: str, found: Estimate | None) -> Estimate:
        if found is None:
            found_none = "; ".join(filter(None, (self._model.reason, self._model.advice)))
            raise MissingValueError(
                f"{self._file}: {self._model.axis}.{name}: has no value: {found_none}"
            )
        return found


class SimulatedRuns:
    """Simulations with recordings in a folder; `watch` is called with every check on them."""

    def __init__(self, folder: Path, watch: Watch | None = None) -> None:
        self._folder, self._watch, self._count = folder, watch, 0

    def simulate(
        self,
        scenario: str | Path | Scenario | None = None,
        *,
        law: AnyLaw | str | None = None,
        kp: float | None = None,
        changes: Mapping[str, Any] | None = None,
        step_budget_s: float | None = STEP_BUDGET_S,
    ) -> Recording:
        """Return the recording of a simulation.

        Args:
            scenario: A preset, a file, or the scenario itself. Default: `paper`; with a law,
                `textbook`.
            law: Law to use: a class, a `LawPart` or the name of a law, as in `my_law.py:MyLaw`.
            kp: One value for each gain that the law declares.
            changes: Other values by dotted key, as in `{"law.pause_ticks": 0}`.
            step_budget_s: Time for computing one answer of the law [s]; None: unlimited.

        Raises:
            CheckError: If the law cannot be found by a name in its module.
            ScenarioError: If there is no such scenario, or a change is wrong.
            SimulationError: If the law fails or exceeds its computing time.
        """
        if not isinstance(scenario, Scenario):
            scenario = load_scenario(str(scenario or ("paper" if law is None else "textbook")))
        if law is not None:
            kind = law if isinstance(law, str) else _name_law(law)
            scenario = override_scenario(scenario, {"law.kind": kind}, source="simulate")
        scenario = override_scenario(scenario, changes or {}, source="simulate")
        if kp is not None:
            keys = declare_scenario(scenario).list_gains()
            gains = [key for key in keys if key not in (changes or {})]
            scenario = override_gains(scenario, gains, kp, source="simulate")
        self._count += 1
        path = self._folder / f"simulated-{self._count}.mcap"
        write_recording(simulate_run(scenario, step_budget_s=step_budget_s), path)
        return Recording(path, name=f"{scenario.name} ({path.name})", watch=self._watch)


def _name_law(law: object) -> str:
    """Return the name under which a law can be loaded again, now and from a recording."""
    module, name = getattr(law, "__module__", None), getattr(law, "__qualname__", None)
    if isinstance(law, LawPart):
        from turtlelog.laws import LAWS  # most checks need no law

        if LAWS.get(law.name) is law:
            return law.name
        module = law.step.__module__
        name = next((key for key, one in vars(sys.modules[module]).items() if one is law), None)
    if (
        not isinstance(law, type | LawPart)
        or getattr(sys.modules.get(str(module)), str(name), None) is not law
    ):
        expected = "a class or LawPart at the top of a module, or path.py:NAME"
        raise CheckError(f"law: expected {expected}, found {name or law!r:.60}")
    return f"{module}:{name}"


class DrivenRecording:
    """Response of a law to the recorded poses; `matches` compares it with the recording."""

    def __init__(
        self,
        run: Run,
        law: Law | Scenario | None,
        conclude: Callable[[Sequence[CheckResult]], CheckOutcome],
        *,
        file: str,
        trust_law: bool = False,
    ) -> None:
        self._run, self._law, self._conclude, self._file = run, law, conclude, file
        self._trust_law = trust_law

    def __repr__(self) -> str:
        return f"<{self._file} driven again>"

    def __bool__(self) -> bool:
        raise CheckError(f"{self._file} driven again: assert .matches(recording)")

    def matches(
        self, recording: Recording | Run, *, tolerance: Tolerance | None = None
    ) -> CheckOutcome:
        """Return whether the law answers as recorded: equal commands, errors, phases and end.

        Commands are compared both as computed and as published.

        Args:
            recording: The recording whose poses drive the law.
            tolerance: Tolerance, of which only `abs` is used, in the unit of each signal. Default:
                0.

        Raises:
            CheckError: If the recording is another one, or the tolerance is not of this kind.
            ReplayError: If the recording has no samples.
            ScenarioError: If the law of the recording is neither built in nor trusted.
            SimulationError: If the law fails.
        """
        tolerance = Tolerance() if tolerance is None else tolerance
        if tolerance.rel or tolerance.time_s:
            raise CheckError("tolerance: expected abs alone: the law reads the very same poses")
        if (recording if isinstance(recording, Run) else recording.run) is not self._run:
            raise CheckError("matches: must be the recording that is driven")
        found = self.replay(tolerance.abs)
        return self._conclude(judge_replay(self._run, found, file=self._file))

    def replay(self, tolerance: float = 0.0) -> LawReplay:
        """Return the replay itself."""
        if self._law is None or isinstance(self._law, Scenario):
            return replay_law(self._run, self._law, tolerance=tolerance, trust_law=self._trust_law)
        # The law is given, so the recorded law's parameters need not load.
        others = {k: v for k, v in self._run.parameters.items() if not k.startswith("law.")}
        scenario = complete_scenario(replace(self._run, parameters=others), Scenario())
        parameters = getattr(self._law, "parameters", scenario.law.parameters)
        named = replace(
            scenario, law=LawChoice(kind=type(self._law).__name__, parameters=parameters)
        )
        return replay_law(self._run, named, law=self._law, tolerance=tolerance)
