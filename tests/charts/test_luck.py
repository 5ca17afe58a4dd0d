from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.known import known
from tests.lucky_runs import METRIC, NOISY, attribute_lucky, measure_lucky
from turtlelog.charts import palette
from turtlelog.charts.attribution_steps import list_attribution_steps
from turtlelog.charts.close_up import format_length
from turtlelog.charts.luck_chart import LuckPicture, build_luck_picture, spread_labels
from turtlelog.explain import Luck


@pytest.fixture(scope="module")
def kp10() -> LuckPicture:
    return build_luck_picture(measure_lucky("paper-kp10"))


def change(luck: Luck, curve: int, row: int, value: float) -> Luck:
    """Return luck with another value of one curve from one start."""
    values = luck.curves[curve].values.copy()
    values[row] = value
    curves = [*luck.curves]
    curves[curve] = replace(curves[curve], values=values)
    return replace(luck, curves=tuple(curves))


def test_the_sentences_tell_the_values_and_whether_luck_decides(kp10: LuckPicture) -> None:
    assert kp10.sentences == (
        "final.position_error: 39 to 473 mm with all effects, at most 5.7 mm without queue and"
        " pause.",
        "It depends on single samples.",
    )
    assert known(kp10.recorded) == pytest.approx((0.0, 106.728), abs=1e-3)
    assert kp10.recorded_name == "this run: 107 mm"
    assert kp10.value_label == "final position error [mm]"
    assert kp10.place_label.endswith("[deg] (one sample turns 0.917 deg)")
    assert known(kp10.plane).note == "without queue and pause:\nall 65 within 5.7 mm"


@pytest.mark.everyday("steady")
@pytest.mark.parametrize(
    ("preset", "metric", "sentences"),
    [
        (
            "paper-kp4",
            METRIC,
            (
                f"{METRIC}: 8.0 to 9.1 mm with all effects, 5.3 to 5.7 mm without queue and pause.",
                "It depends little on the start.",
            ),
        ),
        (
            "paper-kp2",
            "rotate.rms_error",
            (
                "rotate.rms_error: 50 to 51 deg with all effects, 50.9 to 51.4 deg without queue"
                " and pause.",
                "It depends on the start; what the effects add depends little on it.",
            ),
        ),
        (
            "textbook",
            METRIC,
            (
                f"{METRIC}: 5.6 to 5.7 mm with all effects; no effect is in this run.",
                "It depends little on the start.",
            ),
        ),
    ],
    ids=["steady", "follows", "no-effect"],
)
def test_a_value_that_is_steady_is_not_called_luck(
    preset: str, metric: str, sentences: tuple[str, ...]
) -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    assert build_luck_picture(measure_lucky(preset, (), metric)).sentences == sentences


@pytest.mark.thorough
def test_of_seeds_every_word_says_so() -> None:
    """Take two seconds: 32 seeds of each combination are simulated."""
    shown = build_luck_picture(measure_lucky("textbook", NOISY))
    assert shown.sentences[1] == "Each seed gives another value."
    assert shown.place_label == "32 seeds, by the value with all effects"
    assert known(shown.plane).title == "where 32 seeds end"
    whole, without = shown.lines
    assert (np.diff(whole.values) >= 0.0).all()
    assert (whole.is_joined, without.is_joined) == (False, True)
    place, value = known(shown.recorded)
    assert (whole.values <= value).sum() == place - 0.5


def test_causes_have_the_colours_of_the_attribution(kp10: LuckPicture) -> None:
    steps = list_attribution_steps(attribute_lucky("paper-kp10"))
    colors = {step.cause: step.color for step in steps if step.cause}
    assert [(line.name, line.color) for line in kp10.lines] == [
        ("with all effects", palette.MAIN),
        ("without queue", colors["queue"]),
        ("without pause", colors["pause"]),
        ("without both", palette.GHOST),
    ]


def test_curves_break_where_neighbours_jump_and_nowhere_else(kp10: LuckPicture) -> None:
    whole, queue, *_ = kp10.lines
    assert len(whole.pieces) == 4
    assert queue.pieces == ((0, 64),)
    for first, last in whole.pieces:
        assert np.abs(np.diff(whole.values[first : last + 1])).max(initial=0.0) < 10.0
    for (_, last), (first, _) in zip(whole.pieces, whole.pieces[1:], strict=False):
        assert first == last + 1
        assert abs(whole.values[first] - whole.values[last]) > 80.0


def test_a_start_without_a_value_breaks_a_curve_and_is_counted() -> None:
    shown = build_luck_picture(change(measure_lucky("paper-kp10"), 1, 30, np.nan))
    assert shown.lines[1].pieces == ((0, 29), (31, 64))
    less = build_luck_picture(change(measure_lucky("paper-kp10"), 3, 30, np.nan))
    assert "(no value from 1 start) without queue and pause." in less.sentences[0]


def test_a_bound_is_never_less_than_what_it_bounds() -> None:
    luck = change(measure_lucky("paper-kp10"), 3, 0, 0.00571)
    assert "at most 5.8 mm without" in build_luck_picture(luck).sentences[0]
    luck = change(measure_lucky("paper-kp10"), 3, 0, 0.0057)
    assert "at most 5.7 mm without" in build_luck_picture(luck).sentences[0]


@pytest.mark.parametrize(("part", "is_bound"), [(0.49, True), (0.51, False)])
def test_values_are_told_by_their_bound_below_half_of_those_with_effects(
    part: float, *, is_bound: bool
) -> None:
    luck = measure_lucky("paper-kp10")
    value = part * float(luck.curves[0].values.min())
    assert ("at most" in build_luck_picture(change(luck, 3, 0, value)).sentences[0]) == is_bound


def test_a_run_without_a_value_of_its_own_has_no_mark() -> None:
    shown = build_luck_picture(replace(measure_lucky("paper-kp10"), recorded=None))
    assert (shown.recorded, shown.recorded_name) == (None, "this run: no value")


def test_without_a_goal_there_is_no_plane() -> None:
    assert build_luck_picture(replace(measure_lucky("paper-kp10"), goal_xy_m=None)).plane is None


def test_the_plane_shows_every_end_and_its_rings(kp10: LuckPicture) -> None:
    plane = known(kp10.plane)
    shown_m = np.concatenate([plane.ends_m, plane.ghosts_m, plane.recorded_m[np.newaxis]])
    assert len(shown_m) == 131
    assert np.hypot(*shown_m.T).max() < plane.half_m
    assert plane.rings_m == (0.2, 0.4)
    assert [*map(format_length, plane.rings_m)] == ["200 mm", "400 mm"]


@given(
    values=st.lists(st.floats(0.0, 10.0), min_size=1, max_size=8),
    height=st.floats(0.1, 1.2),
)
def test_labels_keep_off_each_other_in_the_order_of_their_values(
    values: list[float], height: float
) -> None:
    places = spread_labels(values, height, (0.0, 10.0))
    ordered = [place for _, place in sorted(zip(values, places, strict=True))]
    assert all(gap >= height - 1e-9 for gap in np.diff(ordered))
    assert ordered[0] >= height / 2.0 - 1e-9
    assert ordered[-1] <= 10.0 - height / 2.0 + 1e-9


def test_labels_with_room_stand_at_their_values() -> None:
    assert spread_labels([5.0, 1.0, 8.0], 1.0, (0.0, 10.0)) == [5.0, 1.0, 8.0]
    assert spread_labels([5.0, 5.2], 1.0, (0.0, 10.0)) == pytest.approx([4.6, 5.6])
