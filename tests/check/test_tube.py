import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyfunnel
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

import turtlelog as tl
from tests.compare.runs import make_run

Values = NDArray[np.float64]
Window = Callable[[Values, Values, float, float], Values]

FIGURES = st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.25, 1.0, 1.5])
TIMES = st.lists(st.integers(1, 60), unique=True, max_size=12).map(
    lambda found: np.array([0, *sorted(found), 64]) / 8.0
)
LIMITS = st.fixed_dictionaries(
    {
        "abs": st.sampled_from([0.0, 0.125, 0.6]),
        "rel": st.sampled_from([0.0, 0.3, 1.0]),
        "time_s": st.sampled_from([0.0, 0.125, 0.5, 2.0, 100.0]),
    }
)


def draw_signal(data: st.DataObject) -> tuple[Values, Values]:
    time_s = data.draw(TIMES)
    values = data.draw(st.lists(FIGURES, min_size=len(time_s), max_size=len(time_s)))
    return time_s, np.array(values)


def judge(reference: tl.Run, run: tl.Run, signal: str, **limits: float) -> tl.check.CheckResult:
    tolerance = tl.Tolerance(reason="", **limits)
    tolerances = tl.Tolerances(signals={signal: tolerance})
    (result,) = tl.check.match_run(run, reference, tolerances, alignment="recorded")
    return result


def find_margins(
    reference: tuple[Values, Values],
    rows: tuple[Values, Values],
    limits: dict[str, float],
    list_values: Window,
) -> Values:
    """Return the margin of every row, one by one, as the definition says."""
    margins = []
    for at, value in zip(*rows, strict=True):
        start, end = at - limits["time_s"], at + limits["time_s"]
        allowed = list_values(*reference, start, end)
        if list_values is list_on_line:
            # Between these the margin is a straight line.
            corners = [value, 0.0, *np.array([-1.0, 1.0]) * limits["abs"] / (limits["rel"] or 1.0)]
            between = [v for v in corners if allowed.min() <= v <= allowed.max()]
            allowed = np.array([*allowed, *between])
        limit = np.maximum(limits["abs"], limits["rel"] * np.abs(allowed))
        margins.append(float((limit - np.abs(value - allowed)).max()))
    return np.array(margins)


def list_held(time_s: Values, values: Values, start: float, end: float) -> Values:
    held = max(int(np.searchsorted(time_s, start, side="right")) - 1, 0)
    inside = (time_s > start) & (time_s <= end)
    return np.array([values[held], *values[inside]])


def list_on_line(time_s: Values, values: Values, start: float, end: float) -> Values:
    ends = np.interp([start, end], time_s, values)
    return np.array([*ends, *values[(time_s >= start) & (time_s <= end)]])


def check_result(result: tl.check.CheckResult, at: Values, margins: Values) -> None:
    """Compare, but for rows whose margin is nothing but rounding."""
    assert result.margin == pytest.approx(margins.min(), abs=1e-9)
    if (np.abs(margins) > 1e-9).all():
        outside = at[margins < 0]
        assert bool(result) == (not len(outside))
        assert result.first_violation_s == (outside[0] if len(outside) else None)


@given(data=st.data(), limits=LIMITS)
@settings(max_examples=200, deadline=None)
def test_a_held_signal_is_judged_as_the_definition_says(
    data: st.DataObject, limits: dict[str, float]
) -> None:
    reference, run = draw_signal(data), draw_signal(data)
    runs = [
        make_run(time_s=(0.0, 8.0), speed_m_s=values, sample_time_s=time_s)
        for time_s, values in (reference, run)
    ]
    at = np.union1d(reference[0], run[0])
    rows = at, run[1][np.searchsorted(run[0], at, side="right") - 1]
    margins = find_margins(reference, rows, limits, list_held)
    check_result(judge(runs[0], runs[1], "speed", **limits), at, margins)


@pytest.mark.thorough
@given(data=st.data(), limits=LIMITS)
@settings(max_examples=200, deadline=None)
def test_a_line_is_judged_as_the_definition_says(
    data: st.DataObject, limits: dict[str, float]
) -> None:
    reference, run = draw_signal(data), draw_signal(data)
    at = np.union1d(reference[0], run[0])
    rows = at, np.interp(at, *run)
    margins = find_margins(reference, rows, limits, list_on_line)
    runs = [make_run(time_s=time_s, x_m=values) for time_s, values in (reference, run)]
    check_result(judge(runs[0], runs[1], "x", **limits), at, margins)


@given(data=st.data(), shift=st.sampled_from([-2, -1, 0, 1]))
@settings(max_examples=100, deadline=None)
def test_an_angle_passes_by_the_short_way_on_any_turn(data: st.DataObject, shift: int) -> None:
    time_s = data.draw(TIMES)
    steps = data.draw(st.lists(st.floats(-0.5, 0.5), min_size=len(time_s), max_size=len(time_s)))
    course = 3.0 + np.cumsum(steps)
    headings = [wrap(course), wrap(course + 0.01 + shift * 2.0 * math.pi)]
    runs = [make_run(time_s=time_s, x_m=course * 0.0, heading_rad=found) for found in headings]
    assert judge(runs[0], runs[1], "heading", abs=0.0101, time_s=0.001)
    result = judge(runs[0], runs[1], "heading", abs=0.0099)
    assert not bool(result)
    assert result.value == pytest.approx(0.01)


def wrap(angle_rad: Values) -> Values:
    return np.arctan2(np.sin(angle_rad), np.cos(angle_rad))


PERIOD_S = 0.016


@pytest.mark.parametrize(("signal", "slack_s"), [("x", 0.0), ("speed", PERIOD_S)])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_shift_in_time_passes_up_to_the_tolerance(
    signal: str, slack_s: float, sign: float
) -> None:
    """A held value says nothing of when in the period before it was reached."""
    time_s = np.arange(1000) * PERIOD_S

    def shift(by_s: float) -> tl.Run:
        values, at = time_s * 0.5, time_s + 1.0 + sign * by_s
        return make_run(time_s=at, x_m=values, sample_time_s=at, speed_m_s=values)

    for by_s, within in ((0.09, True), (0.1, True), (0.101 + slack_s, False)):
        assert bool(judge(shift(0.0), shift(by_s), signal, abs=1e-9, time_s=0.1)) == within
        assert bool(judge(shift(by_s), shift(0.0), signal, abs=1e-9, time_s=0.1)) == within


def test_a_held_signal_does_not_pass_by_a_value_that_it_jumps_over() -> None:
    time_s = np.arange(6) * 1.0
    jumping = make_run(
        time_s=(0.0, 5.0), sample_time_s=time_s, speed_m_s=[0.0, 1.0, 0.0, 1.0, 0.0, 1.0]
    )
    between = make_run(time_s=(0.0, 5.0), sample_time_s=time_s, speed_m_s=[0.5] * 6)
    result = judge(jumping, between, "speed", abs=0.4, time_s=1.5)
    assert (bool(result), result.first_violation_s) == (False, 0.0)
    assert result.margin == pytest.approx(-0.1)
    assert judge(jumping, between, "speed", abs=0.5, time_s=1.5)


def test_a_phase_passes_by_equality_within_the_time() -> None:
    time_s = np.arange(6) * 1.0
    runs = [
        make_run(time_s=(0.0, 5.0), sample_time_s=time_s, speed_m_s=[0.0] * 6, phase=phase)
        for phase in ([0, 0, 2, 2, 2, 2], [0, 0, 0, 0, 2, 2])
    ]
    assert judge(runs[0], runs[1], "phase", time_s=1.1)
    result = judge(runs[0], runs[1], "phase", time_s=0.9)
    assert (bool(result), result.first_violation_s, result.value) == (False, 3.0, 1.0)


@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(0.0, 0.4),
    abs_m=st.floats(0.05, 0.3),
    time_s=st.floats(0.05, 3.0),
)
@settings(max_examples=60, deadline=None)
def test_pyfunnel_agrees(
    seed: int, size: float, abs_m: float, time_s: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(0.2, 1.0, 30))
    reference = np.cumsum(rng.normal(0.0, 0.3, 30))
    run = reference + rng.uniform(-size, size, 30)
    # pyfunnel ends its funnel with the reference; both ends are kept level, where that is the same.
    at = np.array([at[0] - 4.0, *at, at[-1] + 4.0])
    reference, run = (np.array([v[0], *v, v[-1]]) for v in (reference, run))
    result = judge(
        make_run(time_s=at, x_m=reference),
        make_run(time_s=at, x_m=run),
        "x",
        abs=abs_m,
        time_s=time_s,
    )
    assert result.margin is not None
    folder = tmp_path_factory.mktemp("funnel")
    errors = read_errors(to_times(at), reference, run, folder, abs_m=abs_m, time_s=time_s)
    if abs(result.margin) > 1e-6:
        assert bool(result) == (max(errors) == 0.0)
    if result.margin < -1e-6:
        assert max(errors) == pytest.approx(-result.margin, abs=1e-6)


def to_times(at: Values) -> Values:
    return np.round(at * 1e9) / 1e9


def read_errors(
    at: Values, reference: Values, run: Values, folder: Path, *, abs_m: float, time_s: float
) -> Sequence[float]:
    """Return how far pyfunnel finds each row of the run outside its funnel."""
    failed = pyfunnel.compareAndReport(
        at, reference, at, run, outputDirectory=str(folder), atolx=time_s, atoly=abs_m
    )
    assert failed == 0
    lines = (folder / "errors.csv").read_text("utf-8").splitlines()[1:]
    return [float(line.split(",")[1]) for line in lines if line]
