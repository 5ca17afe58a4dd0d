"""From a failed check to the signal that violated it, its band, and where it left it."""

import numpy as np
import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from turtlelog.charts.curve_marks import ViolatedSignal
from turtlelog.check import CheckResult, match_run
from turtlelog.check.spec import Tolerances
from turtlelog.check.violation import find_violated_signal
from turtlelog.compare import Tolerance
from turtlelog.measure import read_signal

RUN = simulate("paper-kp10")


def judge(**check: str) -> CheckResult:
    spec = tl.parse_spec({"checks": {"track": check}})
    (result,) = tl.check_runs(spec, [("kp10.mcap", RUN)])
    return result


def find(result: CheckResult) -> ViolatedSignal:
    signal = find_violated_signal(RUN, result).signal
    assert signal is not None
    return signal


def test_the_magnitude_of_a_signal_is_a_band_of_two_sides() -> None:
    result = judge(holds="always(abs(cross_track) <= 0.005)")
    found, recorded = find(result), read_signal(RUN, "cross_track")
    assert recorded is not None
    assert found.title == "cross_track [m]"
    assert found.describe_limits() == {"low": "limit -0.005 m", "high": "limit 0.005 m"}
    inside = found.curve.time_ns >= RUN.start_ns
    np.testing.assert_array_equal(found.outside[inside], np.abs(found.curve.values[inside]) > 0.005)
    assert found.first.time_s == result.first_violation_s
    assert (found.worst.time_s, abs(found.worst.value)) == (result.value_s, result.value)
    assert found.describe_moment(found.worst, found.worst_word) == "worst -0.10774 m at 8.784 s"


@pytest.mark.parametrize(
    ("holds", "title", "limits"),
    [
        (
            "always(-0.1 <= cross_track <= 0.002)",
            "cross_track [m]",
            {"low": "limit -0.1 m", "high": "limit 0.002 m"},
        ),
        (
            "always(-0.1 <= cross_track and cross_track <= 0.002)",
            "cross_track [m]",
            {"low": "limit -0.1 m", "high": "limit 0.002 m"},
        ),
        (
            "not eventually(cross_track < -0.1 or cross_track > 0.002)",
            "cross_track [m]",
            {"low": "limit -0.1 m", "high": "limit 0.002 m"},
        ),
        (
            "always(cross_track >= -0.1 or cross_track <= 0.002 and speed < 0.0)",
            "cross_track [m]",
            {"low": "limit -0.1 m"},
        ),
        (
            "always(not cross_track < -0.1 and cross_track <= 0.3*speed + 1)",
            "cross_track [m]",
            {"low": "limit -0.1 m"},
        ),
        (
            "always(abs(cross_track) <= 0.005 and speed <= 0.5)",
            "speed [m/s]",
            {"high": "limit 0.5 m/s"},
        ),
        ("not eventually(speed > 0.9)", "speed [m/s]", {"high": "limit 0.9 m/s"}),
        ("always(speed < 1.0)", "speed [m/s]", {"high": "limit 1 m/s"}),
        (
            "always(phase == 'translate' implies abs(heading_error) <= rad(0.01))",
            "heading_error [deg]",
            {"low": "limit -0.01 deg", "high": "limit 0.01 deg"},
        ),
        (
            "always(abs(speed) <= 0.3*distance)",
            "speed [m/s]",
            {"low": "lower limit, moving", "high": "upper limit, moving"},
        ),
    ],
)
def test_the_comparison_that_decides_gives_signal_and_band_in_the_unit_of_the_message(
    holds: str, title: str, limits: dict[str, str]
) -> None:
    found = find(judge(holds=holds))
    assert (found.title, found.describe_limits()) == (title, limits)
    assert found.outside.any()


def test_rows_that_the_formula_does_not_ask_about_are_not_outside() -> None:
    found = find(judge(holds="always(phase == 'translate' implies abs(heading_error) <= 0.0)"))
    turning = found.curve.time_s < found.first.time_s
    assert (np.abs(found.curve.values[turning]) > 1.0).any()
    assert not found.outside[turning].any()
    early = find(judge(holds="always[0, 2](abs(heading_error) <= 0.01)"))
    assert early.curve.time_s[early.outside].max() <= 2.0


def test_what_never_came_tells_how_near_it_came() -> None:
    found = find(judge(holds="eventually(distance <= 0.01)"))
    assert found.describe_moment(found.worst, found.worst_word) == "nearest 0.10671 m at 9.984 s"
    assert found.first.time_s == pytest.approx(12.608)


@pytest.mark.parametrize("time_s", [0.0, 0.3])
def test_a_tolerance_is_a_tube_around_the_reference(time_s: float) -> None:
    tolerances = Tolerances(signals={"heading": Tolerance(abs=0.02, time_s=time_s)})
    (result,) = match_run(RUN, simulate("paper-kp4"), tolerances)
    found = find(result)
    assert found.unit == "deg"
    assert found.is_moving
    assert found.low is not None
    assert found.high is not None
    beyond = np.maximum(found.low - found.curve.values, found.curve.values - found.high)
    np.testing.assert_array_equal(found.outside, beyond > 1e-9)
    assert np.radians(beyond.max()) == pytest.approx((result.value or 0.0) - 0.02)
    assert (found.first.time_s, found.worst.time_s) == (result.first_violation_s, result.value_s)


@pytest.mark.parametrize(
    ("expect", "title", "rows"),
    [
        ("final.position_error <= 0.05", "distance [m]", 1),
        ("final.heading_error < 0.1", "heading_error [deg]", 1),
        ("run.cross_track_max <= 0.005", "cross_track [m]", 585),
    ],
)
def test_a_metric_that_is_the_value_of_a_signal_has_a_band(
    expect: str, title: str, rows: int
) -> None:
    result = judge(expect=expect)
    found = find(result)
    assert (found.title, int(found.outside.sum())) == (title, rows)
    assert abs(found.worst.value) == pytest.approx(result.value)
    assert found.first.time_s == pytest.approx(result.first_violation_s)


@pytest.mark.parametrize(
    ("check", "reason"),
    [
        ({"expect": "rotate.settling_time < 1"}, "a metric and no signal's value at a moment"),
        ({"expect": "rotate.overshoot <= 0 and run.path_length < 1"}, "no single moment"),
        ({"expect": "final.position_error > 1"}, "no signal stays below its limit"),
        ({"holds": "always(phase == 'pause')"}, "no band around a signal"),
        ({"holds": "always(abs(speed) >= 2)"}, "no band around a signal"),
        ({"holds": "always(final.position_error <= 0)"}, "asked for without always"),
        ({"holds": "always(sensed_x > 0)"}, "undecided: "),
        ({"holds": "always(speed <= 2)"}, "was not violated"),
    ],
)
def test_where_no_signal_is_violated_there_is_none_and_the_reason(
    check: dict[str, str], reason: str
) -> None:
    found = find_violated_signal(RUN, judge(**check))
    assert found.signal is None
    assert reason in found.reason
