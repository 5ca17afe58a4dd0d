"""At which delays commands and motion correlate best: a range that holds, or a reason."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.robots import Log, Truth, Values, make_run
from tests.known import known
from turtlelog.cli.console import print_json
from turtlelog.cli.identify import build_identify_answer, format_robot
from turtlelog.identify import robot_identification
from turtlelog.identify.axis_motion import AxisMotion, read_axis_motion
from turtlelog.identify.robot_identification import find_correlation_delay

NOISY = Log(duration_s=25.0, poses_hz=20.0, noise_rad=2e-3, turn_rate=Truth(lag_s=0.3))
"""Of steps that hold for 0.5 to 3 s: the best delay in the long run is 0.28 s."""


def turn(log: Log, seed: int) -> AxisMotion:
    return read_axis_motion(make_run(log, seed), "turn_rate")


def wander(duration_s: float) -> tuple[Values, Values]:
    """Return commands that change slowly, as a joystick's: many delays explain the motion alike."""
    time_s = np.arange(0.5, duration_s - 0.5, 0.05)
    value = 0.4 * np.sin(0.3 * time_s) + 0.2 * np.sin(0.71 * time_s)
    return time_s, value


def test_the_range_holds_the_delay_that_is_best_in_the_long_run() -> None:
    best_s = known(find_correlation_delay([turn(replace_duration(NOISY, 400.0), 99)])[0]).value
    found = [known(find_correlation_delay([turn(NOISY, seed)])[0]) for seed in range(40)]
    held = [one.low - 5e-3 <= best_s <= one.high + 5e-3 for one in found]
    assert 0.9 <= np.mean(held) <= 1.0
    assert np.median([one.high - one.low for one in found]) < 0.3 * best_s


def replace_duration(log: Log, duration_s: float) -> Log:
    return Log(
        duration_s=duration_s,
        poses_hz=log.poses_hz,
        noise_rad=log.noise_rad,
        turn_rate=log.turn_rate,
    )


def test_a_flat_correlation_names_no_delay() -> None:
    time_s, value = wander(30.0)
    log = Log(duration_s=30.0, noise_rad=3e-2)
    run = make_run(log, 1, speed=(time_s, 0.0 * value), turn=(time_s, value))
    found, reason = find_correlation_delay([read_axis_motion(run, "turn_rate")])
    assert found is None
    assert reason.startswith("the correlation of commands and motion says nothing: it does not")


@pytest.mark.parametrize(("half_s", "is_told"), [(1.3, False), (1.7, True)])
def test_commands_that_repeat_tell_no_delay_from_one_a_period_longer(
    half_s: float, *, is_told: bool
) -> None:
    time_s: Values = np.arange(0.5, 29.5, half_s).astype(np.float64)
    value: Values = np.where(np.arange(len(time_s)) % 2 == 0, 0.5, -0.5).astype(np.float64)
    log = Log(duration_s=30.0, noise_rad=2e-3, turn_rate=Truth(dead_time_s=0.1, lag_s=0.2))
    run = make_run(log, 1, speed=(time_s, 0.0 * value), turn=(time_s, value))
    found, reason = find_correlation_delay([read_axis_motion(run, "turn_rate")])
    assert (found is not None) is is_told
    assert ("the commands repeat every 2.6 s" in reason) is not is_told


@pytest.mark.parametrize(("width_s", "is_told"), [(0.95, True), (1.05, False)])
def test_a_range_wider_than_its_best_delay_names_none(
    width_s: float, monkeypatch: pytest.MonkeyPatch, *, is_told: bool
) -> None:
    motion = turn(NOISY, 1)
    best_s = known(find_correlation_delay([motion])[0]).value

    def find_end(_: Callable[[float], bool], __: float, step_s: float) -> float:
        return 0.0 if step_s < 0.0 else width_s * best_s

    monkeypatch.setattr(robot_identification, "_find_end", find_end)
    assert (find_correlation_delay([motion])[0] is not None) is is_told


@pytest.mark.parametrize(("duration_s", "is_long"), [(8.9, False), (9.3, True)])
def test_a_short_log_says_nothing_of_a_delay(duration_s: float, *, is_long: bool) -> None:
    # The robot stands for the first second: only steps count in which commands act.
    reason = find_correlation_delay([turn(replace_duration(NOISY, duration_s), 1)])[1]
    assert ("too short" in reason) is not is_long


def test_another_robots_commands_hardly_correlate() -> None:
    told = 0
    for seed in range(20):
        motion = turn(replace_duration(NOISY, 40.0), seed)
        rng = np.random.default_rng(seed)
        moved = rng.normal(0.0, 0.01, len(motion.moved))
        told += find_correlation_delay([replace(motion, moved=moved)])[0] is not None
    assert told <= 3


def test_the_range_stands_in_the_text_and_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    model = tl.identify_robot(make_run(NOISY, 1))
    delay_s = known(model.turn_rate.correlation_delay_s)
    told = f"correlate best at a delay of {1e3 * delay_s.low:.0f} to {1e3 * delay_s.high:.0f} ms."
    text = format_robot(model, [Path("robot")], shows_details=True)
    assert told in " ".join(text.split())
    print_json(build_identify_answer([], model))
    axis = json.loads(capsys.readouterr().out)["axes"][1]
    assert axis["correlation_delay_s"]["low"] == delay_s.low
    assert axis["correlation_reason"] is None
