# ruff: noqa: PLR0124, SIM201, SIM202, SIM300
"""A metric is compared as the number that it is; one without a value never passes."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from turtlelog.check import CheckResult
from turtlelog.check.result import watch_metric

RUN = simulate("paper-kp10")
OVERSHOOT = tl.measure_run(RUN)["rotate.overshoot"].value or 0.0
MISSING = "rotate.decay_ratio"

Ask = Callable[[Any], object]

TRUE: dict[str, Ask] = {
    "order": lambda m: 0.5 < m <= OVERSHOOT and OVERSHOOT >= m > 0.5,
    "equal": lambda m: m == OVERSHOOT and OVERSHOOT == m and not m != OVERSHOOT,
    "unequal": lambda m: m != 0 and 0 != m and not m == 0 and not 0 == m,
    "itself": lambda m: m == m and not m != m and m <= m,
    "numpy": lambda m: np.float32(0.5) < m < np.int64(2) and m < np.float64(2) and 2 > m,
    "approx": lambda m: m == pytest.approx(1, abs=0.1) and pytest.approx(1, abs=0.1) == m,
    "not approx": lambda m: m != pytest.approx(9) and pytest.approx(9) != m,
    "inside approx": lambda m: not m != pytest.approx(1, abs=0.1),
    "approx of it": lambda m: OVERSHOOT == pytest.approx(m) and m == pytest.approx(m),
    "float": lambda m: math.isclose(m, OVERSHOOT) and float(m) == OVERSHOOT,
    "magnitude": lambda m: abs(m) == OVERSHOOT and abs(abs(m)) == OVERSHOOT,
    "arithmetic": lambda m: 1 + m - 1 == m / 1 == 1 * m == m * 1 == pytest.approx(OVERSHOOT),
    "more": lambda m: -m == 0 - m and 1 / m == 1 / OVERSHOOT and sum([m, m]) == 2 * OVERSHOOT,
    "power": lambda m: m**2 == OVERSHOOT**2 and 2**m == 2**OVERSHOOT and +m == OVERSHOOT,
    "rounded": lambda m: round(m, 2) == round(OVERSHOOT, 2) and round(m) == round(OVERSHOOT),
    "among": lambda m: m in [0, OVERSHOOT],
}

WRONG: dict[str, tuple[Ask, str]] = {
    "truth": (bool, "compare it with a limit"),
    "not": (lambda m: not m, "compare it with a limit"),
    "none": (lambda m: m != None, "a number after !=, found None"),  # noqa: E711
    "none left": (lambda m: None == m, "a number after ==, found None"),  # noqa: E711
    "text": (lambda m: m != "1", "a number after !=, found '1'"),
    "true": (lambda m: m < True, "a number after <, found True"),
    "array": (lambda m: m < np.ones(1), r"a number after <, found array\(\[1.\]\)"),
    "array left": (lambda m: np.ones(1) > m, r"a number after <, found array\(\[1.\]\)"),
    "complex": (lambda m: m != 1j, "a number after !=, found 1j"),
    "nan": (lambda m: m != math.nan, "a number after !=, found nan"),
    "nan of numpy": (lambda m: np.float32("nan") != m, "a number after !=, found nan"),
    "huge": (lambda m: m < 10**400, "a number after <, found one too large for a float"),
}

ASKED: dict[str, Ask] = {
    **TRUE,
    **{name: ask for name, (ask, _) in WRONG.items() if name not in {"truth", "not"}},
    "+": lambda m: 1 + m,
    "-": lambda m: m - 1,
    "/": lambda m: 1 / m,
    "negative": lambda m: -m,
    "less": lambda m: m < 1e9,
    "greater left": lambda m: 1e9 > m,
    "between": lambda m: -1e9 < m < 1e9,
    "largest": lambda m: max(0, m),
    "isnan": math.isnan,
}


def measure(name: str = "rotate.overshoot", noted: list[CheckResult] | None = None) -> tl.Metric:
    return watch_metric(RUN, "a.mcap", name, ([] if noted is None else noted).append)


@pytest.mark.parametrize("ask", TRUE.values(), ids=TRUE)
def test_a_metric_is_compared_as_a_number_is(ask: Ask) -> None:
    assert ask(measure())


@pytest.mark.parametrize(("ask", "message"), WRONG.values(), ids=WRONG)
def test_what_is_no_limit_is_refused(ask: Ask, message: str) -> None:
    with pytest.raises(tl.errors.CheckError, match=message):
        ask(measure())


@pytest.mark.parametrize("ask", ASKED.values(), ids=ASKED)
def test_whatever_is_asked_of_a_metric_without_a_value_fails_with_the_reason(ask: Ask) -> None:
    noted: list[CheckResult] = []
    with pytest.raises(tl.errors.MissingValueError, match=r"not_reached \(.*\)"):
        ask(measure(MISSING, noted))
    assert [result.verdict for result in noted] == ["FAIL"]


def test_a_comparison_with_a_metric_without_a_value_fails_on_either_side() -> None:
    share, missing = measure("rotate.saturated_share"), measure(MISSING)
    with pytest.raises(tl.errors.MissingValueError, match=f"{MISSING}: expected a number"):
        assert share < missing
    with pytest.raises(
        tl.errors.MissingValueError, match=f"{MISSING}: expected < <Metric rotate.saturated"
    ):
        assert missing < share


def test_every_comparison_is_noted_once_with_its_margin() -> None:
    noted: list[CheckResult] = []
    metric = measure(noted=noted)
    assert [metric < 2, metric < metric, metric == pytest.approx(2, abs=0.5)] == [
        True,
        False,
        False,
    ]
    margins = [result.margin for result in noted]
    assert margins == pytest.approx([2 - OVERSHOOT, 0.0, OVERSHOOT - 1.5])


def test_the_magnitude_of_a_negative_metric_is_violated_where_the_metric_is() -> None:
    noted: list[CheckResult] = []
    metric = measure("final.cross_track", noted)
    assert metric < 0
    assert not abs(metric) <= 0.05
    assert (noted[-1].check, noted[-1].value) == ("abs(final.cross_track)", -(metric.value or 0.0))
    assert noted[-1].first_violation_s == (RUN.end_ns - RUN.start_ns) / 1e9


def test_a_metric_is_formatted_as_a_number_or_says_what_it_lacks() -> None:
    assert f"{measure():.1f}" == f"{OVERSHOOT:.1f}"
    assert "not_reached" in f"{measure(MISSING):.1f}"
