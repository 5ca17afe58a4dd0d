"""Means over seeds against a second simulation, and what is said where seeds differ."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.effects_cases import EFFECTS
from turtlelog.explain import (
    Attribution,
    Certainty,
    attribute_run,
    attribute_scenario,
    identify_run,
    write_sentences,
)
from turtlelog.explain.answers import is_clear
from turtlelog.explain.causes import draws_random
from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import simulate_run

SEEDS, STEPS, PERIOD_S = 1000, 62, 0.016
BEARING_RAD = 0.8

LOOP = {
    "max_duration_s": STEPS * PERIOD_S,
    "law.kp_angular": 8.0,
    "law.heading_tolerance_rad": 1e-9,
    "limits.turn_rate_rad_s": 100.0,
    "start.heading_rad": float(np.pi / 4.0 - BEARING_RAD),
    "goal.x_m": 6.544444561004639,
    "goal.y_m": 6.544444561004639,
    "loop.pose_precision": "float64",
}
"""A turn of 0.8 rad that never ends."""


SLOW = {"sensing_jitter", "lagged"}

Values = NDArray[np.float64]


def change(**values: Any) -> Scenario:
    return override_scenario(get_preset("textbook"), {**LOOP, **values})


def simulate_loop(kp: float, *, loss: float = 0.0, noise: float = 0.0) -> Values:
    """Return the last error [deg] of P loops on 1/s, one for each seed."""
    rng, error = np.random.default_rng(8), np.full(SEEDS, BEARING_RAD)
    held, last = np.zeros(SEEDS), error
    for step in range(STEPS + 1):
        # The first pose read gives the goal bearing; its command is 0.
        read = error + noise * rng.standard_normal(SEEDS)
        wanted = kp * read if step else np.zeros(SEEDS)
        last = error
        arrives = rng.random(SEEDS) >= loss
        held = np.where(arrives, wanted, held)
        error = error - PERIOD_S * held
    return np.asarray(np.degrees(np.abs(last)))


@pytest.mark.parametrize(
    ("kp", "values", "options"),
    [
        (4.0, {"loop.loss_probability": 0.6}, {"loss": 0.6}),
        (8.0, {"sensing.noise_heading_rad": 0.03}, {"noise": 0.03}),
    ],
)
def test_a_share_is_the_mean_of_a_thousand_seeds_of_a_second_simulation(
    kp: float, values: dict[str, float], options: dict[str, float]
) -> None:
    scenario = change(**values, **{"law.kp_angular": kp})
    found = attribute_scenario(scenario, metric="final.heading_error")
    many, none = simulate_loop(kp, **options), simulate_loop(kp)
    assert np.ptp(none) == 0.0
    assert found.without_all == pytest.approx(none[0], rel=1e-6)
    (share,) = found.contributions
    assert share.contribution is not None
    assert share.standard_error is not None
    expected = float((many - none).mean())
    error = np.hypot(share.standard_error, many.std() / np.sqrt(SEEDS))
    assert share.standard_error == pytest.approx(many.std() / np.sqrt(32), rel=0.4)
    assert abs(share.contribution - expected) < 3.0 * error
    assert abs(expected) > 3.0 * error


@pytest.mark.parametrize(("size", "clear"), [(3.1, True), (2.9, False)])
def test_a_share_is_named_beyond_three_standard_errors(size: float, clear: bool) -> None:  # noqa: FBT001
    assert is_clear(size, 1.0) == clear
    found = attribute_scenario(
        change(**{"sensing.noise_heading_rad": 0.03}), metric="final.heading_error"
    )
    (share,) = found.contributions
    assert share.contribution is not None
    found = replace(
        found, contributions=(replace(share, standard_error=share.contribution / size),)
    )
    sentences = " ".join(write_sentences(found))
    assert (": noise +" in sentences) == clear
    assert ("The contribution of noise (" in sentences) != clear


def attribute_unknown_seed(logged_deg: float) -> Attribution:
    """Attribute a log whose scenario is random, and whose seed is not known."""
    run = simulate_run(change(**{"sensing.noise_heading_rad": 0.03}))
    identified = identify_run(run)
    assert identified.is_recorded
    heading_rad = run.poses.heading_rad.copy()
    heading_rad[-1] = np.pi / 4.0 - np.radians(logged_deg)
    logged = replace(run, poses=replace(run.poses, heading_rad=heading_rad))
    identified = replace(identified, is_recorded=False)
    return attribute_run(logged, metric="final.heading_error", identified=identified)


@pytest.mark.thorough
def test_of_an_unknown_seed_the_log_lies_in_the_central_95_of_seeds() -> None:
    seeds = attribute_unknown_seed(1.0).seeds
    assert seeds is not None
    margin = 0.02 * (seeds.high - seeds.low)
    for logged_deg, outside in ((seeds.high - margin, False), (seeds.high + margin, True)):
        found = attribute_unknown_seed(logged_deg)
        reason = found.withheld or ""
        assert reason.startswith("the log's value lies outside of the central") == outside
        assert bool(found.contributions) != outside


@pytest.mark.parametrize("name", EFFECTS)
def test_a_recorded_effect_leaves_settings_as_recorded_and_none_wrong(name: str) -> None:
    scenario = override_scenario(
        get_preset("textbook"), {"law.kp_angular": 2.0, "max_duration_s": 5.0, **EFFECTS[name]}
    )
    found = identify_run(simulate_run(scenario))
    assert found.is_recorded
    assert found.resimulation is not None
    assert found.resimulation.is_exact
    assert found.findings["loop.queue_policy"].certainty is Certainty.RECORDED
    assert found.findings["loop.queue_policy"].value == scenario.loop.queue_policy
    gain = found.findings["law.kp_angular"]
    low, high = gain.interval or (gain.value, gain.value)
    assert low <= 2.0 <= high
    assert draws_random(scenario) == draws_random(found.build_scenario())


def strip(run: Run) -> Run:
    """Return a run as somebody else's, without its scenario."""
    return replace(run, parameters={}, scenario_is_complete=False, stop_reason=None, events=())


NEAR = {
    "law.kp_angular": 2.0,
    "start.heading_rad": 2.0,
    "goal.x_m": 5.2,
    "goal.y_m": 5.9,
    "max_duration_s": 3.0,
}
"""A small turn and a short way, so that both gains act below the limits."""

TELL_BOTH_GAINS = {"noise", "sensing_delay", "transport_delay", "dead_zone"}


# The others are looked at for half a minute.
@pytest.mark.everyday("late", "dead_zone")
@pytest.mark.parametrize("name", [name for name in EFFECTS if name not in SLOW])
def test_of_a_log_without_scenario_nothing_false_is_claimed(name: str) -> None:
    scenario = override_scenario(get_preset("textbook"), {**NEAR, **EFFECTS[name]})
    found = identify_run(strip(simulate_run(scenario))).findings
    said: dict[str, Any] = {
        "law.kp_angular": 2.0,
        "law.kp_linear": 1.0,
        "loop.start_backlog": 1,
        "loop.queue_policy": scenario.loop.queue_policy,
    }
    for key, value in said.items():
        finding = found[key]
        holds = value == finding.value or value in finding.candidates
        if finding.interval is not None:
            low, high = finding.interval
            holds = low <= value <= high
        assert holds or finding.value is None, (key, finding)
    assert (found["law.kp_linear"].value is not None) == (name in TELL_BOTH_GAINS)
    delay = found["loop.transport_delay_ticks"]
    delay_s = scenario.loop.transport_delay_s + scenario.sensing.delay_s
    if delay.value is not None:
        assert delay.value == delay_s // 0.016
        assert not delay.value or "so does any delay from" in delay.evidence
