import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from tests.check.formulas import HALF_NS, Column, Definition, formulas, signals
from turtlelog.check import FormulaResult, check_formula, check_run
from turtlelog.errors import ExpressionError
from turtlelog.expressions import Node, format_expression, parse_expression
from turtlelog.run import Run
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

SECOND_NS = 2 * HALF_NS
TIMES = np.arange(5) * SECOND_NS
X = (TIMES, np.array([0.0, 3.0, 1.0, 4.0, 2.0]))


def check(text: str, **trace: Any) -> FormulaResult:
    return check_formula({"x": X, **trace}, parse_expression(text))


@cache
def simulate_paper() -> Run:
    return simulate_run(get_preset("paper-kp10"))


def check_paper(text: str) -> FormulaResult:
    return check_run(simulate_paper(), parse_expression(text))


@settings(deadline=None)
@given(formulas, signals)
def test_verdicts_are_those_of_the_definitions(tree: Node, trace: dict[str, Column]) -> None:
    found = check_formula(trace, parse_expression(format_expression(tree)), window_ns=(0, 10**11))
    assert found.margin == Definition(tree, trace)(0)
    assert found.holds == (Definition(tree, trace, truth=True)(0) > 0)
    assert (found.first_violation_s is None) == found.holds


@settings(deadline=None)
@given(formulas, signals)
def test_what_always_holds_is_first_violated_where_its_body_is(
    tree: Node, trace: dict[str, Column]
) -> None:
    text = f"always({format_expression(tree)})"
    found = check_formula(trace, parse_expression(text), window_ns=(0, 10**11))
    truth = Definition(tree, trace, truth=True)
    failed = [moment / 2 for moment in range(80) if truth(moment) < 0]
    assert found.first_violation_s == (failed[0] if failed else None)


@settings(deadline=None)
@given(formulas, signals)
def test_the_margin_is_that_of_the_deciding_comparison_at_its_time(
    tree: Node, trace: dict[str, Column]
) -> None:
    found = check_formula(trace, parse_expression(format_expression(tree)), window_ns=(0, 10**11))
    assert found.margin is not None
    assert found.margin_s is not None
    decisive = parse_expression(found.decided_by).root
    there = Definition(decisive, trace)(round(found.margin_s * 2))
    assert abs(there) == abs(found.margin)
    assert found.value is not None
    assert found.limit is not None
    assert abs(found.value - found.limit) == abs(found.margin)


@pytest.mark.parametrize(
    ("text", "decided_by", "at_s"),
    [
        ("always(x < 5 and y < 5)", "y < 5", 2.0),
        ("always(x < 5) and always(y > -9)", "x < 5", 3.0),
        ("always(x > 3 or y > 3)", "y > 3", 0.0),
        ("always(x > 2.5 implies y > 3)", "x > 2.5", 3.0),
        ("not eventually(x > 3.5)", "x > 3.5", 3.0),
        ("always(0 <= x <= 5)", "0 <= x", 0.0),
        ("always(eventually[0, 1](x > 2))", "x > 2", 4.0),
        ("y < 6 until x > 3.5", "x > 3.5", 3.0),
        ("y < 4.2 until x > 3.5", "y < 4.2", 2.0),
        ("true and x < 1", "x < 1", 0.0),
        ("kind == 'q' and x < 1", 'kind == "q"', 0.0),
    ],
)
def test_a_finding_names_the_comparison_that_decides(
    text: str, decided_by: str, at_s: float
) -> None:
    y = (TIMES, np.array([1.0, 2.0, 4.5, 1.0, 1.0]))
    found = check(text, y=y, kind="p")
    assert (found.decided_by, found.margin_s) == (decided_by, at_s)


@pytest.mark.parametrize(
    ("text", "first_violation_s"),
    [
        ("x > 0", 0.0),
        ("always(x < 3.5)", 3.0),
        ("always[0, 2](x < 3.5)", None),
        ("always[1.5, 2.5](x < 3)", 1.5),
        ("always(x < 3)", 1.0),
        ("always(x <= 3)", 3.0),
        ("always(x >= 0)", None),
        ("always[3.5, 100](x > 5)", 3.5),
        ("always[3.5, 100](x > 3)", 4.0),
        ("eventually[0, 2](x > 3)", 2.0),
        ("eventually[0, 100](x > 5)", 4.0),
        ("always(x < 4) and eventually[0, 2](x > 3)", 2.0),
        ("x == 0 implies always(x < 3)", 1.0),
        ("x == 1 implies always(x < 3)", None),
        ("eventually[0, 1e300](x > 5)", 4.0),
        ("x < 3.5 until[9, 1e300] x > 5", 3.0),
        ("eventually[4, 100](x > 5)", 4.0),
        ("always[50, 100](x > 3) and always[2, 100](x > 3)", 2.0),
        ("x < 3.5 until x > 5", 3.0),
        ("x < 5 until[0, 2] x > 3.5", 2.0),
        ("not eventually(x > 3)", 3.0),
        ("not eventually[2, 3.5](x > 2)", 3.0),
        ("not always[1, 3](x < 9)", 3.0),
        ("x > 9 or always(x < 3)", 1.0),
        ("always(x > 2 implies eventually[0, 1](x < 1.5))", 3.0),
    ],
)
def test_the_first_violation_is_found(text: str, first_violation_s: float | None) -> None:
    found = check(text)
    assert found.first_violation_s == first_violation_s
    assert found.holds is (first_violation_s is None)


@pytest.mark.parametrize(
    "text",
    [
        *("always[50, 100](x > 3)", "always[1e300, inf](x > 3)", "eventually[4.5, 100](x > 5)"),
        *("x < 5 until[9, 1e300] x > 5", "x == 0 implies always[4.5, 5](x > 3)"),
        *("not always[50, 100](x < 9)", "not eventually[50, 100](x < 9)"),
        "x > 9 or always[50, 100](x > 9)",
    ],
)
def test_a_window_beyond_the_end_is_violated_at_no_recorded_time_and_says_so(text: str) -> None:
    found = check(text)
    assert (found.holds, found.first_violation_s) == (False, None)
    assert found.reason == "its window begins after the end, where the last values hold"


def test_a_margin_of_zero_is_decided_by_the_operator() -> None:
    assert (check("x <= 0").margin, check("x <= 0").holds) == (0.0, True)
    assert (check("x < 0").margin, check("x < 0").holds) == (0.0, False)
    assert check("not x < 0").holds
    assert check("x == 0").holds
    assert str(check("x == 0").margin) == "0.0"


def test_a_finding_holds_the_values_at_the_first_violation() -> None:
    phase = (TIMES[:4], np.array(["a", "a", "b", "b"]))
    found = check(
        "always(x < limit or phase == 'a')", limit=3.5, phase=phase, unused=(TIMES, TIMES)
    )
    assert found.first_violation_s == 3.0
    assert found.values == {"x": 4.0, "limit": 3.5, "phase": "b"}


def test_a_finding_holds_the_values_where_its_margin_comes_from() -> None:
    found = check("always(x < 5) and always(x > -9)")
    assert (found.margin, found.margin_s, found.values) == (1.0, 3.0, {"x": 4.0})


@pytest.mark.parametrize(
    ("text", "covered"),
    [
        ("always(x < 5)", True),
        ("eventually[0, 4](x < 5)", True),
        ("eventually[0, 4.1](x < 5)", False),
        ("always[0, 2](eventually[0, 2](x < 5))", True),
        ("always[0, 2](eventually[0, 2.5](x < 5))", False),
        ("always[5, inf](x < 5)", False),
        ("x < 5 until[0, 5] x > 3", False),
    ],
)
def test_a_finding_says_whether_the_trace_is_long_enough(text: str, covered: bool) -> None:  # noqa: FBT001
    assert check(text).is_covered is covered


@pytest.mark.parametrize(
    ("text", "holds", "margin"),
    [
        ("nothing > 1", None, None),
        ("always(nothing > 1)", None, None),
        ("nothing > 1 and x < 5", None, None),
        ("nothing > 1 or x < 5", True, 5.0),
        ("nothing > 1 and x > 5", False, -5.0),
        ("nothing > 1 implies x < 5", True, 5.0),
        ("not (nothing > 1 or x < 5)", False, -5.0),
        ("not (nothing > 1 and x > 5)", True, 5.0),
        ("always(1 / x > 0.3)", False, 0.25 - 0.3),
        ("always(1 / x > 0.2)", None, None),
        ("always(1 / x > 0.5)", False, 0.25 - 0.5),
        ("eventually(1 / x > 0.5)", True, 0.5),
    ],
)
def test_what_is_unknown_decides_nothing(text: str, holds: object, margin: float | None) -> None:
    found = check(text, nothing=None)
    assert (found.holds, found.margin) == (holds, margin)
    assert bool(found.reason) == (holds is None)


def test_the_reason_names_what_has_no_value() -> None:
    assert check("nothing > 1", nothing=None).reason == "no value: nothing"
    assert check("always(1 / x > 0.1)").reason == "a number has no value"


@pytest.mark.parametrize(
    ("text", "is_told"),
    [
        ("x < 3.5 until x > 3.5", True),
        ("x < 3.5 until[3, 4] x > 3.5", True),
        ("x < 3.5 until[3.1, 4] x > 3.5", False),  # begins before the window
        ("x < 3.5 until x > 5", False),
        ("x < 2.5 until x > 3.5", False),
    ],
)
def test_sides_of_until_that_only_meet_are_told(text: str, is_told: bool) -> None:  # noqa: FBT001
    found = check(text)
    assert found.holds is False
    told = "its left side ends when its right side begins, but must hold then too"
    assert found.reason == (told if is_told else "")


def test_what_has_no_distance_has_an_infinite_margin() -> None:
    found = check("kind == 'p' and x < 5", kind="p")
    assert found.margin == 5.0
    assert check("kind == 'p'", kind="p").margin == math.inf


def test_a_run_is_checked_over_its_signals_metrics_and_parameters() -> None:
    found = check_paper("always(abs(cross_track) <= 0.05)")
    assert found.holds is False
    assert found.margin == pytest.approx(0.05 - 0.107737, abs=1e-6)
    assert found.first_violation_s == pytest.approx(5.664)
    assert abs(found.values["cross_track"]) > 0.05
    assert check_paper("law.kp_linear >= 2 and final.position_error < 0.2").holds


def test_the_phase_of_a_run_is_text() -> None:
    assert check_paper("always(phase == 'rotate' implies speed == 0)").holds
    assert check_paper("eventually(phase == 'translate')").holds
    assert check_paper("phase == 'rotate' until (phase == 'rotate' and turn_rate < 0.5)").holds


def test_times_of_a_run_count_from_its_first_sample() -> None:
    run = simulate_paper()
    found = check_paper("always(phase == 'rotate')")
    first = int(np.argmax(run.samples.phase != 0))
    expected_s = (run.samples.time_ns[first] - run.samples.time_ns[0]) / 1e9
    assert found.first_violation_s == pytest.approx(expected_s)


def test_a_phase_of_a_run_is_checked_by_its_window() -> None:
    run = simulate_paper()
    span = run.find_phase_spans()[-1]
    formula = parse_expression("always(abs(cross_track) <= 0.05)")
    found = check_run(run, formula, window_ns=(span.start_ns, span.end_ns))
    whole = check_run(run, formula)
    assert found.first_violation_s is not None
    assert whole.first_violation_s == pytest.approx(
        found.first_violation_s + (span.start_ns - run.start_ns) / 1e9
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "always(cros_track < 1)",
            'column 8: unknown name "cros_track"; did you mean cross_track',
        ),
        ("final.positon_error < 1", "did you mean final.position_error"),
        ("law.kp_liner < 1", "did you mean law.kp_linear"),
        ("always(phase < 1)", "column 14: expected two of a kind around <"),
    ],
)
def test_wrong_names_in_a_run_are_found_with_the_nearest(text: str, problem: str) -> None:
    with pytest.raises(ExpressionError, match=problem):
        check_paper(text)


def test_a_signal_that_a_run_does_not_hold_is_unknown() -> None:
    run = simulate_paper()
    bare = Run(
        name="bare", source="test", poses=run.poses, commands=run.commands, samples=run.samples
    )
    found = check_run(bare, parse_expression("always(distance < 1)"))
    assert (found.holds, found.reason) == (None, "no value: distance (the goal is not known)")


def test_a_metric_without_a_value_passes_nothing() -> None:
    scenario = override_scenario(get_preset("paper-kp10"), {"max_duration_s": 1.0})
    formula = parse_expression("final.position_error_at_15s < 100")
    found = check_run(simulate_run(scenario), formula)
    assert (found.holds, found.reason) == (None, "no value: final.position_error_at_15s")


def test_formula_may_be_text_and_what_it_is_checked_on_a_run() -> None:
    run = simulate_run(get_preset("paper-kp4"))
    text = "always(abs(cross_track) <= 0.05)"
    found = check_formula(run, text)
    assert found == check_run(run, parse_expression(text)) == check_run(run, text)
    assert found.holds
    cut = check_formula(run, text, window_ns=(run.start_ns, run.start_ns + 10**9))
    assert cut == check_run(run, text, window_ns=(run.start_ns, run.start_ns + 10**9)) != found
    with pytest.raises(ExpressionError, match="column 8"):
        check_formula(run, "always(")
