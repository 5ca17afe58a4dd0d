"""The thresholds on which `exact`, `fitted` and `unknown` turn, each from both sides."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from tests.explain.truth import Log, Truth, make_log
from turtlelog.explain import Certainty, identify_run
from turtlelog.explain.scenario_from_log import LAW_KEYS, LOOP_KEYS
from turtlelog.explain.scenario_from_log.driven_plant import drive_plant
from turtlelog.explain.scenario_from_log.gain_fit import (
    PoseNoise,
    Values,
    fit_command,
    fit_gain,
    measure_pose_noise,
)
from turtlelog.explain.scenario_from_log.law_identification import (
    PHASES,
    RULE_KEYS,
    bound_position_tolerance,
    find_stop_rule,
    identify_rotation,
    identify_translation,
)
from turtlelog.explain.scenario_from_log.loop_settings import describe_loop, read_hints
from turtlelog.explain.scenario_from_log.resimulation import list_lost_commands
from turtlelog.explain.scenario_from_log.setting_search import Fits
from turtlelog.explain.scenario_from_log.trace import find_pose_resolution, mark_breaks, trace_run
from turtlelog.laws import SequentialPParameters
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

BUILT = {
    "law.pause_ticks": 34,
    "loop.start_backlog": 6,
    "loop.pose_queue": 10,
    "loop.command_queue": 7,
    "loop.queue_policy": "one-per-tick",
    "loop.transport_delay_ticks": 0,
    "loop.period_ticks": 1,
}
"""The loop of the default truth."""


def shift_clock(log: Log, row: int, ticks: float) -> Log:
    """Return a log whose clock is later by some ticks from a row on."""
    rows = [(found[0] + (ticks * 0.016 if at >= row else 0.0), *found[1:])
            for at, found in enumerate(log.rows)]  # fmt: skip
    return replace(log, rows=rows)


def make_commands(left: Values, gain: float = 2.0) -> tuple[Values, Values]:
    """Return commands and the errors that they answer, which are off by what is left."""
    command = np.linspace(1.0, 0.01, len(left))
    return command, command / gain + left


def alternate(rows: int, share: float) -> Values:
    """Return noise whose whiteness is near 2 (share 1: it alternates) or near 0 (0: it is slow)."""
    slow = np.sin(np.linspace(0.0, 3.0 * np.pi, rows))
    return 0.01 * np.where(np.arange(rows) % 2, 1.0, -1.0) * share + 0.01 * slow * (1.0 - share)


@pytest.mark.parametrize(("ticks", "tried"), [(2.4, True), (2.6, False)])
def test_a_pause_is_tried_up_to_two_and_a_half_ticks_from_the_clock(
    ticks: float,
    tried: bool,  # noqa: FBT001
) -> None:
    log = make_log(Truth(jitter_s=0.0))
    ended = sum(row[-1] == "ROTACIONAR" for row in log.rows)
    trace = mark_breaks(trace_run(shift_clock(log, ended + 1, ticks).to_run(), PHASES))
    assert (34 in read_hints(trace).pauses) == tried


@pytest.mark.parametrize(("ticks", "near"), [(0.7, True), (0.8, False)])
def test_a_pause_contradicts_the_clock_from_three_quarters_of_a_tick(
    ticks: float,
    near: bool,  # noqa: FBT001
) -> None:
    from turtlelog.explain.scenario_from_log.loop_settings import agrees_with_clock

    log = make_log(Truth(jitter_s=0.0))
    ended = sum(row[-1] == "ROTACIONAR" for row in log.rows)
    trace = mark_breaks(trace_run(shift_clock(log, ended + 1, ticks).to_run(), PHASES))
    assert agrees_with_clock(34, read_hints(trace), trace) == near


def of_noise(size: float) -> PoseNoise:
    return PoseNoise(size=size, least=size, grain=0.0)


@pytest.mark.parametrize(("rows", "obstacle"), [(8, False), (7, True)])
def test_fewer_than_eight_commands_tell_no_noise_from_a_curve(rows: int, obstacle: bool) -> None:  # noqa: FBT001
    noise = np.random.default_rng(5).normal(0.0, 1e-3, rows)
    command, error = make_commands(noise)
    fit = fit_command(command, lambda gain: gain * error, of_noise(1e-3))
    assert (fit.obstacle is not None) == obstacle


@pytest.mark.parametrize(
    ("share", "obstacle"), [(0.36, False), (0.28, True), (0.5, False), (0.55, True)]
)
def test_what_is_left_of_a_gain_is_noise_or_a_pattern(share: float, obstacle: bool) -> None:  # noqa: FBT001
    command, error = make_commands(alternate(200, share))
    fit = fit_command(command, lambda gain: gain * error, of_noise(1.0))
    assert (fit.obstacle is not None) == obstacle


@pytest.mark.parametrize(("size", "obstacle"), [(0.55e-3, False), (0.45e-3, True)])
def test_a_gain_leaves_no_more_than_twice_the_noise_of_the_poses(
    size: float,
    obstacle: bool,  # noqa: FBT001
) -> None:
    noise = np.random.default_rng(2).normal(0.0, 1.0, 400)
    command, error = make_commands(noise / noise.std() * 1e-3)
    fit = fit_command(command, lambda gain: gain * error, of_noise(size))
    assert (fit.obstacle is not None) == obstacle


@pytest.mark.parametrize(("way", "limited"), [(5.5, True), (4.5, False)])
def test_equal_commands_are_clipped_where_the_error_changed_by_five_deviations(
    way: float,
    limited: bool,  # noqa: FBT001
) -> None:
    rng, noise = np.random.default_rng(1), 1e-3
    command = np.r_[np.ones(30), np.linspace(0.9, 0.01, 300)]
    left = rng.normal(0.0, 1.0, len(command))
    left[:30] = 0.0
    left[30:] *= noise / float(np.sqrt(np.mean(left[30:] ** 2)))
    error = command / 2.0 + left
    # The first and the last third of the equal commands: 10 rows each.
    error[:10] += way * noise * float(np.sqrt(2.0 / 10.0))
    fit = fit_command(command, lambda gain: gain * error, of_noise(noise))
    assert (fit.limit == 1.0) == limited


@pytest.mark.parametrize(("rows", "limit"), [(3, 1.2), (2, None)])
def test_a_limit_shows_in_three_equal_commands_and_not_in_two(
    rows: int, limit: float | None
) -> None:
    command, error = make_commands(np.random.default_rng(5).normal(0.0, 1e-3, 60))
    command = np.append(np.full(rows, 1.2), command)
    error = np.append(np.linspace(1.5, 0.8, rows), error)
    fit = fit_command(command, lambda gain: gain * error, of_noise(1e-3))
    assert fit.limit == limit


def test_a_gain_that_its_neighbour_reproduces_as_well_is_not_exact() -> None:
    # Three small whole numbers times 3 are the same doubles for the next gain above 3 / 2**53 only.
    error = np.array([1.0, 0.5, 0.25])
    sure = fit_gain(error * 3.7, lambda gain: gain * error)
    assert (sure.value, sure.is_exact) == (3.7, True)
    tiny = np.array([5e-324, 1e-323, 1.5e-323])
    unsure = fit_gain(tiny * 3.0, lambda gain: gain * tiny)
    assert not unsure.is_exact


def test_a_gain_that_many_doubles_reproduce_has_as_much_room_above_as_below() -> None:
    error = np.array([1.0, 0.5, 0.25])
    fit = fit_gain(error * 3.5, lambda gain: (gain * error).astype(np.float32).astype(np.float64))
    assert (fit.value, fit.is_exact) == (3.5, False)
    low, high = fit.interval
    assert (3.5 - low, high - 3.5) == (16 * math.ulp(3.5), 16 * math.ulp(3.5))


@pytest.mark.parametrize(("off", "is_common"), [(0.018, True), (0.023, False)])
def test_poses_have_a_common_step_up_to_a_fiftieth_of_it(off: float, is_common: bool) -> None:  # noqa: FBT001
    values = np.linspace(0.0, 0.039, 40) + np.pi * 1e-9
    values[20] += off * 1e-3
    assert (find_pose_resolution(values) == pytest.approx(1e-3, rel=1e-3)) == is_common


@pytest.mark.parametrize(("amount", "has_step"), [(10, True), (9, False)])
def test_ten_different_values_may_tell_a_step(amount: int, has_step: bool) -> None:  # noqa: FBT001
    assert (find_pose_resolution(np.linspace(0.0, (amount - 1) / 3.0, amount)) > 0.3) == has_step


@pytest.mark.parametrize(("ticks", "missing"), [(0.4, 0), (0.6, 1)])
def test_a_row_that_comes_two_ticks_late_while_nothing_moves_hides_one(
    ticks: float, missing: int
) -> None:
    log = make_log(Truth(jitter_s=0.0))
    standing = len(log.rows) - 50
    trace = mark_breaks(trace_run(shift_clock(log, standing, ticks).to_run(), PHASES))
    assert sum(amount for _, amount in trace.missing) == missing


@pytest.mark.parametrize(("catches_up", "missing"), [(0.45, 0), (0.55, 1)])
def test_a_late_callback_is_told_by_the_short_step_after_it(
    catches_up: float, missing: int
) -> None:
    log = make_log(Truth(jitter_s=0.0))
    standing = len(log.rows) - 50
    late = shift_clock(shift_clock(log, standing, 1.0), standing + 1, catches_up - 1.0)
    assert (
        sum(amount for _, amount in mark_breaks(trace_run(late.to_run(), PHASES)).missing)
        == missing
    )


@pytest.mark.parametrize(("jump_m", "jumps"), [(0.025, 0), (0.04, 1)])
def test_a_pose_jumps_where_two_ticks_at_full_speed_do_not_lead(jump_m: float, jumps: int) -> None:
    log = make_log(Truth(jitter_s=0.0))
    rows = [
        (found[0], found[1] + (jump_m if at >= 600 else 0.0), *found[2:])
        for at, found in enumerate(log.rows)
    ]
    trace = mark_breaks(trace_run(replace(log, rows=rows).to_run(), PHASES))
    assert len(trace.jumps) == jumps


@pytest.mark.parametrize(("slack_ticks", "reason"), [(1.4, "timeout"), (1.7, "cut")])
def test_a_clock_may_be_off_by_a_tick_and_a_half(slack_ticks: float, reason: str) -> None:
    log = make_log(Truth(kp_linear=0.12, cut_s=35.0, jitter_s=0.0))
    assert log.reason == "timeout"
    squeezed = [(row[0] - slack_ticks * 0.016 * (at > 0), *row[1:]) for at, row in
                enumerate(log.rows)]  # fmt: skip
    ordered = [row for row in squeezed if row[0] > squeezed[0][0] or row is squeezed[0]]
    text = replace(log, rows=ordered)
    unfinished = replace(text, rows=[(*row[:-1], row[-1].replace("FINALIZADO", "TRANSLADAR"))
                                     for row in ordered])  # fmt: skip
    assert identify_run(unfinished.to_run()).findings["stop_reason"].value == reason


@pytest.mark.parametrize(("timeout_s", "assumed_s"), [(7.5, 7.5), (7.55, 7.536)])
def test_a_time_is_taken_as_typed_where_it_has_two_digits(
    timeout_s: float, assumed_s: float
) -> None:
    """The sample before the last comes at 7.488 s, and at 7.536 s."""
    log = make_log(Truth(timeout_s=timeout_s, jitter_s=0.0))
    trace = mark_breaks(trace_run(log.to_run(), PHASES))
    rules = find_stop_rule(trace, is_certain=True, is_finished=True).rules
    assert rules["law.timeout_s"].assumed == assumed_s


@pytest.mark.parametrize(("left_out", "reason"), [(0, "within_tolerance"), (1, "cut")])
def test_a_log_that_ends_with_a_command_of_zero_ended_within_the_tolerance(
    left_out: int, reason: str
) -> None:
    log = make_log(Truth(position_tolerance=0.02, standstill_below=1e-9, jitter_s=0.0))
    assert log.reason == "within_tolerance"
    assert 0.0 == log.to_run().samples.speed_m_s[-1] < log.to_run().samples.speed_m_s[-2]
    log = replace(log, rows=log.rows[: len(log.rows) - left_out])
    trace = mark_breaks(trace_run(log.to_run(), PHASES))
    found = find_stop_rule(trace, is_certain=True, is_finished=False).reason
    assert (found.value, found.certainty) == (reason, Certainty.EXACT)


@pytest.mark.parametrize(("queues", "certainty"), [((7, 8), "ambiguous"), ((8, 8), "exact")])
def test_lost_commands_are_open_where_two_settings_that_fit_lose_different_numbers(
    queues: tuple[int, int], certainty: str
) -> None:
    scenarios = tuple(
        override_scenario(get_preset("paper-kp10"), {"loop.command_queue": depth})
        for depth in queues
    )
    fits = Fits(
        guesses=({}, {}), scenarios=scenarios, is_exact=True, reproduced=1, tried=2, ranges={}
    )
    trace = mark_breaks(trace_run(make_log(Truth()).to_run(), PHASES))
    lost = describe_loop(trace, fits)["lost_commands"]
    counts = list_lost_commands(scenarios)
    assert counts[0] - counts[1] == queues[1] - queues[0]
    assert lost.certainty.value == certainty


def test_a_wrapped_error_is_exact_where_commands_show_it() -> None:
    truth = Truth(start=(5.5, 5.5, 3.0), goal=(2.0, 5.0), wrap=True)
    wrap = identify_run(make_log(truth).to_run()).findings["law.wrap_error"]
    assert (wrap.value, wrap.certainty) == (True, Certainty.EXACT)
    noisy = identify_run(make_log(replace(truth, log_noise=1e-3)).to_run()).findings
    assert (noisy["law.wrap_error"].value, noisy["law.wrap_error"].certainty) == (
        True, Certainty.FITTED)  # fmt: skip


@pytest.mark.parametrize(("deviations", "certainty"), [(5.4, "unknown"), (6.6, "fitted")])
def test_a_noisy_error_has_wrapped_from_six_deviations_beyond_half_a_turn(
    deviations: float, certainty: str
) -> None:
    bearing_rad = float(np.arctan2(10.0 - 5.5444446, 2.0 - 5.5444446))
    start = (5.5444446, 5.5444446, bearing_rad - np.pi + 0.004)
    run = make_log(Truth(start=start, log_noise=1e-3)).to_run()
    heading_rad = run.poses.heading_rad.copy()
    size = measure_pose_noise(trace_run(run, PHASES).heading_rad[:, None]).size
    heading_rad[1] = bearing_rad - np.pi - deviations * size
    poses = replace(run.poses, heading_rad=heading_rad)
    found = identify_rotation(trace_run(replace(run, poses=poses), PHASES))[0]["law.wrap_error"]
    assert found.certainty == certainty


@pytest.mark.parametrize(("ended_m", "interval"), [(0.0019, (0.0019, 0.002)), (0.002, None)])
def test_a_tolerance_is_bounded_where_the_error_that_ended_is_the_least(
    ended_m: float, interval: tuple[float, float] | None
) -> None:
    error = np.array([0.5, 0.3, 0.002])
    fit = fit_command(2.0 * error, lambda gain: gain * error, of_noise(0.0))
    errors = np.column_stack([np.append(error, ended_m), np.zeros(4)])
    found = bound_position_tolerance(errors, np.append(2.0 * error, 0.0), fit)
    assert (found.interval, found.value) == (interval, None if interval is None else ended_m)


def test_noisy_errors_bound_a_tolerance_to_four_deviations() -> None:
    noise = np.random.default_rng(5).normal(0.0, 1e-3, 50)
    command, error = make_commands(noise)
    fit = fit_command(command, lambda gain: gain * error, of_noise(1e-3))
    errors = np.column_stack([[*error, 0.03, 0.02], np.zeros(52)])
    found = bound_position_tolerance(errors, np.array([*command, 0.06, 0.0]), fit)
    assert fit.gain is not None
    deviation_m = fit.gain.noise
    assert found.interval == pytest.approx((0.02 - 4.0 * deviation_m, 0.03 + 4.0 * deviation_m))


@pytest.mark.parametrize(("alike", "explains"), [(0.42, True), (0.58, False)])
def test_what_a_drive_leaves_is_noise_up_to_a_whiteness_of_a_half(
    alike: float, *, explains: bool
) -> None:
    run = make_log(Truth()).to_run()
    noise = np.random.default_rng(0).normal(0.0, 1e-3, (len(run.poses), 3))
    for row in range(1, len(noise)):
        noise[row] += alike * noise[row - 1]
    poses = replace(
        run.poses,
        xy_m=run.poses.xy_m + noise[:, :2],
        heading_rad=run.poses.heading_rad + noise[:, 2],
    )
    drive = drive_plant(trace_run(replace(run, poses=poses), PHASES), BUILT)
    assert drive is not None
    assert drive.explains == explains


def test_every_parameter_of_the_law_is_known_to_its_identification() -> None:
    # `exact` says that no other value reproduces the commands: with another parameter one might.
    unidentified = ("law.reorient", "law.schedule")  # a run with these has no identified law
    keys = (*LAW_KEYS, *LOOP_KEYS, *RULE_KEYS, *unidentified)
    told = [key for key in keys if key.startswith("law.")]
    assert sorted(told) == sorted(f"law.{field.name}" for field in fields(SequentialPParameters))


def test_every_parameter_that_commands_tell_has_a_finding() -> None:
    trace = mark_breaks(trace_run(make_log(Truth()).to_run(), PHASES))
    found = {**identify_rotation(trace)[0], **identify_translation(trace)[0]}
    assert {*found} == {*LAW_KEYS}


@pytest.mark.parametrize(("samples", "delay_s"), [(10, 0.0), (11, 0.02)])
def test_how_late_poses_are_answered_shows_in_more_than_ten_answers(
    samples: int, delay_s: float
) -> None:
    until_s = 0.02 + 0.016 * (samples - 1)
    changes = {"sensing.delay_s": 0.02, "max_duration_s": until_s}
    run = simulate_run(override_scenario(get_preset("textbook"), changes))
    assert len(run.samples) == samples
    assert trace_run(run).answered_after_s == pytest.approx(delay_s)
