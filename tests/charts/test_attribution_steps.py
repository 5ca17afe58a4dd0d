from dataclasses import replace
from functools import cache
from itertools import pairwise

import pytest

from turtlelog.charts.attribution_steps import choose_step_scale, list_attribution_steps
from turtlelog.explain import (
    Attribution,
    Contribution,
    Resolution,
    ResolutionReason,
    SeedRange,
    attribute_scenario,
)
from turtlelog.scenario import get_preset


@cache
def attribute_kp10(metric: str = "final.position_error") -> Attribution:
    found = attribute_scenario(get_preset("paper-kp10"), metric=metric)
    return replace(found, as_logged=found.resimulated)


def make_attribution(**changes: object) -> Attribution:
    """Return 10 deg, of which `a` adds 8 and `b` takes away 3."""
    found = Attribution(
        metric="rotate.rms_error",
        unit="deg",
        as_logged=10.0,
        resimulated=10.0,
        without_all=5.0,
        causes=("b", "a"),
        contributions=(make_share("b", -3.0), make_share("a", 8.0)),
        others=(),
        resolution=Resolution(size=0.1, reason=ResolutionReason.SHARE),
    )
    return replace(found, **changes)  # type: ignore[arg-type]


def make_share(name: str, share: float, standard_error: float | None = None) -> Contribution:
    return Contribution(
        cause=name, contribution=share, alone=None, meaning="", standard_error=standard_error
    )


@pytest.mark.thorough
def test_the_steps_lead_from_the_logged_value_to_what_the_tolerances_leave() -> None:
    steps = list_attribution_steps(attribute_kp10())
    assert [(step.kind, step.name, step.text) for step in steps] == [
        ("total", "as recorded", "106.7 mm"),
        ("contribution", "queue", "+51.1 mm (48 %)"),
        ("contribution", "pause", "+50.6 mm (47 %)"),
        ("left", "left", "5.1 mm (5 %), no more than the tolerances leave"),
    ]
    assert len({step.color for step in steps}) == 4


@pytest.mark.everyday("translate.overshoot")
@pytest.mark.parametrize("metric", ["final.position_error", "run.duration", "translate.overshoot"])
def test_each_bar_begins_where_the_one_before_ends(metric: str) -> None:
    total, *shares, left = list_attribution_steps(attribute_kp10(metric))
    assert shares[0].start == total.end
    assert all(one.end == other.start for one, other in pairwise(shares))
    assert shares[-1].end == pytest.approx(left.end, rel=1e-9)


def test_the_largest_contribution_is_first_and_what_takes_away_leads_up() -> None:
    _, first, second, left = list_attribution_steps(make_attribution())
    assert (first.cause, first.start, first.end, first.text) == (
        "a",
        10.0,
        2.0,
        "+8.00 deg (80 %)",
    )
    assert (second.cause, second.end, second.text) == ("b", 5.0, "-3.00 deg (-30 %)")
    assert left.text == "5.00 deg (50 %), without a and b"


def test_a_cause_without_a_contribution_has_no_bar() -> None:
    found = make_attribution(contributions=(make_share("b", 5e-9), make_share("a", 5.0)))
    assert [step.name for step in list_attribution_steps(found)] == ["as recorded", "a", "left"]


def test_withheld_shares_have_no_steps() -> None:
    assert list_attribution_steps(make_attribution(withheld="they differ", contributions=())) == ()


def test_a_run_that_no_effect_changes_has_two_bars() -> None:
    found = make_attribution(contributions=(), causes=(), without_all=10.0)
    total, left = list_attribution_steps(found)
    assert (total.text, left.text) == ("10.00 deg", "10.00 deg, no effect changes it")


def test_a_difference_between_log_and_simulation_is_a_step() -> None:
    _, differs, first, *_ = list_attribution_steps(make_attribution(as_logged=10.2))
    assert (differs.name, differs.cause, differs.text) == (
        "log only",
        "",
        "+0.20 deg, not re-simulated",
    )
    assert (differs.end, first.start) == (10.0, 10.0)


def test_random_effects_go_through_the_mean_and_tell_its_error() -> None:
    found = make_attribution(
        seeds=SeedRange(count=32, used=32, mean=8.0, standard_error=0.1, low=6.0, high=11.0),
        contributions=(make_share("a", 2.9, 0.25), make_share("b", 0.1, 0.05)),
    )
    texts = {step.name: step.text for step in list_attribution_steps(found)}
    assert texts["this seed"] == "+2.00 deg, beside the mean over seeds"
    assert texts["a"] == "+2.90 deg ± 0.25 (29 %)"
    assert texts["b"] == "+0.10 deg ± 0.05 (1 %), may be chance"


def test_of_a_simulated_scenario_the_value_is_not_called_logged() -> None:
    assert list_attribution_steps(make_attribution(as_logged=None))[0].name == "as simulated"


@pytest.mark.parametrize(
    ("unit", "value", "text"),
    [
        ("m", 0.5, "500.0 mm"),
        ("m", 1.0, "1.000 m"),
        ("s", 12.608, "12.61 s"),
        ("1", 13.0, "13.00"),
        ("%", 0.0, "0 %"),
    ],
)
def test_values_have_four_digits_in_a_unit_of_use(unit: str, value: float, text: str) -> None:
    found = make_attribution(
        unit=unit, as_logged=value, resimulated=value, without_all=0.0, contributions=()
    )
    assert choose_step_scale(found).format_value(value) == text


def test_a_small_rest_is_never_written_as_nothing() -> None:
    scale = choose_step_scale(make_attribution())
    assert scale.format_value(0.004) == "0.004 deg"
    assert scale.format_value(0.006) == "0.01 deg"


@pytest.mark.parametrize(("value", "says"), [(0.1, True), (0.11, False)])
def test_a_value_within_the_tolerances_says_so(value: float, *, says: bool) -> None:
    found = make_attribution(
        metric="final.heading_error",
        as_logged=value,
        resimulated=value,
        without_all=value,
        contributions=(),
        resolution=Resolution(size=0.1, reason=ResolutionReason.HEADING_TOLERANCE),
    )
    for step in list_attribution_steps(found):
        assert ("no more than the tolerances leave" in step.text) == says


@pytest.mark.parametrize(("share", "count"), [(0.9e-5, 2), (1.1e-5, 3)])
def test_a_share_of_a_millionth_is_no_step(share: float, count: int) -> None:
    found = make_attribution(contributions=(make_share("a", share),), without_all=10.0)
    assert len(list_attribution_steps(found)) == count


@pytest.mark.parametrize(("share", "text"), [(99.9, "+99.90 deg (999 %)"), (100.1, "+100.10 deg")])
def test_a_part_of_ten_times_the_value_has_no_percentage(share: float, text: str) -> None:
    found = make_attribution(contributions=(make_share("a", share),))
    assert list_attribution_steps(found)[1].text == text


@pytest.mark.parametrize(("names", "told"), [("ab", "a and b"), ("abc", "all of these")])
def test_the_last_bar_names_two_causes(names: str, told: str) -> None:
    found = make_attribution(
        causes=tuple(names), contributions=tuple(make_share(name, 1.0) for name in names)
    )
    assert list_attribution_steps(found)[-1].text == f"5.00 deg (50 %), without {told}"


@pytest.mark.parametrize(("alone", "count"), [(6.3, 2), (6.2, 3)])
def test_a_design_parameter_that_changes_more_than_all_effects_has_a_bar(
    alone: float, count: int
) -> None:
    # The effects add 3 deg; a change of 1.25 times as much counts as larger.
    other = replace(make_share("saturation", 0.0), contribution=None, alone=alone)
    steps = list_attribution_steps(
        make_attribution(
            causes=("a",), contributions=(make_share("a", 3.0),), without_all=7.0, others=(other,)
        )
    )
    assert len(steps) == count + 1
    if count == 3:
        assert steps[-1].name == "without saturation"
        assert steps[-1].text == "6.20 deg (62 %), a design parameter"
        assert steps[-1].start == 0.0
