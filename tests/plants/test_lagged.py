import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from turtlelog.plants import lagged
from turtlelog.plants.lagged import PART, LaggedKeys
from turtlelog.simulate.loop_parts import mirror

Command = tuple[int, float, float]
Values = NDArray[np.float64]
SECOND_NS = 1_000_000_000


class Robot:
    """The plant from (0, 0, 0) on, driven as the loop drives it."""

    def __init__(self, keys: LaggedKeys) -> None:
        self._settings = SimpleNamespace(plant=mirror(LaggedKeys).read(keys))
        self._state = PART.begin(keys, 0.0, 0.0, 0.0, is_rounded=False)
        self._rows = SimpleNamespace(waiting={}, new=[SimpleNamespace(waiting=PART.Waiting)])

    def take_command(self, time_ns: int, speed_m_s: float, turn_rate_rad_s: float) -> None:
        PART.hold(self._settings, self._state, self._rows, time_ns, speed_m_s, turn_rate_rad_s)

    def push(self, time_ns: int, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Move to a time [ns] and add these rates from then on."""
        self.advance(time_ns)
        PART.push(self._settings, self._state, speed_m_s, turn_rate_rad_s)

    def advance(self, time_ns: int) -> None:
        assert PART.move(self._settings, self._state, self._rows, time_ns)

    @property
    def state(self) -> tuple[float, float, float, float, float]:
        found: tuple[float, float, float, float, float] = PART.read(self._state)
        return found

    @property
    def hit_wall(self) -> bool:
        return bool(self._state.hit_wall)


def drive(keys: LaggedKeys, commands: list[Command], *ends_ns: int) -> Robot:
    """Return a robot from (0, 0, 0) that took these commands, moved to one time after the other."""
    robot = Robot(keys)
    for command in commands:
        robot.take_command(*command)
    for end_ns in ends_ns:
        robot.advance(end_ns)
    return robot


def test_speed_way_and_heading_follow_a_step_by_their_closed_forms() -> None:
    keys = LaggedKeys(speed_gain=0.9, speed_lag_s=0.1, speed_dead_time_s=0.08)
    robot = drive(keys, [(0, 2.0, 0.0)], 330_000_000)
    rate, way_m = 1.8 * (1 - math.exp(-2.5)), 1.8 * (0.25 - 0.1 * (1 - math.exp(-2.5)))
    assert robot.state == pytest.approx((way_m, 0.0, 0.0, rate, 0.0), abs=1e-15)
    keys = LaggedKeys(turn_gain=0.9, turn_lag_s=0.1, turn_dead_time_s=0.08)
    robot = drive(keys, [(0, 0.0, 2.0)], 330_000_000)
    assert robot.state == pytest.approx((0.0, 0.0, way_m, 0.0, rate), abs=1e-15)


def test_commands_beyond_a_bound_lead_to_the_bound() -> None:
    keys = LaggedKeys(speed_gain=0.5, speed_lag_s=0.1, speed_bound=0.6)
    bound = drive(keys, [(0, -2.0, 0.0)], SECOND_NS)
    assert bound.state == drive(keys, [(0, -1.2, 0.0)], SECOND_NS).state
    assert bound.state != drive(keys, [(0, -1.1, 0.0)], SECOND_NS).state
    turns = drive(LaggedKeys(turn_bound=0.3), [(0, 0.0, 2.0)], SECOND_NS)
    assert turns.state == (0.0, 0.0, 0.3, 0.0, 0.3)


def test_speed_ramps_and_then_fades_by_its_closed_form() -> None:
    # 1 m/s from rest: 2 m/s^2 for 0.4 s, until 0.2 m/s are left, which fade.
    keys = LaggedKeys(speed_lag_s=0.1, speed_acceleration=2.0)
    ramp = drive(keys, [(0, 1.0, 0.0)], 300_000_000)
    assert ramp.state == pytest.approx((0.09, 0.0, 0.0, 0.6, 0.0), abs=1e-15)
    ramp.advance(500_000_000)
    faded = math.exp(-1.0)
    way_m = 0.16 + 0.1 - 0.02 * (1.0 - faded)
    assert ramp.state == pytest.approx((way_m, 0.0, 0.0, 1.0 - 0.2 * faded, 0.0), abs=1e-15)


def test_turn_without_a_time_constant_ramps_to_what_is_wanted_and_stays() -> None:
    keys = LaggedKeys(turn_acceleration=4.0)
    robot = drive(keys, [(0, 0.0, -1.0)], 100_000_000)
    assert robot.state == pytest.approx((0.0, 0.0, -0.02, 0.0, -0.4), abs=1e-15)
    robot.advance(SECOND_NS)
    assert robot.state == pytest.approx((0.0, 0.0, -0.875, 0.0, -1.0), abs=1e-15)
    assert robot.state[4] == -1.0


@pytest.mark.parametrize("acceleration", [10.0, 11.0])
def test_acceleration_that_a_step_does_not_reach_changes_no_bit(acceleration: float) -> None:
    keys = LaggedKeys(speed_lag_s=0.1, turn_lag_s=0.2)
    limited = replace(keys, speed_acceleration=acceleration, turn_acceleration=acceleration)
    plain, same = (drive(one, [(0, 1.0, -2.0)], SECOND_NS).state for one in (keys, limited))
    assert same == plain
    reached = replace(keys, speed_acceleration=0.9 * 10.0)
    assert drive(reached, [(0, 1.0, -2.0)], SECOND_NS).state != plain


def test_commands_up_to_the_deadband_move_nothing_and_larger_ones_act_whole() -> None:
    keys = LaggedKeys(speed_gain=0.5, speed_deadband=0.2, turn_deadband=0.3)
    assert drive(keys, [(0, 0.2, -0.3)], SECOND_NS).state == (0.0, 0.0, 0.0, 0.0, 0.0)
    above = math.nextafter(0.2, 1.0), -math.nextafter(0.3, 1.0)
    assert drive(keys, [(0, *above)], SECOND_NS).state[3:] == (0.5 * above[0], above[1])


def test_friction_takes_as_much_off_each_command_and_holds_the_robot_below() -> None:
    keys = LaggedKeys(speed_gain=0.5, speed_friction=0.2, turn_friction=0.25)
    assert drive(keys, [(0, -0.2, 0.25)], SECOND_NS).state == (0.0, 0.0, 0.0, 0.0, 0.0)
    assert drive(keys, [(0, 0.7, -1.0)], SECOND_NS).state[3:] == (0.5 * (0.7 - 0.2), -0.75)


def test_commands_below_0_have_a_gain_of_their_own() -> None:
    keys = LaggedKeys(speed_gain=0.9, speed_reverse_gain=0.5, turn_reverse_gain=0.0)
    assert drive(keys, [(0, -1.0, -1.0)], SECOND_NS).state == (-0.5, 0.0, 0.0, 0.5, 0.0)
    assert drive(keys, [(0, 1.0, 0.0)], SECOND_NS).state == (0.9, 0.0, 0.0, 0.9, 0.0)
    assert drive(keys, [(0, 0.0, 1.0)], SECOND_NS).state[4] == 1.0


@pytest.mark.parametrize("lag_s", [0.0, 1e-300, 0.1])
@pytest.mark.parametrize("acceleration", [5e-324, 1e-12, 1e12, 1e308])
@pytest.mark.parametrize("command", [5e-324, 1e-320, 1.0, 1e30])
def test_accelerations_of_any_size_end(lag_s: float, acceleration: float, command: float) -> None:
    keys = LaggedKeys(
        speed_lag_s=lag_s,
        turn_lag_s=lag_s,
        speed_acceleration=acceleration,
        turn_acceleration=acceleration,
    )
    robot = drive(keys, [(0, command, -min(command, 5.0)), (SECOND_NS, 0.0, 0.0)], 2 * SECOND_NS)
    assert all(map(math.isfinite, robot.state))


def test_robot_without_lag_and_dead_time_drives_the_circle_of_its_command_at_once() -> None:
    robot = drive(LaggedKeys(), [(0, 2.0, 0.5)], 0)
    assert robot.state == (0.0, 0.0, 0.0, 2.0, 0.5)
    robot.advance(3 * SECOND_NS)
    expected = (4 * math.sin(1.5), 4 * (1 - math.cos(1.5)), 1.5, 2.0, 0.5)
    assert robot.state == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("turn_rate", [1e-3, 1e-9, 1e-15, 1e-300, 0.0])
def test_circle_becomes_a_line_without_a_jump_as_the_turn_rate_goes_to_0(turn_rate: float) -> None:
    x_m, y_m, *_ = drive(LaggedKeys(), [(0, 1.0, turn_rate)], SECOND_NS).state
    assert x_m == pytest.approx(1.0 - turn_rate**2 / 6, abs=1e-13)
    assert y_m == pytest.approx(turn_rate / 2 - turn_rate**3 / 24, rel=1e-13)


@pytest.mark.parametrize("lag_s", [0.0, 0.1])
def test_dead_time_ends_at_its_nanosecond(lag_s: float) -> None:
    keys = LaggedKeys(speed_dead_time_s=0.0800000004, speed_lag_s=lag_s)
    robot = drive(keys, [(SECOND_NS, 1.0, 0.0)], 1_079_999_999)
    assert robot.state[0] == robot.state[3] == 0.0
    robot.advance(1_080_000_000)
    assert robot.state[3] == (0.0 if lag_s else 1.0)
    robot.advance(1_080_000_001)
    assert robot.state[3] > 0.0
    assert robot.state[0] == pytest.approx(5e-18 / lag_s * 1e-1 if lag_s else 1e-9, abs=1e-16)


def test_axes_have_dead_times_of_their_own() -> None:
    keys = LaggedKeys(speed_dead_time_s=0.2, turn_dead_time_s=0.1)
    commands = [(0, 1.0, 1.0)]
    assert drive(keys, commands, 150_000_000).state[3:] == (0.0, 1.0)
    assert drive(keys, commands, 200_000_000).state[3:] == (1.0, 1.0)


def test_pushes_add_to_the_rates_at_once_and_until_the_next_push() -> None:
    keys = LaggedKeys(speed_lag_s=0.1, speed_dead_time_s=0.2)
    robot = drive(keys, [(0, 1.0, 0.0)])
    robot.push(100_000_000, 0.5, 0.25)
    assert robot.state == (0.0, 0.0, 0.0, 0.5, 0.25)
    robot.push(150_000_000, -0.5, 0.0)
    assert robot.state[2:] == pytest.approx((0.0125, 0.5, 0.0), abs=1e-15)
    robot.advance(SECOND_NS)
    assert robot.state[3] == pytest.approx(0.5 - math.exp(-8), abs=1e-14)


def test_heading_stays_within_a_turn_and_keeps_its_digits_over_many() -> None:
    # 100 s at 2 pi, on the circle that closes with every turn
    robot = drive(LaggedKeys(), [(0, 1.0, 2 * math.pi)], *range(0, 100 * SECOND_NS, 50_000_000))
    robot.advance(100 * SECOND_NS)
    assert robot.state[:3] == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert not robot.hit_wall


def test_lag_that_is_next_to_none_is_as_none() -> None:
    commands = [(0, 1.0, 2.0), (SECOND_NS // 2, -1.0, 3.0)]
    instant = drive(LaggedKeys(), commands, SECOND_NS).state
    for lag_s in (1e-12, 1e-300, 5e-324):
        keys = LaggedKeys(speed_lag_s=lag_s, turn_lag_s=lag_s)
        assert drive(keys, commands, SECOND_NS).state == pytest.approx(instant, abs=2e-11)


PLAIN = LaggedKeys(
    speed_gain=1.0,
    speed_dead_time_s=0.0,
    speed_lag_s=0.0,
    turn_gain=1.0,
    turn_dead_time_s=0.0,
    turn_lag_s=0.0,
)
LAGS = st.sampled_from([0.0, 1e-6, 1e-3, 0.02, 0.1, 0.4, 2.0])
KEYS = st.builds(
    LaggedKeys,
    speed_gain=st.floats(0.5, 1.5),
    speed_dead_time_s=st.sampled_from([0.0, 0.08, 0.123456789]),
    speed_lag_s=LAGS,
    turn_gain=st.floats(0.5, 1.5),
    turn_dead_time_s=st.sampled_from([0.0, 0.05]),
    turn_lag_s=LAGS,
)


def draw_rates(most: float) -> st.SearchStrategy[float]:
    # The integrator of the oracle squares its errors, of which those of tinier rates underflow.
    return st.floats(-most, most).map(lambda rate: rate if abs(rate) > 1e-60 else 0.0)


STEPS = st.lists(
    st.tuples(
        st.sampled_from([1, 50_000_000, SECOND_NS, 3 * SECOND_NS]),
        draw_rates(2.0),
        draw_rates(10.0),
    ),
    min_size=1,
    max_size=4,
)


def list_commands(steps: list[Command]) -> tuple[list[Command], int]:
    """Return the commands of steps that each last for a while [ns], and their end."""
    starts_ns = np.cumsum([0, *(held_ns for held_ns, *_ in steps)]).tolist()
    rates = [rates for _, *rates in steps]
    return [(t, *r) for t, r in zip(starts_ns, rates, strict=False)], starts_ns[-1]


@settings(max_examples=40)
@given(keys=KEYS, steps=STEPS)
def test_pose_is_that_of_superposed_step_responses(keys: LaggedKeys, steps: list[Command]) -> None:
    commands, end_ns = list_commands(steps)
    x_m, y_m, heading_rad, speed, turn_rate = drive(keys, commands, end_ns).state
    expected = superpose(keys, commands, end_ns)
    assert (x_m, y_m) == pytest.approx(expected[:2], abs=1e-12)
    assert math.remainder(heading_rad - expected[2], math.tau) == pytest.approx(0.0, abs=1e-13)
    assert (speed, turn_rate) == pytest.approx((abs(expected[3]), expected[4]), abs=1e-13)


LIMITED = st.builds(
    LaggedKeys,
    speed_lag_s=st.sampled_from([0.05, 0.2]),
    turn_lag_s=st.sampled_from([0.02, 0.4]),
    turn_dead_time_s=st.sampled_from([0.0, 0.123456789]),
    speed_acceleration=st.sampled_from([0.3, 2.0, 10.0]),
    turn_acceleration=st.sampled_from([1.0, 6.0, math.inf]),
    speed_bound=st.sampled_from([0.8, math.inf]),
    turn_bound=st.sampled_from([2.0, math.inf]),
    turn_deadband=st.sampled_from([0.0, 0.5]),
    turn_friction=st.sampled_from([0.0, 0.3]),
    speed_reverse_gain=st.sampled_from([None, 0.6]),
    turn_reverse_gain=st.sampled_from([None, 1.2]),
)


@settings(max_examples=12)
@given(keys=LIMITED, steps=STEPS)
def test_pose_with_limits_is_that_of_integrated_differential_equations(
    keys: LaggedKeys, steps: list[Command]
) -> None:
    commands, end_ns = list_commands(steps)
    x_m, y_m, heading_rad, speed, turn_rate = drive(keys, commands, end_ns).state
    expected = integrate(keys, commands, end_ns)
    assert (x_m, y_m, abs(expected[3]), expected[4]) == pytest.approx(
        (expected[0], expected[1], speed, turn_rate), abs=1e-8
    )
    assert math.remainder(heading_rad - expected[2], math.tau) == pytest.approx(0.0, abs=1e-8)


@settings(max_examples=40)
@given(
    keys=st.one_of(KEYS, LIMITED),
    steps=STEPS,
    cuts=st.lists(st.floats(0, 1), min_size=1, max_size=20),
)
def test_stops_on_the_way_change_nothing(
    keys: LaggedKeys, steps: list[Command], cuts: list[float]
) -> None:
    commands, end_ns = list_commands(steps)
    stops_ns = sorted(round(cut * end_ns) for cut in cuts)
    whole, split = (drive(keys, commands, *at, end_ns).state for at in ((), stops_ns))
    turned = math.remainder(whole[2] - split[2], math.tau)
    assert (*split[:2], turned, *split[3:]) == pytest.approx(
        (*whole[:2], 0.0, *whole[3:]), abs=1e-12
    )


def test_pieces_four_times_as_long_would_miss_the_nanometre(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keys, commands = replace(PLAIN, speed_lag_s=2.0, turn_lag_s=0.02), [(0, 2.0, 10.0)]
    expected = superpose(keys, commands, 3 * SECOND_NS)[:2]
    for longest, is_right in ((2.0, True), (8.0, False)):
        monkeypatch.setattr(lagged, "LONGEST_PIECE", longest)
        found = drive(keys, commands, 3 * SECOND_NS).state[:2]
        assert (found == pytest.approx(expected, abs=1e-9)) is is_right


def test_loop_that_runs_away_does_not_take_forever() -> None:
    # 1e9 rad in one advance: some 100,000,000 pieces if each were followed
    robot = drive(LaggedKeys(turn_lag_s=0.1), [(0, 1.0, 1e9)], SECOND_NS)
    assert all(map(math.isfinite, robot.state))


def test_missing_keys_are_those_of_a_robot_that_does_as_it_is_told() -> None:
    commands = [(0, 1.0, 0.5)]
    assert drive(PLAIN, commands, SECOND_NS).state == drive(LaggedKeys(), commands, SECOND_NS).state


def integrate(keys: LaggedKeys, commands: list[Command], end_ns: int) -> tuple[float, ...]:
    """Return x, y, heading, speed and turn rate, as their equations are integrated numerically."""

    def want(axis: str, row: int, time_ns: float) -> float:
        dead_ns = round(getattr(keys, f"{axis}_dead_time_s") * 1e9)
        held = [one[row] for one in commands if one[0] + dead_ns <= time_ns]
        command = float(held[-1]) if held else 0.0
        reverse = getattr(keys, f"{axis}_reverse_gain")
        gain = getattr(keys, f"{axis}_gain") if command > 0 or reverse is None else reverse
        bound = getattr(keys, f"{axis}_bound")
        is_dead = abs(command) <= getattr(keys, f"{axis}_deadband")
        size = max(abs(command) - getattr(keys, f"{axis}_friction"), 0.0)
        rate = gain * math.copysign(size, command)
        return 0.0 if is_dead else float(np.clip(rate, -bound, bound))

    dead_times = {round(getattr(keys, f"{axis}_dead_time_s") * 1e9) for axis in ("speed", "turn")}
    switches = {one[0] + dead_ns for one in commands for dead_ns in dead_times}
    edges = sorted({0, end_ns, *(switch for switch in switches if switch < end_ns)})
    lags = np.array([keys.speed_lag_s, keys.turn_lag_s])
    most = np.array([keys.speed_acceleration, keys.turn_acceleration])
    state = np.zeros(5)
    for begin, end in pairwise(edges):
        wanted = np.array([want("speed", 1, begin), want("turn", 2, begin)])

        def change(_: float, now: Values, wanted: Values = wanted) -> list[float]:
            rates = np.clip((wanted - now[3:]) / lags, -most, most)
            along = now[3] * np.cos(now[2]), now[3] * np.sin(now[2])
            return [*along, now[4], *rates]

        span = 0.0, (end - begin) / 1e9
        found = solve_ivp(
            change, span, state, method="DOP853", rtol=1e-13, atol=1e-13, max_step=0.02
        )
        state = found.y[:, -1]
    values: tuple[float, ...] = tuple(state.tolist())
    return values


def superpose(keys: LaggedKeys, commands: list[Command], end_ns: int) -> tuple[float, ...]:
    """Return the pose and the rates as sums of step responses, integrated on a fine grid."""

    def respond(axis: str, row: int, time_ns: Values) -> tuple[Values, Values]:
        gain, lag_s = (getattr(keys, f"{axis}_{name}") for name in ("gain", "lag_s"))
        dead_ns = round(getattr(keys, f"{axis}_dead_time_s") * 1e9)
        rate, way, held = np.zeros_like(time_ns), np.zeros_like(time_ns), 0.0
        for command in commands:
            since_s = (time_ns - (command[0] + dead_ns)) / 1e9
            is_later, since_s = since_s >= 0.0, np.maximum(since_s, 0.0)
            step, held = gain * (command[row] - held), command[row]
            faded = -np.expm1(-since_s / lag_s) if lag_s else is_later.astype(float)
            rate += step * faded
            way += step * (since_s - lag_s * faded)
        return rate, way

    nodes, weights = np.polynomial.legendre.leggauss(16)
    edges_ns = split_time(keys, commands, end_ns)
    half_ns = np.diff(edges_ns)[:, None] / 2
    time_ns = edges_ns[:-1, None] + half_ns * (1 + nodes)
    along = respond("speed", 1, time_ns)[0] * np.exp(1j * respond("turn", 2, time_ns)[1])
    place = complex((along * weights * half_ns).sum()) / 1e9
    end = np.array([float(end_ns)])
    speed, turn = respond("speed", 1, end)[0], respond("turn", 2, end)
    return place.real, place.imag, float(turn[1][0]), float(speed[0]), float(turn[0][0])


def split_time(keys: LaggedKeys, commands: list[Command], end_ns: int) -> Values:
    """Return the edges of pieces that are short beside every lag and turn [ns]."""
    dead_times = {round(getattr(keys, f"{axis}_dead_time_s") * 1e9) for axis in ("speed", "turn")}
    lags_s = [lag_s for lag_s in (keys.speed_lag_s, keys.turn_lag_s) if lag_s]
    grid_ns = [np.linspace(0.0, end_ns, 50 + end_ns // 50_000_000)]
    for switch_ns in {command[0] + dead_ns for command in commands for dead_ns in dead_times}:
        grid_ns += [switch_ns + lag_s * 1e9 * np.arange(0.0, 40.0) for lag_s in lags_s]
        grid_ns.append(np.array([float(switch_ns)]))
    edges_ns: Values = np.unique(np.concatenate(grid_ns))
    return edges_ns[(edges_ns >= 0.0) & (edges_ns <= end_ns)]
