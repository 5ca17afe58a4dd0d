import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from turtlelog.errors import ScenarioError
from turtlelog.laws import Pose
from turtlelog.laws.open_loop import (
    LARGEST,
    MOST_ROWS,
    PART as OPEN_LOOP,
    TAPS,
    USED_KEYS,
    OpenLoopParameters,
    generate_bits,
)

TICK_S = 0.016
TICK_NS = 16_000_000
POSE = Pose(5.0, 5.0, 0.0)


def change(**law: Any) -> tl.Scenario:
    """Return a scenario of this law without limits."""
    keys = {f"law.{key}": value for key, value in law.items()}
    free = {"limits.speed_m_s": math.inf, "limits.turn_rate_rad_s": math.inf}
    return tl.override_scenario(
        tl.load_scenario("textbook"), {"law.kind": "open-loop", **free, **keys}
    )


def command(parameters: OpenLoopParameters, times_s: list[float]) -> list[tuple[float, float]]:
    """Return speed and turn rate at times since the first sample, which is at 1 s."""
    law = OPEN_LOOP(parameters)
    law.reset(POSE, None, None)
    law.step(1_000_000_000, POSE)
    found = [law.step(1_000_000_000 + round(time_s * 1e9), POSE) for time_s in times_s]
    return [(one.speed_m_s, one.turn_rate_rad_s) for one in found]


def read_headings(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    run = tl.simulate_run(tl.load_scenario(name))
    return (run.poses.time_ns - run.start_ns) / 1e9, run.poses.heading_rad


@pytest.mark.parametrize("kind", ["impulse", "step", "ramp"])
def test_plant_runs_are_the_responses_of_the_papers_figure_2(kind: str) -> None:
    time_s, heading = read_headings(f"plant-{kind}")
    # 1, t and t^2 / 2. A command answers pose k and is held to pose k + 1: the impulse acts from
    # the second pose on, and the ramp falls back by half a period, t T / 2.
    responses = {
        "impulse": np.where(time_s > 0.0, 1.0, 0.0),
        "step": time_s,
        "ramp": time_s**2 / 2.0 - time_s * TICK_S / 2.0,
    }
    wanted = responses[kind]
    # Half a step of a 32-bit float between 2 and 4.
    assert np.abs(heading - wanted).max() <= 2.0**-23
    assert time_s[-1] == 2.4
    assert np.abs(heading).max() < math.pi


@pytest.mark.parametrize("kind", ["impulse", "step", "ramp"])
def test_plant_runs_end_by_themselves_at_rest(kind: str) -> None:
    run = tl.simulate_run(tl.load_scenario(f"plant-{kind}"))
    assert run.stop_reason == "end_of_signal"
    assert run.commands.turn_rate_rad_s[-1] == 0.0
    assert run.goal_xy_m is None
    assert run.declaration.loops == ()


def test_impulse_has_its_area_in_one_period() -> None:
    run = tl.simulate_run(change(signal="impulse", axis="speed", amplitude=0.5))
    assert (run.samples.speed_m_s != 0.0).sum() == 1
    assert run.samples.speed_m_s[0] * TICK_S == pytest.approx(0.5)
    assert run.poses.xy_m[-1, 0] - run.poses.xy_m[0, 0] == pytest.approx(0.5, abs=1e-6)


def test_impulse_is_as_wide_as_asked() -> None:
    parameters = OpenLoopParameters(signal="impulse", width_s=0.05, amplitude=2.0)
    found = command(parameters, [0.0, 0.049, 0.05, 0.051])
    assert [turn_rate for _, turn_rate in found] == [40.0, 40.0, 0.0, 0.0]


def test_limits_clip_an_impulse() -> None:
    scenario = tl.override_scenario(
        tl.load_scenario("plant-impulse"), {"limits.turn_rate_rad_s": 1.0}
    )
    run = tl.simulate_run(scenario)
    assert run.poses.heading_rad[-1] == pytest.approx(TICK_S)
    assert run.samples.wanted_turn_rate_rad_s is not None
    assert run.samples.wanted_turn_rate_rad_s[0] == 62.5


def test_signal_begins_at_its_start_and_ends_after_its_duration() -> None:
    parameters = OpenLoopParameters(signal="step", amplitude=0.5, start_s=1.0, duration_s=2.0)
    found = command(parameters, [0.0, 0.999, 1.0, 2.999, 3.0])
    assert [turn_rate for _, turn_rate in found] == [0.0, 0.0, 0.5, 0.5, 0.0]


def test_ramp_counts_from_its_start() -> None:
    parameters = OpenLoopParameters(signal="ramp", amplitude=-2.0, start_s=1.0, axis="speed")
    assert command(parameters, [0.5, 1.0, 2.5]) == [(0.0, 0.0), (0.0, 0.0), (-3.0, 0.0)]


def test_waiting_is_a_phase_where_the_signal_begins_later() -> None:
    run = tl.simulate_run(change(signal="step", start_s=0.5))
    starts = {span.phase: span.start_ns for span in run.find_phase_spans()}
    assert (starts["wait"], starts["excite"]) == (0, 512_000_000)
    assert tl.simulate_run(change(signal="step")).phase_names == ("excite", "pause", "done")


@pytest.mark.parametrize(
    ("axis", "wanted"), [("turn_rate", (0.0, 0.5)), ("speed", (0.5, 0.0)), ("both", (0.5, 0.5))]
)
def test_axis_says_which_command_acts(axis: Any, wanted: tuple[float, float]) -> None:
    parameters = OpenLoopParameters(signal="step", amplitude=0.5, axis=axis)
    assert command(parameters, [0.1]) == [wanted]


@pytest.mark.parametrize("order", TAPS)
def test_prbs_is_a_sequence_of_maximum_length(order: int) -> None:
    bits = np.array(generate_bits(order, 1))
    period = 2**order - 1
    assert len(bits) == period
    assert bits.sum() == 2 ** (order - 1)
    # Its autocorrelation is -1 everywhere but at 0, where it is the period.
    spectrum = np.abs(np.fft.fft(2.0 * bits - 1.0)) ** 2
    correlation = np.fft.ifft(spectrum).real
    assert correlation[0] == pytest.approx(period)
    assert correlation[1:] == pytest.approx(np.full(period - 1, -1.0), abs=1e-6)


@pytest.mark.parametrize("register", [2, 77, 127])
def test_register_shifts_the_sequence(register: int) -> None:
    usual, shifted = generate_bits(7, 1), generate_bits(7, register)
    assert shifted != usual
    assert shifted in [usual[place:] + usual[:place] for place in range(127)]


def test_prbs_of_three_bits_is_the_known_one() -> None:
    assert generate_bits(3, 1) == (1, 0, 0, 1, 0, 1, 1)


def test_prbs_holds_each_bit_and_begins_again() -> None:
    parameters = OpenLoopParameters(
        signal="prbs", order=3, bit_s=0.1, amplitude=2.0, duration_s=10.0
    )
    found = command(parameters, [0.1 * bit + late for bit in range(8) for late in (0.0, 0.099)])
    wanted = [2.0 if bit else -2.0 for bit in (1, 0, 0, 1, 0, 1, 1, 1) for _ in range(2)]
    assert [turn_rate for _, turn_rate in found] == wanted


def test_prbs_of_both_axes_hardly_correlates() -> None:
    run = tl.simulate_run(
        change(signal="prbs", axis="both", bit_s=TICK_S, order=9, duration_s=511 * TICK_S)
    )
    speed, turn_rate = run.samples.speed_m_s[:511], run.samples.turn_rate_rad_s[:511]
    assert set(speed) == set(turn_rate) == {-0.5, 0.5}
    assert (speed * turn_rate).sum() / 0.25 == -1.0


def test_sequence_holds_each_row_until_the_next_and_ends_with_the_last() -> None:
    parameters = OpenLoopParameters(
        signal="sequence", time_s=(0.5, 1.0, 2.0), speed_m_s=(1.0, 2.0, 3.0)
    )
    found = command(parameters, [0.0, 0.499, 0.5, 0.999, 1.0, 1.999, 2.0])
    assert [speed for speed, _ in found] == [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 3.0]
    assert {turn_rate for _, turn_rate in found} == {0.0}
    run = tl.simulate_run(change(signal="sequence", time_s=[0.0, 0.32], turn_rate_rad_s=[1.0, 0.5]))
    assert run.end_ns == 320_000_000
    assert run.commands.turn_rate_rad_s[-1] == 0.5


@pytest.mark.parametrize("signal", USED_KEYS)
def test_scenario_of_every_signal_keeps_its_text(signal: str) -> None:
    law: dict[str, Any] = {"signal": signal}
    if signal == "sequence":
        law |= {"time_s": [0.0, 1.0], "speed_m_s": [0.1, 1e-17]}
    scenario = change(**law)
    assert tl.parse_scenario(tl.format_scenario(scenario)) == scenario
    run = tl.simulate_run(scenario)
    assert tl.scenario.restore_scenario(run) == scenario


def test_longest_sequence_fits_in_a_recording(tmp_path: Any) -> None:
    # The longest numbers that there are: 24 letters as -1.2345678901234567e-100.
    rows = np.arange(MOST_ROWS)
    times = (rows * TICK_S + 1e-9).tolist()
    long = (-1.2345678901234567e-100 * (1.0 + rows * 1e-16)).tolist()
    scenario = change(signal="sequence", time_s=times, speed_m_s=long, turn_rate_rad_s=long)
    assert len(tl.format_scenario(scenario).encode()) < 82 * MOST_ROWS < 2**18
    short = tl.override_scenario(scenario, {"max_duration_s": 0.1})
    tl.write_recording(tl.simulate_run(short), tmp_path / "long.mcap")
    restored = tl.scenario.restore_scenario(tl.read_recording(tmp_path / "long.mcap"))
    assert restored == short


@pytest.mark.parametrize("signal", USED_KEYS)
def test_signal_refuses_the_keys_of_others(signal: Any) -> None:
    others: dict[str, Any] = {
        "amplitude": 1.0,
        "width_s": 1.0,
        "order": 7,
        "time_s": (0.0,),
        "bit_s": 1.0,
        "speed_m_s": (0.0,),
        "axis": "speed",
        "start_s": 0.0,
        "duration_s": 1.0,
    }
    for key, value in others.items():
        if key in USED_KEYS[signal]:
            continue
        with pytest.raises(ScenarioError) as caught:
            change(signal=signal, **{key: value})
        line = f"changes: law.{key}: expected a key of the signal {signal} ("
        assert str(caught.value).startswith(line)
        assert str(caught.value).endswith("), found one of another")


@pytest.mark.parametrize(
    ("law", "line"),
    [
        ({"amplitude": math.nan}, "amplitude: expected a finite number, found nan"),
        (
            {"amplitude": 1.1 * LARGEST},
            "amplitude: expected a number from -1000000 to 1000000, found 1100000.0",
        ),
        ({"start_s": -0.1}, "start_s: expected a number from 0 to 1000000, found -0.1"),
        ({"duration_s": 0.0}, "duration_s: expected a number from 1e-09 to 1000000, found 0.0"),
        ({"axis": "turn"}, "axis: expected turn_rate or speed or both, found 'turn'"),
        (
            {"signal": "prbs", "order": 8},
            "order: expected one of 2, 3, 4, 5, 6, 7, 9, 10, 11, 15, found 8",
        ),
        (
            {"signal": "prbs", "order": 3, "register": 8},
            "register: expected 1 to 7 at order 3, found 8",
        ),
        ({"signal": "prbs", "register": 0}, "register: expected 1 to 127 at order 7, found 0"),
        ({"signal": "sequence"}, "time_s: expected 1 to 2,500 rows, found 0"),
        (
            {"signal": "sequence", "time_s": [float(row) for row in range(MOST_ROWS + 1)]},
            "time_s: expected 1 to 2,500 rows, found 2,501",
        ),
        (
            {"signal": "sequence", "time_s": [0.0, 1.0], "speed_m_s": [1.0]},
            "speed_m_s: expected 2 values, as time_s has, found 1",
        ),
        (
            {"signal": "sequence", "time_s": [0.0, 2.0, 1.0]},
            "time_s: value 3: expected a time after 2, found 1.0",
        ),
        (
            {"signal": "sequence", "time_s": [0.0, 1e-10]},
            "time_s: value 2: expected a time after 0, found 1e-10",
        ),
        (
            {"signal": "sequence", "time_s": [-1.0]},
            "time_s: value 1: expected 0 or later, found -1",
        ),
        (
            {"signal": "sequence", "time_s": [0.0], "speed_m_s": [math.nan]},
            "speed_m_s: value 1: expected a number within +-1e+06, found nan",
        ),
        (
            {"signal": "sequence", "time_s": [0.0], "turn_rate_rad_s": [-math.inf]},
            "turn_rate_rad_s: value 1: expected a number within +-1e+06, found -inf",
        ),
    ],
)
def test_wrong_parameter_is_refused(law: dict[str, Any], line: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        change(**law)
    assert str(caught.value) == f"changes: law.{line}"


def test_law_forgets_its_run() -> None:
    law = OPEN_LOOP(OpenLoopParameters(signal="ramp"))
    for first_ns in (0, 7 * TICK_NS):
        law.reset(POSE, None, None)
        assert law.step(first_ns, POSE).turn_rate_rad_s == 0.0
        assert law.step(first_ns + TICK_NS, POSE).turn_rate_rad_s == TICK_S
