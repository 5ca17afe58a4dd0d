import math
from fractions import Fraction

import pytest
from hypothesis import example, given, strategies as st

from turtlelog.explain.contributions import (
    Worth,
    compute_contributions,
    compute_dividends,
    find_smallest,
)
from turtlelog.explain.game import list_coalitions

VALUES = st.floats(-1e3, 1e3) | st.floats(-1e-3, 1e-3) | st.sampled_from([0.0, 0.1, 0.3, 1e-17])


@st.composite
def draw_worth(draw: st.DrawFn) -> tuple[Worth, list[str]]:
    causes = list("abcd")[: draw(st.integers(1, 4))]
    return {inside: draw(VALUES) for inside in list_coalitions(causes)}, causes


def name(*names: str) -> frozenset[str]:
    return frozenset(names)


TIE = {name(): 0.1, name("a"): 0.3, name("b"): 1e-17, name("a", "b"): 1.0}


@given(draw_worth())
@example((TIE, ["a", "b"]))
def test_shares_add_up_but_for_one_step_of_the_smallest(game: tuple[Worth, list[str]]) -> None:
    worth, causes = game
    shares = compute_contributions(worth, causes)
    total = worth[frozenset(causes)] - worth[frozenset()]
    smallest = min(map(abs, filter(None, shares.values())), default=0.0)
    missed = abs(math.fsum(shares.values()) - total)
    assert missed <= math.ulp(smallest)
    if smallest <= abs(total):
        assert missed == 0.0


@given(draw_worth())
def test_shares_are_those_of_all_orders(game: tuple[Worth, list[str]]) -> None:
    worth, causes = game
    dividends = {
        frozenset(names): value for names, value in compute_dividends(worth, causes).items()
    }
    largest = max(map(abs, worth.values()))
    for cause, share in compute_contributions(worth, causes).items():
        alone = float(Fraction(worth[name(cause)]) - Fraction(worth[name()]))
        parts = [value / len(names) for names, value in dividends.items() if cause in names]
        rounding = 1e-13 * largest + len(parts) * math.ulp(0.0)  # each part may be the least number
        assert share == pytest.approx(alone + math.fsum(parts), abs=rounding)


def test_what_two_make_only_together_is_their_dividend() -> None:
    worth = {name(): 1.0, name("a"): 2.0, name("b"): 4.0, name("a", "b"): 10.0}
    assert compute_dividends(worth, ["a", "b"]) == {("a", "b"): 5.0}
    assert compute_contributions(worth, ["a", "b"]) == {"a": 3.5, "b": 5.5}


def test_a_cause_that_changes_nothing_has_no_share() -> None:
    worth = {name(): 0.1, name("a"): 0.7, name("b"): 0.1, name("a", "b"): 0.7}
    assert compute_contributions(worth, ["a", "b"])["b"] == 0.0


def test_the_smallest_sets_hold_no_other() -> None:
    found = find_smallest([name("a", "b", "c"), name("c"), name("a", "b"), name("b", "c")])
    assert found == [name("c"), name("a", "b")]
