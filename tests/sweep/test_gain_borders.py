from functools import cache
from pathlib import Path

import pytest

from tests.sweep.swept_tables import write_table
from turtlelog.sweep import (
    SweptView,
    choose_view,
    find_borders,
    find_loop_limits,
    list_gain_keys,
    read_swept_results,
    tell_borders,
)
from turtlelog.theory import analyse_sampled_loop, compute_overshoot_gain, compute_stability_gain

KP, DELAY = "law.kp_linear", "loop.transport_delay_ticks"
GRID = (f"{DELAY}=0:12:3", f"{KP}=2:24:2")
PERIOD_S = 0.016


@cache
def is_stable(delay: int, kp: float) -> float:
    return float(analyse_sampled_loop(kp, period_s=PERIOD_S, dead_time_ticks=delay).stable)


def view_table(path: Path) -> SweptView:
    results = read_swept_results(path)
    return choose_view(results, gains=list_gain_keys(results))


def test_each_column_has_the_limits_of_its_own_scenario(tmp_path: Path) -> None:
    view = view_table(write_table(tmp_path / "t.parquet", GRID, {"translate.stable": is_stable}))
    (found,) = find_loop_limits(view)
    assert (found.loop, found.gain, found.notes) == ("translate", view.y, ())
    for delay, column in zip(range(0, 13, 3), found.columns, strict=True):
        assert column is not None
        settings = {"period_s": PERIOD_S, "dead_time_ticks": delay}
        assert column.stability == pytest.approx(compute_stability_gain(**settings))  # type: ignore[arg-type]
        assert column.overshoot == pytest.approx(compute_overshoot_gain(**settings))  # type: ignore[arg-type]


def test_borders_of_theory_itself_lie_in_their_cells(tmp_path: Path) -> None:
    view = view_table(write_table(tmp_path / "t.parquet", GRID, {"translate.stable": is_stable}))
    borders = find_borders(view, view.results.metrics[0], find_loop_limits(view))
    assert borders is not None
    assert [border.is_near for border in borders] == [None, None, True, True, True]
    last = borders[-1]
    assert last.theory is not None
    assert last.last_stable is not None
    assert last.first_unstable is not None
    assert last.last_stable <= last.theory <= last.first_unstable
    assert [border.first_unstable for border in borders[:2]] == [None, None]
    assert tell_borders(borders) == (
        "the border lies within one cell of theory's line in 3 of 3 columns; 2 columns have no"
        " border: they are stable at every measured gain, as in theory"
    )


@pytest.mark.parametrize(
    ("gains", "is_stable", "is_near", "said"),
    [
        ("2:14:2", 1.0, None, "it is stable at every measured gain, as in theory"),
        ("2:16:2", 1.0, None, "it is stable at every measured gain"),
        ("2:18:2", 1.0, False, "theory's line in 0 of 1 column"),
        ("16:24:2", 0.0, None, "it is unstable at every measured gain, as in theory"),
        ("14:24:2", 0.0, None, "it is unstable at every measured gain"),
        ("12:24:2", 0.0, False, "theory's line in 0 of 1 column"),
    ],
)
def test_a_column_with_one_verdict_has_no_border(
    *, gains: str, is_stable: float, is_near: bool | None, said: str, tmp_path: Path
) -> None:
    """Theory's limit at 6 ticks is 15.07. A border beyond the grid may be a cell beside it."""
    grid = [f"{DELAY}=6", f"{KP}={gains}"]
    path = write_table(tmp_path / "t.parquet", grid, {"translate.stable": lambda *_: is_stable})
    view = view_table(path)
    borders = find_borders(view, view.results.metrics[0], find_loop_limits(view))
    assert borders is not None
    assert [border.is_near for border in borders] == [is_near]
    assert tell_borders(borders).endswith(said)


@pytest.mark.parametrize(
    ("least", "said"),
    [(1.0, "gain, as in theory"), (0.6, "gain in most seeds"), (0.4, "within one cell")],
)
def test_seeds_that_differ_are_no_verdict_of_theory(
    least: float, said: str, tmp_path: Path
) -> None:
    """Theory's limit at 6 ticks is 15.07; three of five seeds are stable at 14, or two."""

    def judge(_: int, kp: float, seed: int) -> float:
        return 1.0 if kp < 14.0 or seed < 5.0 * least else 0.0

    grid = [f"{DELAY}=6", f"{KP}=2:14:2", "seed=0:4"]
    view = view_table(write_table(tmp_path / "t.parquet", grid, {"translate.stable": judge}))
    borders = find_borders(view, view.results.metrics[0], find_loop_limits(view))
    assert borders is not None
    assert said in tell_borders(borders)
    assert borders[0].is_mixed is (least < 1.0)


@pytest.mark.parametrize(
    ("cells", "is_near"), [(0, True), (1, True), (2, False), (-1, True), (-2, False)]
)
def test_a_border_is_near_up_to_one_cell_beside_theory(
    *,
    cells: int,
    is_near: bool,
    tmp_path: Path,
) -> None:
    """Theory's limit at 6 ticks is 15.07: between 14 and 16."""

    def judge(delay: int, kp: float) -> float:
        return is_stable(delay, kp - 2.0 * cells) if kp > 2.0 * cells else 1.0

    path = write_table(
        tmp_path / "t.parquet", [f"{DELAY}=6,7", f"{KP}=2:30:2"], {"translate.stable": judge}
    )
    view = view_table(path)
    borders = find_borders(view, view.results.metrics[0], find_loop_limits(view))
    assert borders is not None
    assert borders[0].first_unstable == 16.0 + 2.0 * cells
    assert borders[0].is_near is is_near


def test_a_column_that_is_stable_again_has_no_border_near(tmp_path: Path) -> None:
    def judge(delay: int, kp: float) -> float:
        return 1.0 if kp == 24.0 else is_stable(delay, kp)

    view = view_table(write_table(tmp_path / "t.parquet", GRID, {"translate.stable": judge}))
    borders = find_borders(view, view.results.metrics[0], find_loop_limits(view))
    assert borders is not None
    assert [border.is_near for border in borders] == [None, None, False, False, False]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sensing.noise_position_m": 0.01}, "it leaves out sensing.noise_position_m = 0.01"),
        ({"loop.jitter_s": 0.01}, "it leaves out loop.jitter_s = 0.01"),
    ],
)
def test_where_theory_does_not_speak_there_is_no_line_but_a_note(
    changes: dict[str, float], said: str, tmp_path: Path
) -> None:
    path = write_table(
        tmp_path / "t.parquet", GRID, {"translate.stable": is_stable}, changes=changes
    )
    view = view_table(path)
    (found,) = find_loop_limits(view)
    assert set(found.columns) == {None}
    assert len(found.notes) == 1
    assert found.notes[0].endswith(said)
    borders = find_borders(view, view.results.metrics[0], [found])
    assert borders is not None
    assert {border.is_near for border in borders} == {None}


def test_queues_that_grow_have_both_limits(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet", [f"{KP}=2:20:2"], {"run.duration": float}, preset="paper"
    )
    (found,) = find_loop_limits(view_table(path))
    (column,) = found.columns
    assert column is not None
    assert column.grown is not None
    assert column.grown[-1][1] < column.stable[-1][1]
    assert "may let it grow" in found.notes[0]


def test_limits_concern_keys_that_are_gains_alone(tmp_path: Path) -> None:
    view = view_table(
        write_table(tmp_path / "t.parquet", [f"{DELAY}=0:4"], {"run.duration": float})
    )
    assert find_loop_limits(view) == []
