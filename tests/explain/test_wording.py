from dataclasses import replace
from typing import Any

import pytest

from tests.known import known
from tests.log.runs import find_shared
from turtlelog.cli.explain_answer import format_causes, format_identification
from turtlelog.explain import (
    Attribution,
    Contribution,
    Resolution,
    ResolutionReason,
    SeedRange,
    StartRange,
    Together,
    ValueSet,
    attribute_run,
    attribute_scenario,
    find_causes,
    identify_run,
    write_headline,
    write_sentences,
)
from turtlelog.explain.answer_words import write_joint_parts
from turtlelog.log import import_log
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

CAUSES = find_causes(get_preset("paper-kp10"))


def make_contribution(*, cause: str, **values: Any) -> Contribution:
    return Contribution(cause=cause, meaning=CAUSES[cause].meaning, **values)


JOINT = (Together(causes=("queue", "pause"), value=0.5),)


def describe(*, queue: float = 0.0, pause: float = 0.0, **changes: Any) -> Attribution:
    """Return an attribution of an error of 1 m, of which nothing else is known."""
    added = queue + pause
    found = Attribution(
        metric="final.position_error",
        unit="m",
        as_logged=1.0,
        resimulated=1.0,
        without_all=1.0 - added,
        causes=("queue", "pause"),
        contributions=(
            make_contribution(cause="queue", contribution=queue, alone=1.0 - queue),
            make_contribution(cause="pause", contribution=pause, alone=1.0 - pause),
        ),
        others=(),
        resolution=Resolution(size=0.01, reason=ResolutionReason.HEADING_TOLERANCE),
        effects=("queue", "delay", "pause", "wrap"),
    )
    return replace(found, **changes)


def take_out(name: str, alone: float | None, ending: str = "") -> dict[str, Any]:
    return {
        "others": (make_contribution(cause=name, contribution=None, alone=alone, ending=ending),)
    }


def test_the_gain_of_ten_in_words() -> None:
    assert write_sentences(attribute_scenario(get_preset("paper-kp10"))) == (
        "final.position_error is 0.1067 m.",
        "Two effects of the implementation cause it together in this run: queue +0.05108 m and"
        " pause +0.05057 m.",
        "Without queue it would be 0.02684 m, without pause 0.02735 m, without both 0.005077 m;"
        " the tolerances alone allow 0.006693 m.",
        "It depends on single samples: for 17 start headings within +-0.458 deg it is 0.03943 to"
        " 0.4734 m, without both 0.00482 to 0.005677 m. Queue contributes 16 to 62 % of the total"
        " that queue and pause add.",
        "Queue and pause act together: 0.05761 m of what they add arises only if both act.",
        "Not a cause: saturation and sampling. The value is larger without saturation (0.8506 m)"
        " and without sampling (0.1361 m).",
        "Design parameter: tolerance. Without it (tolerances of 1e-06) the value is 0.0009877 m.",
    )


@pytest.mark.parametrize("name", ["paper-kp1", "paper-kp2", "paper-kp4"])
def test_at_lower_gains_queue_and_pause_are_negligible(name: str) -> None:
    told = write_sentences(attribute_scenario(get_preset(name)))
    (cause,) = [text for text in told if "within the resolution" in text]
    assert cause.startswith("Together, queue, pause and wrap change it by ")
    assert "m. This is within the resolution of 0.006693 m (heading tolerance times" in cause


def test_six_ticks_of_delay_are_named_by_their_time() -> None:
    scenario = override_scenario(get_preset("textbook"), {"loop.transport_delay_ticks": 6})
    sentences = write_sentences(attribute_scenario(scenario, metric="rotate.settling_time"))
    assert sentences[1:4] == (
        "Design parameter: saturation. Without it (no limit of speed and turn rate) the value is"
        " 3.599 s.",
        "One effect of the implementation changes it: delay -0.215 s.",
        "Without delay it would be 4.338 s.",
    )


def test_log_and_re_simulation_stand_side_by_side() -> None:
    run = import_log(find_shared("paper", "kp4_210.json"))
    assert write_sentences(attribute_run(run, metric="rotate.overshoot")) == (
        "rotate.overshoot is 0.03936 % in the log, and 0.06673 % re-simulated.",
        "No contributions: log and re-simulation differ by more than a tenth of what the effects"
        " add together.",
    )


@pytest.mark.parametrize(
    ("changes", "first"),
    [
        ({}, "is 1 m, in the log and re-simulated."),
        ({"as_logged": 1.2}, "is 1.2 m in the log, and 1 m re-simulated."),
        (
            {"as_logged": 1.0 + 1.1e-6},
            "is 1 m, in the log and re-simulated; they differ by 1.1e-06 m.",
        ),
        ({"as_logged": 1.0 + 0.9e-6}, "is 1 m, in the log and re-simulated."),
        (
            {"as_logged": None, "reason": "no goal"},
            "is 1 m re-simulated, and has no value in the log: no goal.",
        ),
        (
            {"resimulated": None, "reason": "no phase"},
            "is 1 m in the log; re-simulated it has no value.",
        ),
        ({"as_logged": None, "resimulated": None, "reason": "no goal"}, "has no value: no goal."),
    ],
)
def test_the_value_is_the_logs_and_the_re_simulations(changes: Any, first: str) -> None:
    assert write_sentences(describe(**changes))[0] == f"final.position_error {first}"


@pytest.mark.parametrize(
    ("queue", "cause"),
    [
        (
            0.0099,
            "Together, queue and pause change it by 0.0099 m. This is within the resolution of ",
        ),
        (0.0101, "One effect of the implementation changes it: queue +0.0101 m."),
        (-0.0101, "One effect of the implementation changes it: queue -0.0101 m."),
    ],
)
def test_an_effect_is_named_beyond_the_resolution(queue: float, cause: str) -> None:
    assert write_sentences(describe(queue=queue))[1].startswith(cause)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"queue": 0.011}, "queue +0.011 m"),
        ({"queue": 0.009}, "effects add only 0.009 m"),  # within the resolution of 0.01 m
        (
            {"queue": -0.009},
            "the effects lower it by 0.009 m, within its resolution of 0.01 m",
        ),
        ({"contributions": ()}, "no effect changes it"),
        ({"queue": 0.5, "pause": 0.3, "together": JOINT}, "queue and pause add 0.8 m"),
        ({"queue": 0.5, "pause": 0.3}, "mainly queue +0.5 m"),
        (take_out("tolerance", 0.2), "without tolerance 0.2 m; no effect changes it"),
        ({"queue": 0.4} | take_out("tolerance", 0.51), "queue +0.4 m"),
        ({"queue": 0.4} | take_out("tolerance", 0.49), "without tolerance 0.49 m; queue +0.4 m"),
        ({"queue": 0.5, "pause": -0.4} | take_out("tolerance", 0.4), "queue +0.5 m, pause -0.4 m"),
        (take_out("tolerance", 0.2, "it never ends"), "no effect changes it"),
        (take_out("tolerance", None, "no phase"), "no effect changes it"),
        (take_out("float32", 5.0), "no effect changes it"),  # without it, the value is larger
    ],
)
def test_the_first_line_names_causes_or_says_that_there_are_none(changes: Any, told: str) -> None:
    assert write_headline(describe(**changes)) == f"final.position_error is 1 m: {told}"


@pytest.mark.parametrize(("pause", "is_named"), [(0.0110, False), (0.0112, True)])
def test_an_effect_is_named_beyond_a_tenth_of_all(pause: float, *, is_named: bool) -> None:
    cause, rest = write_sentences(describe(queue=0.1, pause=pause))[1:3]
    assert ("pause +0.011" in cause) == is_named
    told = "without both 0.88" if is_named else "Without queue and pause it would be 0.88"
    assert told in rest


def test_contributions_that_cancel_are_named_all_the_same() -> None:
    assert write_sentences(describe(queue=0.3, pause=-0.299))[1:] == (
        "Two effects of the implementation change it: queue +0.3 m and pause -0.299 m.",
        "Without queue it would be 0.7 m, without pause 1.299 m, without both 0.999 m. Together"
        " they change it by not more than 0.01 m (the heading tolerance).",
    )


@pytest.mark.parametrize(
    ("queue", "pause", "head"),
    [
        (0.5, 0.4, "Two effects of the implementation cause it, in about equal parts"),
        (0.6, 0.4, "Two effects of the implementation cause it"),
        (0.5, 0.3, "Two effects of the implementation change it"),
        (0.99, 0.0, "One effect of the implementation causes it"),
    ],
)
def test_effects_cause_a_value_of_which_they_leave_a_tenth_at_most(
    queue: float, pause: float, head: str
) -> None:
    assert write_sentences(describe(queue=queue, pause=pause))[1].startswith(f"{head}: ")


@pytest.mark.parametrize(
    ("effects", "head"),
    [
        (("queue", "pause"), "Two effects of the implementation change it"),
        (("queue",), "Two effects and design parameters change it"),
        ((), "Two design parameters change it"),
    ],
)
def test_design_parameters_that_take_part_are_not_called_effects(
    effects: tuple[str, ...], head: str
) -> None:
    found = describe(queue=0.4, pause=0.2, effects=effects)
    assert write_sentences(found)[1].startswith(f"{head}: queue +0.4 m")


def test_what_is_not_there_is_not_said_to_act() -> None:
    assert write_sentences(describe())[1] == "Without queue or pause it is the same."
    assert write_sentences(describe(causes=(), contributions=()))[1] == (
        "No effect of the implementation is in this run."
    )


@pytest.mark.parametrize(("size", "is_told"), [(0.009, False), (0.011, True)])
def test_what_arises_only_together_is_told_from_a_tenth_on(size: float, *, is_told: bool) -> None:
    case = Together(causes=("queue", "pause"), value=size)
    sentences = write_sentences(describe(queue=0.1, together=(case,)))
    told = f"Queue and pause act together: {size} m of what they add arises only if both act"
    assert any(one.startswith(told) for one in sentences) == is_told


@pytest.mark.parametrize(("size", "is_joint"), [(0.0499, False), (0.0501, True)])
def test_causes_act_together_if_more_than_half_arises_jointly(
    size: float, *, is_joint: bool
) -> None:
    case = Together(causes=("queue", "pause"), value=size)
    cause = write_sentences(describe(queue=0.05, pause=0.05, together=(case,)))[1]
    assert ("cause it together: " in cause or "change it together: " in cause) is is_joint
    assert ("in about equal parts" in cause) is not is_joint


def test_what_makes_less_together_is_told_too() -> None:
    case = Together(causes=("queue", "pause"), value=-0.011)
    sentences = write_sentences(describe(queue=0.1, together=(case,)))
    told = (
        "Queue and pause overlap: together they add 0.011 m less than queue alone plus pause alone."
    )
    assert told in sentences


@pytest.mark.parametrize(
    ("size", "told"),
    [
        (0.3, "overlap: together they take away 0.3 m less than queue alone plus pause alone."),
        (-0.3, "act together: 0.3 m of what they take away arises only if both act."),
    ],
)
def test_what_effects_that_improve_the_value_do_together(size: float, told: str) -> None:
    case = Together(causes=("queue", "pause"), value=size)
    sentences = write_sentences(describe(queue=-0.2, pause=-0.25, together=(case,)))
    assert f"Queue and pause {told}" in sentences
    assert ("change it together" in sentences[1]) is (size < 0.0)


def test_what_effects_that_alone_do_nothing_take_away_together() -> None:
    case = Together(causes=("queue", "pause"), value=-0.5)
    sentences = write_sentences(describe(queue=-0.25, pause=-0.25, together=(case,)))
    told = "Queue and pause act together: 0.5 m of what they take away arises only if both act."
    assert told in sentences


@pytest.mark.parametrize("queue", [-0.4, -0.06, 0.0, 0.06, 0.4])
@pytest.mark.parametrize("pause", [-0.25, -0.03, 0.0, 0.03, 0.25])
@pytest.mark.parametrize("joint", [-1.0, -0.2, 0.2, 1.0])
@pytest.mark.parametrize("third", [-0.6, 0.6])
def test_joint_parts_are_told_by_what_causes_do_alone_and_together(
    queue: float, pause: float, joint: float, third: float
) -> None:
    """A part of three causes, which the contributions of the pair share, changes no words."""
    pair = Together(causes=("queue", "pause"), value=joint)
    three = Together(causes=("queue", "pause", "lag"), value=third)
    sizes = {
        "queue": queue + joint / 2.0 + third / 3.0,
        "pause": pause + joint / 2.0 + third / 3.0,
        "lag": third / 3.0,
    }
    apart, whole = queue + pause, queue + pause + joint
    text = write_joint_parts((pair, three), sizes, {}, lambda size, _: f"{size:.4g} m")
    told = next(one for one in text.split(". ") if one.startswith("Queue and pause "))
    change = {True: "add", False: "take away"}
    if abs(apart) <= 0.1 * abs(joint) or apart * joint > 0.0:
        does = f"{abs(joint):.4g} m of what they {change[joint > 0.0]} arises only if both act"
        assert told.removesuffix(".") == f"Queue and pause act together: {does}"
    elif whole * apart < 0.0:
        alone = f"queue alone plus pause alone would {change[apart > 0.0]} {abs(apart):.4g} m"
        both = f"but both together {change[whole > 0.0]} {abs(whole):.4g} m"
        assert told.removesuffix(".") == f"Queue and pause act together: {alone}, {both}"
    else:
        less = f"together they {change[apart > 0.0]} {abs(joint):.4g} m less than"
        alone = "queue alone plus pause alone"
        assert told.removesuffix(".") == f"Queue and pause overlap: {less} {alone}"


def test_without_an_effect_a_phase_that_never_ends_is_told() -> None:
    found = describe(queue=-0.2, pause=0.1)
    first, *others = found.contributions
    first = replace(first, ending="the rotation no longer ends within 60 s")
    text = " ".join(write_sentences(replace(found, contributions=(first, *others))))
    assert "Without queue alone, the rotation no longer ends within 60 s." in text
    assert "Without pause alone" not in text


@pytest.mark.parametrize(
    ("alone", "is_named"), [(1.0999, False), (1.1001, True), (0.9001, False), (0.8999, True)]
)
def test_a_property_is_named_from_a_tenth_of_the_value_on(alone: float, *, is_named: bool) -> None:
    sentences = write_sentences(describe(queue=0.5, **take_out("float32", alone)))
    named = f"Design parameter: float32. Without it (poses of 64 bits) the value is {alone:.4g} m."
    if alone > 1.0:
        named = f"Not a cause: float32. Without it the value is larger: {alone:.4g} m."
    assert (named in sentences) == is_named


@pytest.mark.parametrize(("alone", "is_named"), [(1.199, False), (1.201, True)])
def test_a_property_is_named_beyond_the_resolution(alone: float, *, is_named: bool) -> None:
    resolution = Resolution(size=0.2, reason=ResolutionReason.HEADING_TOLERANCE)
    sentences = write_sentences(describe(resolution=resolution, **take_out("float32", alone)))
    assert any("float32. Without it" in text for text in sentences) == is_named


def test_the_tolerance_is_not_judged_by_the_resolution_that_it_makes() -> None:
    tolerated = Resolution(size=2.0, reason=ResolutionReason.HEADING_TOLERANCE)
    sentences = write_sentences(describe(resolution=tolerated, **take_out("tolerance", 0.1)))
    assert sentences[1].startswith("Design parameter: tolerance. Without it")
    period = Resolution(size=2.0, reason=ResolutionReason.SAMPLE)
    sentences = write_sentences(describe(resolution=period, **take_out("tolerance", 0.1)))
    assert not any("tolerance" in text for text in sentences)


def test_a_property_without_which_something_never_ends_has_no_value() -> None:
    ending = "the rotation no longer ends within 60 s"
    sentences = write_sentences(describe(**take_out("tolerance", 5.7, ending)))
    assert sentences[-1] == (
        "Design parameter: tolerance. Without it (tolerances of 1e-06), the rotation no longer ends"
        " within 60 s."
    )
    sentences = write_sentences(describe(**take_out("tolerance", None, "no phase")))
    assert sentences[-1].endswith("Without it (tolerances of 1e-06) there is no value: no phase.")


def test_what_has_no_value_is_explained_by_the_sets_that_decide() -> None:
    case = ValueSet(causes=("queue", "pause"), reason="no phase")
    found = describe(
        without_value=(case,), contributions=(), resimulated=None, as_logged=None, reason="no"
    )
    assert write_sentences(found)[1:] == (
        "With queue and pause it has no value: no phase. Therefore there are no contributions.",
    )
    never = ValueSet(causes=(), reason="no phase")
    ever = ValueSet(causes=("queue",))
    found = describe(without_value=(never,), with_value=(ever,), without_all=None, contributions=())
    assert write_sentences(found)[1] == (
        "Without queue and pause it has no value: no phase; with queue alone it has a"
        " value. Therefore there are no contributions."
    )


def test_starts_without_a_value_are_counted() -> None:
    starts = StartRange(
        count=17, within_rad=0.008, low=0.9, high=1.1, without_value=3, is_wide=False
    )
    assert write_sentences(describe(queue=0.5, starts=starts))[3] == (
        "For 17 start headings within +-0.458 deg it is 0.9 to 1.1 m; 3 of them have no value."
    )


def describe_noise(*, share: float = 0.0, low: float = 1.0, high: float = 1.0) -> Attribution:
    seeds = SeedRange(count=32, used=32, mean=1.0, standard_error=high - low, low=low, high=high)
    noise = make_contribution(
        cause="noise", contribution=share, alone=1.0 - share, standard_error=high - low
    )
    return describe(
        causes=("noise",),
        contributions=(noise,),
        seeds=seeds,
        effects=("noise",),
        without_all=1.0 - share,
    )


def test_noise_that_changes_nothing_is_no_part_of_a_sum() -> None:
    noise = describe_noise()
    others = describe(queue=0.004, pause=0.002).contributions
    found = replace(
        noise,
        causes=("noise", "queue", "pause"),
        contributions=(*noise.contributions, *others),
        without_all=0.994,
    )
    assert write_sentences(found)[1].startswith("The noise does not change this metric.")
    assert write_sentences(found)[2].startswith("Together, queue and pause change it by 0.006 m")


def test_noise_that_changes_nothing_takes_one_sentence_and_no_table() -> None:
    found = describe_noise()
    assert write_sentences(found) == (
        "final.position_error is 1 m, in the log and re-simulated.",
        "The noise does not change this metric.",
    )
    text = format_causes(found)
    assert text == ""
    assert "this seed" not in found._repr_html_()


def test_noise_that_adds_the_same_with_every_seed_is_not_said_to_change_nothing() -> None:
    sentences = write_sentences(describe_noise(share=0.5))
    assert sentences[1] == (
        "One effect of the implementation changes it in the mean over seeds: noise +0.5 m."
    )
    assert sentences[2:4] == (
        "All 32 seeds give the same value.",
        "Without noise it would be 0.5 m.",
    )


def test_seeds_without_a_value_are_not_said_to_change_nothing() -> None:
    found = describe_noise()
    few = replace(found, seeds=replace(known(found.seeds), used=30))
    assert write_sentences(few)[1] == "The 30 of 32 seeds that give a value all give the same."


@pytest.mark.parametrize(("apart", "varies"), [(0.9e-12, False), (1.1e-12, True)])
def test_seeds_that_differ_by_rounding_are_alike(apart: float, *, varies: bool) -> None:
    assert known(describe_noise(high=1.0 + apart).seeds).varies is varies


def test_a_range_that_the_digits_do_not_show_is_told_as_its_width() -> None:
    told = write_sentences(describe_noise(share=0.5, low=1.0, high=1.000003))[2]
    assert "the central 95 % span 3e-06 m" in told


def test_what_changes_nothing_has_no_row() -> None:
    found = describe(queue=0.5, **take_out("float32", 1.0))
    text = format_causes(found)
    assert "queue" in text
    assert "poses of 64 bits" not in text
    assert "no pause after the rotation" not in text


def test_each_value_without_a_reason_of_its_own_stands_at_a_note() -> None:
    scenario = override_scenario(get_preset("lagged"), {"law.kind": "open-loop"})
    scenario = override_scenario(scenario, {"sensing.noise_position_m": 1e-3, "law.signal": "step"})
    text = " ".join(format_identification(identify_run(simulate_run(scenario))).split())
    assert "see below" not in text
    assert "only around turtlesim. Therefore unknown: initial queue, lost commands," in text
