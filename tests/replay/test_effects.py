"""Runs with effects: recorded live and at once, read back, and replayed without a difference."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from tests.effects_cases import EFFECTS, SENSED, SHAPED, build_case
from tests.log.recording.ticks import assert_same_columns, record_ticks
from tests.log.runs import assert_same
from turtlelog.log import read_recording, write_recording
from turtlelog.replay import LawReplay, LoopReplay, replay_law, replay_loop, replay_plant
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import collect_run, iterate_ticks, simulate_run

SENSED_SIGNALS = {"sensed_x", "sensed_y", "sensed_heading"}
SHAPED_SIGNALS = {"shaped_speed", "shaped_turn_rate"}


def build(*effects: str) -> Scenario:
    return build_case(*effects, preset="paper", max_duration_s=0.6)


@pytest.mark.everyday("dropout", "sensing_jitter", "transport_delay", "low_pass", "lagged")
@pytest.mark.parametrize("first", EFFECTS)
def test_any_two_effects_are_replayed(first: str) -> None:
    for other in [*EFFECTS][[*EFFECTS].index(first) :]:
        run = simulate_run(build(*{first: 1, other: 1}))
        for replayed in (replay_law(run), replay_loop(run)):
            assert replayed.first_difference is None, (other, replayed)
            assert replayed.samples == len(run.samples) > 0
            assert not {*replayed.absent} & {*SENSED_SIGNALS, *SHAPED_SIGNALS}


@pytest.mark.parametrize(
    "effects",
    [*((effect,) for effect in EFFECTS), *product(sorted(SENSED), sorted(SHAPED)), [*EFFECTS]],
    ids=lambda effects: "all" if len(effects) > 2 else "-".join(effects),
)
def test_effects_are_recorded_live_and_at_once_and_read(
    effects: Sequence[str], tmp_path: Path
) -> None:
    scenario = build(*effects)
    live, once = tmp_path / "live.mcap", tmp_path / "once.mcap"
    ticks = [*iterate_ticks(scenario)]
    run = collect_run(scenario, ticks)
    record_ticks(live, scenario, ticks)
    write_recording(run, once)
    assert_same_columns(live, once)
    assert_same(read_recording(live), run)


@pytest.mark.parametrize("effect", [*sorted(SENSED | SHAPED), "timer"])
def test_what_is_sensed_and_shaped_is_compared(effect: str) -> None:
    run = simulate_run(build_case(effect, max_duration_s=0.6))
    law, loop = replay_law(run), replay_loop(run)
    assert SENSED_SIGNALS.issubset(list_signals(loop)) == (effect in SENSED)
    for found in (law, loop):
        assert SHAPED_SIGNALS.issubset(list_signals(found)) == (effect in SHAPED)


def list_signals(found: LawReplay | LoopReplay) -> set[str]:
    return {signal.signal for signal in found.signals}


def test_a_law_that_reads_the_true_poses_answers_otherwise() -> None:
    run = simulate_run(build_case("noise", max_duration_s=0.6))
    true = replace(run, poses=replace(run.poses, sensed_xy_m=None, sensed_heading_rad=None))
    first = replay_law(true).first_difference
    assert first is not None
    assert (first.signal, first.time_ns) == ("bearing", 0)
    assert replay_loop(true).absent[:3] == ("sensed_x", "sensed_y", "sensed_heading")


def test_a_drop_out_that_the_replay_does_not_have_is_a_difference() -> None:
    run = simulate_run(build_case("dropout", max_duration_s=0.6))
    assert run.poses.sensed_xy_m is not None
    assert run.poses.sensed_heading_rad is not None
    row = int(np.flatnonzero(np.isnan(run.poses.sensed_heading_rad))[0])
    xy_m, heading_rad = run.poses.sensed_xy_m.copy(), run.poses.sensed_heading_rad.copy()
    xy_m[row], heading_rad[row] = run.poses.xy_m[row], run.poses.heading_rad[row]
    poses = replace(run.poses, sensed_xy_m=xy_m, sensed_heading_rad=heading_rad)
    first = replay_loop(replace(run, poses=poses)).first_difference
    assert first is not None
    assert (first.signal, first.time_ns) == ("sensed_x", run.poses.time_ns[row])
    assert first.replayed is None


def test_shaping_is_passed_anew() -> None:
    run = simulate_run(build_case("low_pass", max_duration_s=0.6))
    assert run.samples.shaped_turn_rate_rad_s is not None
    changed = run.samples.shaped_turn_rate_rad_s.copy()
    changed[5] += 1e-9
    samples = replace(run.samples, shaped_turn_rate_rad_s=changed)
    found = replace(run, samples=samples)
    for first in (replay_law(found).first_difference, replay_loop(found).first_difference):
        assert first is not None
        assert first.signal == "shaped_turn_rate"


@pytest.mark.parametrize("effect", ["disturbance", "disturbance_noise"])
def test_the_plant_is_driven_with_what_it_integrated(effect: str) -> None:
    run = simulate_run(build_case(effect, max_duration_s=1.5))
    found = replay_plant(run)
    assert found.first_difference is None
    # From 0.3 s to below 1.1 s: ticks 19 to 68; noise acts from the first tick on.
    ticks = 50 if effect == "disturbance" else len(run.poses)
    assert found.commands.disturbed_ticks == found.commands.unexplained_ticks == ticks
    assert found.commands.never_arrived == 0
    unknown = replay_plant(replace(run, parameters={})).commands
    assert (unknown.disturbed_ticks, unknown.unexplained_ticks) == (0, ticks)


def test_commands_that_never_arrive_are_counted() -> None:
    run = simulate_run(build_case("loss", max_duration_s=1.5))
    found = replay_plant(run)
    assert found.first_difference is None
    assert found.commands.never_arrived > 10
    assert found.commands.taken > len(run.commands) - found.commands.never_arrived
    assert (found.commands.disturbed_ticks, found.commands.unexplained_ticks) == (0, 0)


def test_velocities_of_32_bits_that_stand_for_commands_differ_by_no_more_than_they_round() -> None:
    push = {"disturbance.turn_rate_rad_s": 0.0313, "disturbance.noise_speed": 0.01}
    run = simulate_run(override_scenario(get_preset("textbook"), push))
    found = replay_plant(run)
    assert found.commands.disturbed_ticks == len(run.poses)
    assert found.first_difference is None
    # Within what the sum of the rounded velocities may be off, and beyond that of a first pose.
    (stretch,) = found.stretches
    assert stretch.max_abs_error.x_m < stretch.rounding_m < 1e-4
