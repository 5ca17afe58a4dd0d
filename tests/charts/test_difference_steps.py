from dataclasses import replace

import pytest

import turtlelog as tl
from turtlelog.charts.attribution_steps import list_difference_steps
from turtlelog.charts.palette import FEW
from turtlelog.explain import Depth, ExplainedDifference, explain_difference
from turtlelog.scenario import get_preset

BRIEF = Depth(shows_effects=False, shows_starts=False)


@pytest.fixture(scope="module")
def found() -> ExplainedDifference:
    runs = [tl.simulate_run(get_preset(f"paper-kp{kp}")) for kp in (2, 10)]
    return explain_difference(*runs, depth=BRIEF)


def test_the_steps_go_from_the_first_value_to_the_second(found: ExplainedDifference) -> None:
    first, *between, second = list_difference_steps(found)
    assert (first.end, second.end) == (found.first.resimulated, found.second.resimulated)
    assert [step.name for step in between] == ["gains", "pause"]
    assert between[0].start == first.end
    assert between[0].end == between[1].start
    assert between[1].end == pytest.approx(second.end, abs=1e-12)
    texts = [step.text for step in (first, *between, second)]
    assert (first.color, second.color) == FEW[:2]
    assert texts == ["1.0 mm", "+107.1 mm", "-1.4 mm", "106.7 mm"]


def test_withheld_contributions_have_no_steps(found: ExplainedDifference) -> None:
    assert list_difference_steps(replace(found, contributions=(), withheld="they differ")) == ()
