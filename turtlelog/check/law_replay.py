"""Recorded poses through a law of today, held to what was recorded."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from turtlelog.check.judge_difference import judge_replay
from turtlelog.check.result import CheckOutcome, CheckResult
from turtlelog.compare import Tolerance
from turtlelog.errors import CheckError
from turtlelog.laws import Law
from turtlelog.replay import LawReplay, replay_law
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
        return self._conclude(judge_replay(self._run, found, file=self._file))

    def replay(self, tolerance: float = 0.0) -> LawReplay:
        """Return the replay itself."""
        if self._law is None or isinstance(self._law, Scenario):
            return replay_law(self._run, self._law, tolerance=tolerance, trust_law=self._trust_law)
        # The law is at hand: what the recording says of its own need not even load.
        others = {k: v for k, v in self._run.parameters.items() if not k.startswith("law.")}
        scenario = complete_scenario(replace(self._run, parameters=others), Scenario())
        named = replace(scenario, law=replace(scenario.law, kind=type(self._law).__name__))
        return replay_law(self._run, named, law=self._law, tolerance=tolerance)
