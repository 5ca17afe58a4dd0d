"""`explain` finds every effect and every property, alone and in pairs, and names no other."""

import math
import re
from typing import Any

import msgspec
import pytest

from turtlelog.cli.explain_answer import format_causes
from turtlelog.errors import ExplainError
from turtlelog.explain import (
    Attribution,
    Work,
    attribute_scenario,
    write_sentences,
)
from turtlelog.explain.causes import (
    LOOP_CAUSES,
    draws_random,
    find_causes,
    list_effects,
)
from turtlelog.explain.game import SEEDS
from turtlelog.scenario import Scenario, get_preset, override_scenario

SHORT = {"max_duration_s": 2.0, "goal.x_m": 6.5, "goal.y_m": 6.1, "law.kp_angular": 8.0}
"""A turn of 30 deg and the begin of a drive, without any effect."""

EFFECTS: dict[str, tuple[str, dict[str, Any]]] = {
    "queue": ("rotate.overshoot", {"loop.queue_policy": "one-per-tick", "loop.start_backlog": 6}),
    "delay": ("rotate.overshoot", {"loop.transport_delay_s": 0.06, "sensing.delay_s": 0.04}),
    "jitter": ("rotate.overshoot", {"loop.jitter_s": 0.2}),
    "loss": ("rotate.overshoot", {"loop.loss_probability": 0.85, "law.kp_angular": 20.0}),
    "late": ("rotate.overshoot", {"loop.late_probability": 0.3, "loop.late_s": 0.2}),
    "noise": ("rotate.total_variation", {"sensing.noise_heading_rad": 0.01}),
    "bias": ("final.heading_error", {"sensing.bias_heading_rad": 0.05}),
    "quantum": ("final.heading_error", {"sensing.quantum_heading_rad": 0.08}),
    "dropout": (
        "rotate.overshoot", {"sensing.dropout_probability": 0.8, "law.kp_angular": 20.0}
    ),
    "outlier": (
        "rotate.total_variation",
        {"sensing.outlier_probability": 0.05, "sensing.outlier_rad": 0.5},
    ),
    "disturbance": ("final.heading_error", {"disturbance.turn_rate_rad_s": 0.2}),
    "disturbance, noise": ("final.heading_error", {"disturbance.noise_turn_rate": 0.1}),
    "pause": ("final.heading_error", {"law.pause_ticks": 33}),
    "wrap": (
        "final.heading_error",
        {"law.wrap_error": False, "start.heading_rad": -2.8, "goal.x_m": 3.0, "goal.y_m": 6.0},
    ),
}  # fmt: skip
"""By cause: a metric that it changes, and the only effect of a run."""

ROBOT = {"plant.kind": "lagged", "plant.turn_lag_s": 0.1}

PROPERTIES: dict[str, tuple[str, str, dict[str, Any]]] = {
    "saturation": ("rotate.iae", "lower", {}),
    "acceleration": ("rotate.delay_time", "lower", {"limits.turn_acceleration_rad_s2": 1.0}),
    "jerk": ("rotate.delay_time", "lower", {"limits.turn_jerk_rad_s3": 2.0}),
    "shaping": ("rotate.iae", "lower", {"shaping.low_pass_s": 0.3}),
    "sampling": (
        "rotate.overshoot",
        "lower",
        {"law.kp_angular": 110.0, "limits.turn_rate_rad_s": 100.0},
    ),
    "sampling, timer": (
        "rotate.overshoot",
        "lower",
        {"loop.trigger": "timer", "loop.period_s": 0.15},
    ),
    "projection": (
        "final.position_error",
        "lower",
        {"law.projection": "bearing", "max_duration_s": 12.0, "law.pause_ticks": 100,
         "disturbance.turn_rate_rad_s": 1.0, "disturbance.from_s": 2.0, "disturbance.to_s": 3.0},
    ),
    "tolerance": ("rotate.duration", "higher", {"law.heading_tolerance_rad": 0.1}),
    "robot-acceleration": (
        "rotate.delay_time", "lower", {**ROBOT, "plant.turn_acceleration": 0.8}
    ),
    "robot-bound": ("rotate.iae", "lower", {**ROBOT, "plant.turn_bound": 0.4}),
    "robot-deadband": ("final.heading_error", "lower", {**ROBOT, "plant.turn_deadband": 0.3}),
    "robot-friction": ("final.heading_error", "lower", {**ROBOT, "plant.turn_friction": 0.3}),
    "robot-reverse-gain": (
        "rotate.iae", "lower",
        {**ROBOT, "plant.turn_reverse_gain": 0.4, "goal.x_m": 6.5, "goal.y_m": 4.9},
    ),
}  # fmt: skip
"""The same of properties."""


def change(**values: Any) -> Scenario:
    return override_scenario(get_preset("textbook"), {**SHORT, **values})


def attribute(scenario: Scenario, metric: str) -> Attribution:
    """Attribute a value with every effect that there is as a candidate."""
    effects = list_effects(find_causes(scenario))
    return attribute_scenario(scenario, metric=metric, causes=effects)


def find_named(sentence: str) -> set[str]:
    """Return the effects that a sentence names."""
    return {
        name
        for name in list_effects(find_causes(change()))
        if name in re.split(r"\W+", sentence.lower())
    }


@pytest.fixture
def half_of_the_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate with 16 seeds: whose share it is, is clear with them as well."""
    monkeypatch.setattr("turtlelog.explain.game.SEEDS", SEEDS[:16])


@pytest.mark.everyday("queue", "outlier")
@pytest.mark.usefixtures("half_of_the_seeds")
@pytest.mark.parametrize("case", EFFECTS)
def test_an_effect_alone_gets_all_of_what_effects_add(case: str) -> None:
    metric, values = EFFECTS[case]
    name = case.partition(",")[0]
    found = attribute(change(**values), metric)
    shares = {share.cause: share for share in found.contributions}
    assert found.without_all is not None
    assert abs(found.divided - found.without_all) > 0.3 * abs(found.divided)
    assert shares.pop(name).contribution == pytest.approx(found.divided - found.without_all)
    assert {share.contribution for share in shares.values()} <= {0.0}
    assert found.acting == (name,)
    assert found.left == ()
    sentences = write_sentences(found)
    assert find_named(" ".join(sentences)) == {name}
    assert any(text.startswith("One effect") and f": {name} " in text for text in sentences)
    assert (found.seeds is not None) == draws_random(change(**values))


@pytest.mark.everyday("saturation", "tolerance", "sampling")
@pytest.mark.parametrize("case", PROPERTIES)
def test_a_property_is_named_beside_with_its_direction(case: str) -> None:
    metric, way, values = PROPERTIES[case]
    name = case.partition(",")[0]
    found = attribute(change(**values), metric)
    other = next(share for share in found.others if share.cause == name)
    assert other.contribution is None
    assert other.alone is not None
    assert found.resimulated is not None
    assert abs(other.alone - found.resimulated) > 0.3 * abs(found.resimulated)
    assert ("higher" if other.alone > found.resimulated else "lower") == way
    (named,) = [text for text in write_sentences(found) if f": {name}. Without it" in text]
    assert (other.ending or f"{other.alone:.4g}") in named
    assert ("in the mean" in named) == (found.seeds is not None and not other.ending)
    assert not named.startswith("Not a cause") or way == "higher"


def test_float32_is_named_where_no_pose_of_32_bits_is_within_the_tolerance() -> None:
    values = {"law.heading_tolerance_rad": 1e-9, "law.kp_angular": 20.0}
    found = attribute(change(**values), "final.position_error")
    assert (
        "Design parameter: float32. Without it (poses of 64 bits), the rotation ends within 2 s."
        in write_sentences(found)
    )


def test_every_cause_has_a_case() -> None:
    cases = {case.partition(",")[0] for case in (*EFFECTS, *PROPERTIES)}
    # float32 and repeat have tests of their own.
    assert {*find_causes(change())} - cases == {"float32", "repeat"}
    assert {found.name for found in LOOP_CAUSES} - {*find_causes(change())} == set()


PAIRS = {
    ("delay", "jitter"): ("rotate.overshoot", {**EFFECTS["delay"][1], "loop.jitter_s": 0.05}),
    ("bias", "disturbance"): (
        "final.heading_error", {**EFFECTS["bias"][1], **EFFECTS["disturbance"][1]}
    ),
    ("late", "noise"): (
        "rotate.total_variation", {**EFFECTS["late"][1], **EFFECTS["noise"][1]}
    ),
}  # fmt: skip


@pytest.mark.usefixtures("half_of_the_seeds")
@pytest.mark.parametrize("names", PAIRS)
def test_the_shares_of_two_effects_add_up_and_both_are_named(names: tuple[str, str]) -> None:
    metric, values = PAIRS[names]
    found = attribute_scenario(change(**values), metric=metric)
    assert found.causes == names
    assert found.without_all is not None
    added = math.fsum(share.contribution or 0.0 for share in found.contributions)
    assert added == found.divided - found.without_all
    if found.seeds is not None:
        assert found.this_seed is not None
        assert added + found.this_seed == pytest.approx(
            (found.resimulated or 0.0) - found.without_all
        )
    (cause,) = [text for text in write_sentences(found) if text.startswith("Two effects")]
    assert find_named(cause) == {*names}


def test_what_needs_queue_and_repeat_both_is_said() -> None:
    values = {"loop.queue_policy": "one-per-tick", "loop.repeat_probability": 0.2}
    found = attribute_scenario(change(**values), metric="rotate.overshoot")
    shares = {share.cause: share.contribution for share in found.contributions}
    assert shares["queue"] == pytest.approx(shares["repeat"])
    assert "Queue and repeat act together: " in " ".join(write_sentences(found))


def test_what_each_of_loss_and_dropout_would_do_alone_is_said() -> None:
    values = {"loop.loss_probability": 0.97, "sensing.dropout_probability": 0.97}
    found = attribute_scenario(change(**values), metric="rotate.settling_time")
    assert [case.causes for case in found.without_value] == [("loss",), ("dropout",)]
    missing = write_sentences(found)[1]
    assert missing.startswith("With loss alone it has no value: ")
    assert "; with dropout alone it has no value: " in missing
    assert missing.endswith(" Therefore there are no contributions.")


@pytest.mark.parametrize(("chance", "used"), [(0.05, 30), (0.16, 20), (0.19, 16)])
def test_seeds_without_a_value_are_left_out_up_to_half_of_them(chance: float, used: int) -> None:
    metric, values = EFFECTS["outlier"]
    scenario = change(**{**values, "sensing.outlier_probability": chance})
    found = attribute_scenario(scenario, metric=metric)
    sentences = " ".join(write_sentences(found))
    if used > 16:
        text = f"Over {used} of 32 seeds (with the others it has no value, or none without some"
        assert text in sentences
    else:
        assert (
            f"No contributions: only with {used} of 32 seeds every combination has a" in sentences
        )


def test_two_runs_that_differ_in_their_seed_have_the_same_shares() -> None:
    values = {"sensing.noise_heading_rad": 0.01}
    found = [
        attribute_scenario(change(**values, seed=seed), metric="final.heading_error")
        for seed in (1, 2)
    ]
    assert found[0].contributions == found[1].contributions
    assert found[0].this_seed != found[1].this_seed
    assert found[0].starts is None


def test_a_combination_without_random_effects_is_simulated_once() -> None:
    steps: list[tuple[int, int]] = []
    values = {"loop.transport_delay_s": 0.1, "loop.loss_probability": 0.3}
    attribute_scenario(
        change(**values),
        metric="rotate.iae",
        work=Work(report=lambda done, total: steps.append((done, total))),
    )
    # Random: as built, without delay, and without each of three properties; and the own seed.
    assert steps[-1] == (5 * len(SEEDS) + 2 + 1, 5 * len(SEEDS) + 2 + 1)


def test_the_line_of_this_seed_stands_in_table_json_and_notebook() -> None:
    metric, values = EFFECTS["noise"]
    found = attribute_scenario(change(**values), metric=metric)
    assert found.this_seed is not None
    assert re.search(rf"^this seed +{found.this_seed:.4f}", format_causes(found), re.M)
    told = msgspec.to_builtins(found)
    assert told["this_seed"] == found.this_seed
    assert told["seeds"]["count"] == len(SEEDS)
    assert told["contributions"][0]["standard_error"] == found.contributions[0].standard_error
    assert ">this seed<" in found._repr_html_()


@pytest.mark.thorough
def test_as_many_processes_make_the_same_shares() -> None:
    scenario = change(**{"loop.jitter_s": 0.1, "max_duration_s": 1.0})
    alone, both = (
        attribute_scenario(scenario, metric="rotate.iae", work=Work(jobs=jobs)) for jobs in (1, 2)
    )
    assert alone == both
    with pytest.raises(ExplainError, match="jobs: expected at least 1 process, found 0"):
        Work(jobs=0)
