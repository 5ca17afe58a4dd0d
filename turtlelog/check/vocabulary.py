"""The names that specifications and tests may use."""

from collections.abc import Sequence
from functools import cache
from typing import Final

from turtlelog.errors import CheckError, suggest_names
from turtlelog.expressions import (
    Expression,
    Name,
    Temporal,
    Until,
    describe_unknown_name,
    fail_at,
    iterate_nodes,
)
from turtlelog.measure import METRICS, SIGNALS
from turtlelog.run import Phase, Run
from turtlelog.scenario import Scenario, flatten_scenario

PHASES: Final = tuple(phase.label for phase in Phase if phase is not Phase.DONE)
"""Stretches of a run that can be looked at."""


@cache
def list_parameters() -> tuple[str, ...]:
    """Return the dotted keys of scenarios; a law of one's own has others."""
    return (*flatten_scenario(Scenario()), "goal.heading_rad")


def require_known_names(formula: Expression, *, over_time: bool, run: Run | None = None) -> None:
    """Refuse names that no run has; a law's parameters are known by a run only.

    Args:
        formula: What to look at.
        over_time: Whether signals and temporal operators may stand in it.
        run: Knows the parameters of its law.

    Raises:
        ExpressionError: With the column and the nearest names.
    """
    known = _list_known(over_time=over_time)
    own = {} if run is None else run.parameters
    for node in iterate_nodes(formula.root):
        if isinstance(node, Temporal | Until) and not over_time:
            word = node.operator if isinstance(node, Temporal) else "until"
            fail_at(formula, node, f"expected metrics, found {word}: it stands in holds = ...")
        if not isinstance(node, Name) or node.name in known or node.name in own:
            continue
        if node.name in SIGNALS:
            problem = f"expected a metric, found the signal {node.name}: it stands in holds = ..."
            fail_at(formula, node, problem)
        if run is not None or not node.name.startswith("law."):
            fail_at(formula, node, describe_unknown_name(node.name, {**known, **own}))


@cache
def _list_known(*, over_time: bool) -> dict[str, None]:
    return dict.fromkeys([*(SIGNALS if over_time else ()), *METRICS, *list_parameters()])


def require_phase(phase: str) -> None:
    """Refuse what is no phase.

    Raises:
        CheckError: With the nearest names.
    """
    if phase not in PHASES:
        raise CheckError(f"phase: {describe_nearest(phase, PHASES)}")


def describe_nearest(text: str, known: Sequence[str]) -> str:
    """Return the end of an error line for a word that is none of those known."""
    return f"expected {suggest_names(text, known)}, found {text!r}"


def find_window(run: Run, phase: str | None) -> tuple[int, int] | None:
    """Return the first stretch of a phase [ns], rotate with its pause; None where it has none."""
    if phase is None:
        return run.start_ns, run.end_ns
    spans = run.find_phase_spans()
    for index, span in enumerate(spans):
        if span.phase.label != phase:
            continue
        after = spans[index + 1 : index + 2]
        is_paused = span.phase is Phase.ROTATE and after and after[0].phase is Phase.PAUSE
        return span.start_ns, after[0].end_ns if is_paused else span.end_ns
    return None
