"""Which mechanism caused which part of a figure: Shapley shares over simulations without them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from typing import Final

from turtlelog.errors import ExplainError
from turtlelog.explain.identify import identify_run
from turtlelog.explain.mechanisms import MECHANISMS, find_mechanism, simulate_without
from turtlelog.measure import METRICS, measure_run, suggest_metrics
from turtlelog.run import Run
from turtlelog.scenario import Scenario

DEFAULT_METRIC: Final = "final.position_error"

DEFAULT_MECHANISMS: Final = ("queue", "pause")
"""The two that accumulate."""

_MOST: Final = 6
"""Players; each doubles the simulations."""

_Coalition = frozenset[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """The part of one mechanism.

    Attributes:
        mechanism: Its name.
        share: Its Shapley share of as_built - without_all, in the metric's unit; negative where it
            makes the figure smaller. None where it is no player.
        alone: The metric with this mechanism out and all others in; None where it has no value.
    """

    mechanism: str
    share: float | None
    alone: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution:
    """What caused a figure.

    Attributes:
        metric: Its id.
        unit: Its unit.
        as_built: With all mechanisms in.
        without_all: With all players out.
        shares: Of the players, in their order; `math.fsum` of them is as_built - without_all.
        others: What is no player: the figure with this one alone taken out.
        interaction: as_built - without_all, less what each player adds where all others are out:
            the part that they make only together.
        bound: What the heading tolerance alone may leave of the figure, None where it is no error
            of the heading's making.
    """

    metric: str
    unit: str
    as_built: float
    without_all: float
    shares: tuple[Share, ...]
    others: tuple[Share, ...]
    interaction: float
    bound: float | None = None


def attribute_run(
    run: Run, *, metric: str = DEFAULT_METRIC, mechanisms: Sequence[str] = DEFAULT_MECHANISMS
) -> Attribution:
    """Identify the scenario of a run, and attribute one of its figures to mechanisms.

    Raises:
        ExplainError: Where the scenario cannot be identified, or as in `attribute_scenario`.
    """
    scenario = identify_run(run).build_scenario()
    return attribute_scenario(scenario, metric=metric, mechanisms=mechanisms)


def attribute_scenario(
    scenario: Scenario,
    *,
    metric: str = DEFAULT_METRIC,
    mechanisms: Sequence[str] = DEFAULT_MECHANISMS,
) -> Attribution:
    """Attribute a figure of a scenario to mechanisms.

    A share is a Shapley value (Shapley, "A value for n-person games", 1953): what a mechanism adds
    to the figure, averaged over all orders in which the players can be put in. All 2^n sets of
    players are simulated.

    Raises:
        ExplainError: Where a metric or mechanism is not known, a mechanism stands twice, there are
            none or too many, the scenario is of another law, or the figure has no value.
    """
    require_players(metric, mechanisms)
    if scenario.law.kind != "sequential-p":
        raise ExplainError(
            f"{scenario.name}: expected a run of the law sequential-p, found {scenario.law.kind}"
        )
    values = {
        inside: _require_value(scenario, metric, inside, mechanisms)
        for inside in _list_coalitions(mechanisms)
    }
    everything, nothing = frozenset(mechanisms), _Coalition()
    total = Fraction(values[everything]) - Fraction(values[nothing])
    exact = {name: _compute_share(values, name, mechanisms) for name in mechanisms}
    singles = [Fraction(values[_Coalition({name})]) for name in mechanisms]
    interaction = total - sum(value - Fraction(values[nothing]) for value in singles)
    shares = tuple(
        Share(mechanism=name, share=share, alone=values[everything - {name}])
        for name, share in zip(mechanisms, _round_shares([*exact.values()], total), strict=True)
    )
    others = [name for name in MECHANISMS if name not in mechanisms]
    return Attribution(
        metric=metric,
        unit=METRICS[metric].unit,
        as_built=values[everything],
        without_all=values[nothing],
        shares=shares,
        others=tuple(
            Share(mechanism=name, share=None, alone=_measure(scenario, metric, [name])[0])
            for name in others
        ),
        interaction=float(interaction),
        bound=None if "tolerance" in mechanisms else _bound_remainder(scenario, metric),
    )


def require_players(metric: str, mechanisms: Sequence[str]) -> None:
    """Require a metric that is known, and different mechanisms that are.

    Raises:
        ExplainError: Where they are not; with the names nearest to it.
    """
    if metric not in METRICS:
        raise ExplainError(f"metric {metric!r}: expected {suggest_metrics(metric)}")
    for name in mechanisms:
        find_mechanism(name)
    if not 0 < len(mechanisms) <= _MOST or len({*mechanisms}) < len(mechanisms):
        raise ExplainError(
            f"mechanisms: expected 1 to {_MOST} different ones, found {', '.join(mechanisms)}"
        )


def _bound_remainder(scenario: Scenario, metric: str) -> float | None:
    tolerance_rad = scenario.law.parameters.heading_tolerance_rad
    if metric.startswith("final.heading_error"):
        return math.degrees(tolerance_rad)
    if not metric.startswith("final.position_error"):
        return None
    start, goal = scenario.start, scenario.goal
    return float(tolerance_rad * math.hypot(goal.x_m - start.x_m, goal.y_m - start.y_m))


def _list_coalitions(mechanisms: Sequence[str]) -> list[_Coalition]:
    return [
        frozenset(inside)
        for size in range(len(mechanisms) + 1)
        for inside in combinations(mechanisms, size)
    ]


def _require_value(
    scenario: Scenario, metric: str, inside: _Coalition, mechanisms: Sequence[str]
) -> float:
    out = [name for name in mechanisms if name not in inside]
    value, reason = _measure(scenario, metric, out)
    if value is None:
        without = f" without {' and '.join(out)}" if out else ""
        raise ExplainError(f"{metric}: expected a value{without}, found none: {reason}")
    return value


def _measure(scenario: Scenario, metric: str, out: Sequence[str]) -> tuple[float | None, str]:
    found = measure_run(simulate_without(scenario, out), only=[metric])[metric]
    return found.value, found.reason


def _compute_share(
    values: Mapping[_Coalition, float], name: str, mechanisms: Sequence[str]
) -> Fraction:
    count = len(mechanisms)
    share = Fraction(0)
    for others in _list_coalitions([other for other in mechanisms if other != name]):
        orders = math.factorial(len(others)) * math.factorial(count - len(others) - 1)
        adds = Fraction(values[others | {name}]) - Fraction(values[others])
        share += Fraction(orders, math.factorial(count)) * adds
    return share


def _round_shares(exact: list[Fraction], total: Fraction) -> list[float]:
    """Return the shares as floats whose exact sum rounds to the total's nearest float.

    The smallest that is not 0 takes up what rounding the others leaves: its own steps are finest.
    """
    shares = [float(share) for share in exact]
    last = min(range(len(shares)), key=lambda row: abs(shares[row]) or math.inf)
    others = sum((Fraction(share) for row, share in enumerate(shares) if row != last), Fraction())
    shares[last] = float(total - others)
    return shares
