"""Many runs in one view: what they share is seen, and what is left out is named."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.draw.rerun.rrds import (
    list_entities,
    read_blueprint_parts,
    read_layout,
    read_static,
    simulate_preset,
)
from turtlelog.charts.many_runs import (
    LONGEST_NAME,
    choose_colors_by_value,
    cut_alike,
    find_color_scale,
    find_gain_scale,
    find_restless,
    group_equal,
    join_run_names,
    shorten_run_names,
)
from turtlelog.charts.palette import FEW
from turtlelog.draw import write_comparison_rrd
from turtlelog.draw.rerun.pictures import arrange_names, choose_names, view_legend
from turtlelog.run import Run
from turtlelog.scenario import get_preset, override_gains
from turtlelog.simulate import simulate_run

KEYS = ("law.kp_angular", "law.kp_linear")


def set_gain(run: Run, kp: float, **others: float | bool) -> Run:
    parameters = {**run.parameters, **dict.fromkeys(KEYS, kp), **others}
    return replace(run, name=f"gain-{kp:g}", parameters=parameters)


@cache
def simulate_gains() -> tuple[Run, ...]:
    """Return seven runs that come to rest, and one that does not."""
    swinging = simulate_run(override_gains(get_preset("paper-kp1"), KEYS, 25.0))
    calm = [simulate_preset(f"paper-kp{kp}") for kp in (1, 4, 10)]
    shifted = [
        replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m + 1e-3 * step))
        for step, run in enumerate([*calm, *calm, calm[0]])
    ]
    gains = [set_gain(run, 1.0 + number) for number, run in enumerate(shifted)]
    return (*gains, set_gain(swinging, 25.0))


@pytest.fixture(scope="module")
def many_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("many") / "many.rrd"
    write_comparison_rrd(simulate_gains(), path)
    return path


def test_a_bar_tells_the_colours_of_more_than_seven_runs(many_rrd: Path) -> None:
    layout = read_layout(many_rrd)
    assert layout["8 runs, coloured by Kp: 1 to 25"] == ["/legend/**"]
    values = read_static(many_rrd, "/legend/values", "Points2D:labels")
    assert values == ["1", "2", "3", "4", "5", "6", "7", "25"]
    colors = read_static(many_rrd, "/legend/values", "Points2D:colors")
    bar = read_static(many_rrd, "/legend/bar", "LineStrips2D:colors")
    assert list(dict.fromkeys(bar)) == colors


def test_of_many_runs_in_a_small_window_the_extremes_have_names(
    many_rrd: Path, tmp_path: Path
) -> None:
    entity = "/plane/close_up/misses"
    assert len(read_static(many_rrd, entity, "Points2D:labels")) > 2
    path = tmp_path / "small.rrd"
    write_comparison_rrd(simulate_gains(), path, size=(700, 450))
    told = read_static(path, entity, "Points2D:labels")
    assert [text.partition(":")[0] for text in told] == ["Kp 7", "Kp 6"]
    assert "Plane (Kp 1 to 25)" in read_layout(path)


@pytest.mark.thorough
def test_seven_runs_have_a_legend_and_no_bar(tmp_path: Path) -> None:
    path = tmp_path / "seven.rrd"
    write_comparison_rrd(simulate_gains()[:7], path)
    assert "Runs" in read_layout(path)
    assert "/legend/bar" not in list_entities(path)


def test_one_that_swings_on_hides_no_other_and_is_named(many_rrd: Path) -> None:
    layout, shown = read_layout(many_rrd), list_entities(many_rrd)
    assert "Turn rate [rad/s], without Kp 25" in layout
    assert "/runs/gain-25/turn_rate/commanded" not in shown
    assert "/runs/gain-7/turn_rate/commanded" in shown
    assert "/runs/gain-25/along_track" in shown
    widths = read_static(many_rrd, "/runs/gain-7/along_track", "SeriesLines:widths")
    assert widths == [1.0]


def test_the_time_that_is_shown_ends_with_the_last_that_comes_to_rest(many_rrd: Path) -> None:
    calm = simulate_gains()[:7]
    last_ns = max(run.end_ns - run.start_ns for run in calm)
    ends = [part["end"] for part in read_blueprint_parts(many_rrd, "TimeAxis:view_range")]
    assert last_ns in ends
    title = next(name for name in read_layout(many_rrd) if name.startswith("Phases"))
    assert title.startswith("Phases of 4 of 8 runs, 21 of 60 s")


@pytest.mark.parametrize(("swings", "expected"), [(10, frozenset()), (11, {1})])
def test_a_run_is_restless_above_ten_swings(swings: int, expected: set[int]) -> None:
    run = simulate_preset("paper-kp10")
    speed = np.zeros(len(run.samples))
    speed[-swings - 1 :] = np.resize([1.0, -1.0], swings + 1)
    samples = replace(run.samples, speed_m_s=speed, turn_rate_rad_s=np.zeros(len(speed)))
    swinging = replace(run, samples=samples, stop_reason="timeout")
    assert find_restless([run, swinging]) == expected
    assert find_restless([run, replace(swinging, stop_reason="standstill")]) == frozenset()
    assert find_restless([swinging, swinging]) == frozenset()
    assert find_restless([run, swinging, swinging]) == frozenset()
    assert find_restless([run, replace(swinging, stop_reason="path_end")]) == frozenset()


def repeat_gains(counts: dict[float, int]) -> list[Run]:
    run = simulate_preset("paper-kp1")
    runs = [set_gain(run, kp) for kp, count in counts.items() for _ in range(count)]
    return [
        replace(run, parameters={**run.parameters, "seed": seed}) for seed, run in enumerate(runs)
    ]


def test_many_runs_of_one_gain_share_its_colour_and_its_tick() -> None:
    runs = repeat_gains({1.0: 6, 4.0: 2, 10.0: 4})
    one, two, three = FEW[:3]
    assert choose_colors_by_value(runs) == (*[one] * 6, *[two] * 2, *[three] * 4)
    scale = find_color_scale(runs)
    assert scale is not None
    assert scale.list_ticks(12) == [(2.5, "1"), (6.5, "4"), (9.5, "10")]
    assert scale.list_ticks(2) == [(2.5, "1"), (9.5, "10")]
    assert join_run_names([0, 3, 11], "abcdefghijkl", scale) == "2 of Kp 1, 1 of Kp 10"
    assert choose_colors_by_value(runs[:7]) == FEW


def test_equal_runs_are_drawn_once_and_said_to_be_equal(tmp_path: Path) -> None:
    run, other = simulate_preset("paper-kp1"), simulate_preset("paper-kp4")
    again = replace(run, name="again")
    assert group_equal([run, other, again]) == [[0, 2], [1]]
    nearly = replace(again, poses=replace(run.poses, xy_m=run.poses.xy_m + 1e-12))
    assert group_equal([run, nearly]) == [[0], [1]]
    path = tmp_path / "equal.rrd"
    write_comparison_rrd([run, again, other], path)
    (name,) = read_static(
        path, "/runs/again_and_paper-kp1_are_equal/along_track", "SeriesLines:names"
    )
    assert name == "again and paper-kp1 are equal"
    assert "Plane (again and paper-kp1 are equal)" in read_layout(path)
    write_comparison_rrd([run, again, other], path, size=(700, 450))
    assert "Plane (equal runs)" in read_layout(path)
    (text,) = (
        read_static(path, "/documents/Side%20by%20side", "TextDocument:text")
        if ("/documents/Side%20by%20side" in list_entities(path))
        else read_static(path, r"/documents/Side\ by\ side", "TextDocument:text")
    )
    assert "again" in text
    assert "paper-kp1" in text


def test_long_names_become_what_differs() -> None:
    run = simulate_preset("paper-kp4")
    long = "x" * LONGEST_NAME
    limits = set_gain(run, 4.0, **{"limits.speed_m_s": 1e9})
    delayed = set_gain(run, 8.0, **{"loop.transport_delay_ticks": 3})
    assert shorten_run_names([run, limits], [f"{long}-a", f"{long}-b"]) == (
        "speed limit 1",
        "no speed limit",
    )
    assert shorten_run_names([run, delayed], ["a", f"{long}b"]) == (
        "Kp 4, delay 0 ticks",
        "Kp 8, delay 3 ticks",
    )
    assert shorten_run_names([run, limits], ["a", long]) == ("a", long)
    fast = set_gain(run, 4.0, **{"limits.speed_m_s": 0.99e9})
    assert shorten_run_names([run, fast], [f"{long}-a", f"{long}-b"])[1] == "speed limit 9.9e+08"
    keys = (
        "loop.transport_delay_ticks",
        "law.pause_ticks",
        "loop.pose_queue",
        "loop.start_backlog",
    )
    for count in (3, 4):
        other = set_gain(run, 4.0, **dict.fromkeys(keys[:count], 3))
        names = shorten_run_names([run, other], [f"{long}-a", f"{long}-b"])
        assert names[1].count(",") == (2 if count == 3 else 0)
    assert shorten_run_names([run, run], [f"{long}-a-z", f"{long}-b-z"]) == ("a", "b")


def test_no_limit_is_said_of_limits_alone() -> None:
    run = replace(set_gain(simulate_preset("paper-kp4"), 4.0), scenario_is_complete=True)
    names = [f"{'x' * LONGEST_NAME}-a", f"{'x' * LONGEST_NAME}-b"]
    seeds = [
        replace(run, parameters={**run.parameters, "seed": seed}) for seed in (3, 2_000_000_000)
    ]
    assert shorten_run_names(seeds, names) == ("seed 3", "seed 2000000000")
    endless = set_gain(run, 4.0, **{"limits.speed_m_s": math.inf})
    assert shorten_run_names([run, endless], names) == ("speed limit 1", "no speed limit")


@pytest.mark.parametrize(
    ("is_complete", "told"), [(True, "no jitter s"), (False, "jitter s unknown")]
)
def test_what_a_recording_does_not_hold_is_unknown(*, is_complete: bool, told: str) -> None:
    run = replace(simulate_preset("paper-kp4"), scenario_is_complete=is_complete)
    shaken = replace(run, parameters={**run.parameters, "loop.jitter_s": 0.02})
    names = [f"{'x' * LONGEST_NAME}-a", f"{'x' * LONGEST_NAME}-b"]
    assert shorten_run_names([shaken, run], names) == ("jitter s 0.02", told)


def test_names_lose_the_words_that_all_of_them_share_and_keep_their_numbers() -> None:
    assert cut_alike(["paper-kp1", "paper-kp10"]) == ("kp1", "kp10")
    assert cut_alike(["one"]) == ("one",)
    assert cut_alike(["left", "right"]) == ("left", "right")
    assert cut_alike(["a law.kp=1.5", "a law.kp=1.6"]) == ("law.kp=1.5", "law.kp=1.6")
    assert cut_alike(["a x=-1", "a x=-2"]) == ("x=-1", "x=-2")


def end_at(run: Run, number: int, x_m: float, y_m: float) -> Run:
    xy_m = np.array(run.poses.xy_m)
    xy_m[-1] = x_m, y_m
    return set_gain(replace(run, poses=replace(run.poses, xy_m=xy_m)), 1.0 + number)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("ends", "named"),
    [
        ([(2.0, 8.84)], None),  # 1.175 m are a fifth of half the plane
        ([(2.0, 8.81)], ["Kp 8"]),
        ([(9.0, 10.0), (9.0, 8.84)], ["Kp 8"]),
        ([(9.0, 10.0), (9.0, 8.81)], ["Kp 8", "Kp 7"]),
        ([(6.0, 10.0), (7.0, 2.0), (10.0, 2.0), (10.0, 10.0)], ["Kp 7", "Kp 6", "Kp 8"]),
    ],
)
def test_three_runs_that_end_far_from_goal_and_each_other_are_named_in_the_plane(
    ends: list[tuple[float, float]], named: list[str] | None, tmp_path: Path
) -> None:
    run, path = simulate_preset("paper-kp4"), tmp_path / "far.rrd"
    near = [(2.0, 10.0 + 1e-3 * number) for number in range(8 - len(ends))]
    runs = [end_at(run, number, *place) for number, place in enumerate([*near, *ends])]
    write_comparison_rrd(runs, path)
    entity = "/plane/names/extremes"
    if named is None:
        assert entity not in list_entities(path)
    else:
        assert read_static(path, entity, "Points2D:labels") == named


@pytest.mark.thorough
@pytest.mark.parametrize(("count", "told"), [(2, "a, b"), (3, "a, b and 1 more")])
def test_titles_name_two_runs_that_never_rest(count: int, told: str, tmp_path: Path) -> None:
    calm, swinging = simulate_gains()[0], simulate_gains()[-1]
    shifted = [
        replace(calm, poses=replace(calm.poses, xy_m=calm.poses.xy_m + 1e-3 * step))
        for step in range(8)
    ]
    restless = [
        replace(swinging, poses=replace(swinging.poses, xy_m=swinging.poses.xy_m + 1e-3 * step))
        for step in range(count)
    ]
    runs = [replace(run, name="abc"[step], parameters={}) for step, run in enumerate(restless)]
    runs += [replace(run, name=f"z{step}", parameters={}) for step, run in enumerate(shifted)]
    path = tmp_path / "named.rrd"
    write_comparison_rrd(runs, path)
    assert f"Turn rate [rad/s], without {told}" in read_layout(path)


@pytest.mark.parametrize(("letters", "columns"), [(5, 4), (12, 4), (13, 3), (49, 1)])
def test_names_in_a_legend_stand_in_as_many_columns_as_have_room(
    letters: int, columns: int
) -> None:
    for count in (8, 100):
        names = ["x" * letters] * count
        bounds: Any = view_legend(names).properties["VisualBounds2D"]
        ranges = bounds.range.as_arrow_array().to_pylist()[0]
        (left, right), (top, bottom) = ranges.values()
        places = arrange_names(len(choose_names(names)), columns)
        assert len({*places[:, 0].tolist()}) == columns
        assert left < places[:, 0].min() <= places[:, 0].max() < right
        assert top < 0.0 <= places[:, 1].max() < bottom <= 7.0
        # The view keeps the ratio of the picture, which must not be narrower than the view.
        assert right - left >= 2.6 * (bottom - top)


def test_many_runs_that_differ_in_a_few_numbers_show_one_that_is_in_their_order() -> None:
    run = simulate_preset("paper-kp4")

    def sweep(**more: float) -> list[Run]:
        return [
            replace(
                run,
                parameters={
                    **run.parameters,
                    "law.kp_linear": 1.0 + number // 4,
                    "law.kp_angular": 1.0 + number % 4,
                    **more,
                    "seed": number,
                },
            )
            for number in range(8)
        ]

    scale = find_color_scale(sweep())
    assert scale is not None
    assert (scale.word, scale.unit, scale.values) == ("kp_linear", "1/s", (*[1.0] * 4, *[2.0] * 4))
    assert find_color_scale(sweep()[::-1]) is None
    paused = [
        set_gain(run, 4.0, **{KEYS[1]: 4.0 + number, "law.pause_ticks": 3 + number // 4, "seed": 1})
        for number in range(8)
    ]
    finest = find_color_scale(paused)
    assert finest is not None
    assert finest.word == "kp_linear"
    third, fourth = (
        {f"start.{name}": float(number) for name in names}
        for number, names in enumerate((["x_m"], ["x_m", "y_m"]), 1)
    )
    assert find_color_scale([*sweep()[:4], *sweep(**third)[4:]]) is not None
    assert find_color_scale([*sweep()[:4], *sweep(**fourth)[4:]]) is None


def test_a_scale_needs_one_number_that_differs() -> None:
    run = simulate_preset("paper-kp4")
    scale = find_gain_scale([run, set_gain(run, 8.0)])
    assert scale is not None
    assert (scale.word, scale.values) == ("Kp", (4.0, 8.0))
    assert find_gain_scale([run, replace(run, name="other")]) is None
    paused = set_gain(run, 8.0, **{"law.pause_ticks": 3})
    assert find_gain_scale([run, paused]) == scale
    slow = set_gain(run, 4.0, **{"limits.speed_m_s": 0.5, "law.pause_ticks": 3})
    assert find_gain_scale([run, slow]) is None
