"""Recorded poses through a law of today, held to what was recorded."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from turtlelog.check.outcome import CheckOutcome
from turtlelog.check.result import CheckResult, Verdict
from turtlelog.compare import Tolerance
from turtlelog.errors import CheckError
from turtlelog.laws import Law
from turtlelog.measure import list_signals
from turtlelog.replay import Difference, LawReplay, SignalDifference, replay_law
from turtlelog.run import Run
from turtlelog.scenario import Scenario, complete_scenario


class HasRun(Protocol):
    """What holds a run, as a `Recording` does."""

    @property
    def run(self) -> Run:
        """The run."""


class DrivenRecording:
    """What a law makes of the recorded poses; compared with `matches`."""

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
        raise CheckError(f"{self._file} driven again: expected .matches(recording), found none")

    def matches(
        self, recording: HasRun | Run, *, tolerance: Tolerance | None = None
    ) -> CheckOutcome:
        """Return whether the law answers as was recorded: commands, errors, phases and the end.

        Commands are compared as computed and as published.

        Args:
            recording: The same that is driven.
            tolerance: Its `abs`, in each signal's unit; 0 where None.

        Raises:
            CheckError: Where it is another recording, or the tolerance is not of that kind.
            ReplayError: Where the recording holds no samples.
            ScenarioError: Where the law that it names is neither built in nor trusted.
            SimulationError: Where the law fails.
        """
        tolerance = Tolerance() if tolerance is None else tolerance
        if tolerance.rel or tolerance.time_s:
            raise CheckError("tolerance: expected abs alone: the law reads the very same poses")
        if (recording if isinstance(recording, Run) else recording.run) is not self._run:
            raise CheckError("matches: expected the recording that is driven, found another")
        found = self.replay(tolerance.abs)
        results = [self._judge(signal, tolerance.abs) for signal in found.signals]
        others = [other for other in (found.commands, found.stop) if other is not None]
        return self._conclude([*results, *map(self._judge_other, others)])

    def replay(self, tolerance: float = 0.0) -> LawReplay:
        """Return the replay itself."""
        if self._law is None or isinstance(self._law, Scenario):
            return replay_law(self._run, self._law, tolerance=tolerance, trust_law=self._trust_law)
        # The law is at hand: what the recording says of its own need not even load.
        others = {k: v for k, v in self._run.parameters.items() if not k.startswith("law.")}
        scenario = complete_scenario(replace(self._run, parameters=others), Scenario())
        named = replace(scenario, law=replace(scenario.law, kind=type(self._law).__name__))
        return replay_law(self._run, named, law=self._law, tolerance=tolerance)

    def _judge(self, signal: SignalDifference, limit: float) -> CheckResult:
        first, known = signal.first_difference, list_signals(self._run.declaration)
        return CheckResult(
            file=self._file,
            check=f"law.{signal.signal}",
            verdict=Verdict.PASS if first is None else Verdict.FAIL,
            expected="as recorded",
            value=signal.largest,
            limit=limit,
            margin=limit - signal.largest,
            unit=signal.unit,
            first_violation_s=None if first is None else self._read_time(first),
            reason="" if first is None else _describe(first),
            names=(signal.signal,) if signal.signal in known else ("speed", "turn_rate"),
        )

    def _judge_other(self, other: Difference) -> CheckResult:
        return CheckResult(
            file=self._file,
            check=f"law.{other.signal}",
            verdict=Verdict.FAIL,
            expected="as recorded",
            first_violation_s=self._read_time(other),
            reason=_describe(other),
            names=("distance", "speed", "turn_rate"),
        )

    def _read_time(self, difference: Difference) -> float:
        return (difference.time_ns - self._run.start_ns) / 1e9


def _describe(difference: Difference) -> str:
    sides = (difference.recorded, difference.replayed)
    recorded, replayed = ("none" if side is None else str(side) for side in sides)
    return f"recorded {recorded}, the law answers {replayed}"
