"""A value as a game: its scenario simulated without any set of mechanisms, each set once."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from turtlelog.explain.mechanisms import simulate_without
from turtlelog.explain.shapley import Coalition
from turtlelog.measure import measure_run
from turtlelog.run import Phase, Run
from turtlelog.scenario import Scenario

_NOUNS: Final = {
    Phase.ROTATE: "rotation",
    Phase.PAUSE: "pause",
    Phase.TRANSLATE: "translation",
    Phase.DONE: "run",
}

_OF_DEAD_TIME: Final = ("dead_time", "delayed_deviation_max", "delayed_deviation_rms")
"""Dead times are looked for up to 40 poses, which a finer clock passes in a few ticks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a simulation came to.

    Attributes:
        value: Of the metric, None where it has none.
        reason: Why it has none, else empty.
        ended: Phases that came to their end.
    """

    value: float | None
    reason: str
    ended: frozenset[Phase]


class Game:
    """Plays a scenario with some of its mechanisms out, and remembers the outcomes."""

    def __init__(self, scenario: Scenario, metric: str) -> None:
        """Take the scenario with all mechanisms in."""
        self._scenario, self._metric = scenario, metric
        self._outcomes: dict[frozenset[str], Outcome] = {}

    def play(self, inside: Coalition, players: Sequence[str]) -> Outcome:
        """Return the outcome with these players in, and all others out."""
        return self.take_out(name for name in players if name not in inside)

    def take_out(self, names: Iterable[str] = ()) -> Outcome:
        """Return the outcome without these mechanisms."""
        out = frozenset(names)
        if out not in self._outcomes:
            run = simulate_without(self._scenario, out)
            found = measure_run(run, only=[self._metric])[self._metric]
            value, reason = found.value, found.reason
            if "sampling" in out and self._metric.endswith(_OF_DEAD_TIME):
                value, reason = None, "dead times are not measured on a finer clock"
            self._outcomes[out] = Outcome(value=value, reason=reason, ended=_find_ended(run))
        return self._outcomes[out]

    def describe_ending(self, name: str) -> str:
        """Return what differs in kind without a mechanism, in one clause; empty: nothing does."""
        built, without = self.take_out(), self.take_out([name])
        longer, sooner = sorted(built.ended - without.ended), sorted(without.ended - built.ended)
        within = f"within {self._scenario.max_duration_s:g} s"
        if longer:
            return f"the {_NOUNS[longer[0]]} no longer ends {within}"
        if sooner:
            return f"the {_NOUNS[sooner[0]]} ends {within}"
        return without.reason


def _find_ended(run: Run) -> frozenset[Phase]:
    spans = run.find_phase_spans()
    return frozenset(span.phase for span in (spans if run.is_complete else spans[:-1]))
