from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.sweep.swept_tables import write_table
from turtlelog.errors import LogError, SweepError
from turtlelog.scenario import flatten_scenario
from turtlelog.sweep import (
    Sampling,
    build_plan,
    choose_view,
    count_rivals,
    fill_cells,
    find_best_rows,
    list_shown_values,
    load_row_scenario,
    read_swept_results,
    require_values,
)
from turtlelog.sweep.result_table import list_row_numbers

KP, DELAY, SEED = "law.kp_linear", "loop.transport_delay_ticks", "seed"
GAINS = ("law.kp_linear", "law.kp_angular")


def test_cells_hold_the_values_of_their_rows(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet",
        [f"{DELAY}=0:2", f"{KP}=1,2,4,8"],
        {"translate.overshoot": lambda delay, kp: 10.0 * delay + kp if kp < 8 else "too_short"},
    )
    results = read_swept_results(path)
    view = choose_view(results, gains=GAINS)
    assert (view.x.keys, view.axes[1].keys) == ((DELAY,), (KP,))
    cells = fill_cells(view, results.metrics[0])
    assert cells.values[:3].tolist() == [[1, 11, 21], [2, 12, 22], [4, 14, 24]]
    assert np.isnan(cells.values[3]).all()
    assert set(cells.reasons.values()) == {"too short"}
    assert view.find_first_rows()[2].tolist() == [2, 6, 10]


def test_a_gain_stands_at_the_side_whichever_key_comes_first(tmp_path: Path) -> None:
    plan = [f"{KP}=1:3", f"{DELAY}=0:2"]
    results = read_swept_results(write_table(tmp_path / "t.parquet", plan, {"run.duration": min}))
    assert choose_view(results, gains=GAINS).x.keys == (DELAY,)
    turned = choose_view(results, gains=GAINS, x=KP)
    assert [axis.keys for axis in turned.axes] == [(KP,), (DELAY,)]


def test_other_keys_are_held_at_the_base_else_in_the_middle(tmp_path: Path) -> None:
    plan = [f"{DELAY}=0:2", f"{KP}=4:8", "goal.x_m=1,2,3", "goal.y_m=5,6,7"]
    path = write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda *values: sum(values)})
    results = read_swept_results(path)
    view = choose_view(results, gains=GAINS)
    # The textbook's goal is (2, 10): x is in the table, y is not.
    assert view.tell_held() == "goal.x_m = 2, goal.y_m = 6"
    assert [note.partition(")")[0] for note in view.notes] == [
        "goal.x_m = 2 (as in the base",
        "goal.y_m = 6 (the middle of its values",
    ]
    held = choose_view(results, gains=GAINS, at={"goal.x_m": 3, "goal.y_m": 5})
    assert held.tell_held() == "goal.x_m = 3, goal.y_m = 5"
    assert fill_cells(held, results.metrics[0]).values[0, 0] == 0 + 4 + 3 + 5


def test_values_over_seeds_are_means_of_those_that_have_one(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=1:2", f"{SEED}=0:3"],
        {"run.duration": lambda kp, seed: 10.0 * kp + seed if seed < 3 else "too_short"},
    )
    results = read_swept_results(path)
    view = choose_view(results)
    cells = fill_cells(view, results.metrics[0])
    assert (view.y, view.seeds) == (None, 4)
    assert cells.values.tolist() == [[11.0, 21.0]]
    assert (cells.least.tolist(), cells.most.tolist()) == ([[10.0, 20.0]], [[12.0, 22.0]])
    assert cells.counts.tolist() == [[3, 3]]


def test_words_and_infinite_values_are_places_side_by_side(tmp_path: Path) -> None:
    plan = ["limits.speed_m_s=1,2,inf", "law.projection=bearing,heading"]
    results = read_swept_results(
        write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda *_: 1.0})
    )
    for axis, count in zip(results.axes, (3, 2), strict=True):
        assert not axis.is_number
        assert axis.numbers.tolist() == list(range(count))


def test_zipped_keys_are_one_axis(tmp_path: Path) -> None:
    plan = build_plan([f"{KP}=1:2"], ["goal.x_m=8,2", "goal.y_m=3,10"])
    results = read_swept_results(
        write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda *_: 1.0})
    )
    goal = results.axes[1]
    assert goal.values == ((2.0, 10.0), (8.0, 3.0))
    assert goal.numbers.tolist() == [2.0, 8.0]
    view = choose_view(results, at={"goal.x_m": 8, "goal.y_m": 3})
    assert view.tell_held() == "goal.x_m = 8, goal.y_m = 3"
    with pytest.raises(SweepError, match="no row has these values"):
        choose_view(results, at={"goal.x_m": 8, "goal.y_m": 10})


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ({"at": {"law.kp_angular": 1}}, "--at: expected a key that varies"),
        ({"at": {KP: 1.5}}, "--at: expected a value of law.kp_linear, as 1 or 2 or 3, found 1.5"),
        ({"x": KP, "y": KP}, "--y: expected another key than --x"),
        ({"x": KP, "at": {KP: 1}}, "--x: expected a key that --at does not hold"),
        ({"y": "name"}, "--y: expected a key that varies"),
    ],
)
def test_keys_that_the_table_does_not_have_are_refused(
    words: dict[str, object], expected: str, tmp_path: Path
) -> None:
    plan = [f"{KP}=1:3", f"{DELAY}=0:2"]
    results = read_swept_results(write_table(tmp_path / "t.parquet", plan, {"run.duration": min}))
    with pytest.raises(SweepError, match=expected.replace("(", "[(]")):
        choose_view(results, **words)  # type: ignore[arg-type]


def test_best_rows_are_those_of_the_direction_and_the_floor(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=1:4"],
        {
            "translate.overshoot": lambda kp: (-5.0, -0.1, 3.0, 9.0)[int(kp) - 1],
            "run.duration": lambda kp: 10.0 - kp,
            "translate.peak": lambda kp: kp,
        },
    )
    results = read_swept_results(path)
    view = choose_view(results)
    found = {one.name: find_best_rows(view, one) for one in results.metrics}
    assert found["translate.overshoot"] == [0, 1]
    assert found["run.duration"] == [3]


def test_over_seeds_the_best_is_the_best_mean(tmp_path: Path) -> None:
    """A gain of 1 has the best single run, one of 3 the best mean of those that arrive."""
    durations = {1: (1.0, 21.0), 2: (9.0, 9.0), 3: (5.0, None)}
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=1:3", f"{SEED}=0:1"],
        {"run.duration": lambda kp, seed: durations[int(kp)][seed] or "too_short"},
    )
    results = read_swept_results(path)
    view = choose_view(results)
    assert find_best_rows(view, results.metrics[0]) == [2]
    rows, values = list_shown_values(view, results.metrics[0])
    assert (rows.tolist(), values.tolist()) == ([0, 2, 4], [11.0, 9.0, 5.0])


@pytest.mark.parametrize(
    ("better", "within", "is_open"), [(0.99, 1, False), (1.01, 2, True)], ids=["clear", "chance"]
)
def test_a_mean_is_best_if_chance_does_not_explain_its_distance(
    *, better: float, within: int, is_open: bool, tmp_path: Path
) -> None:
    """Of 2 others, each has an error of 2.5 %: Student's t of 3 degrees of freedom is 3.182."""
    noise = (-1.0, -1.0, 1.0, 1.0)  # standard deviation 1.1547, standard error 0.57735
    means = {1: 0.0, 2: 0.1, 3: 3.182 * 0.57735 / better}
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=1:3", f"{SEED}=0:3"],
        {"run.duration": lambda kp, seed: 9.0 + means[int(kp)] + (noise[seed] if kp > 1 else 0.0)},
    )
    results = read_swept_results(path)
    found = count_rivals(choose_view(results), results.metrics[0])
    assert found is not None
    assert (found.within_chance, found.others, found.is_open) == (within, 2, is_open)


def test_without_noise_every_difference_counts(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=1:3", f"{SEED}=0:1"],
        {"run.duration": lambda kp, _: max(kp, 2.0)},
    )
    results = read_swept_results(path)
    assert count_rivals(choose_view(results), results.metrics[0]) == (0, 1)
    alone = choose_view(results, at={SEED: 0})
    assert count_rivals(alone, results.metrics[0]) is None


def test_seeds_that_were_drawn_are_no_repetitions(tmp_path: Path) -> None:
    plan = build_plan([f"{KP}=1.0:3.0", f"{SEED}=0:99"], (), Sampling(count=9))
    path = write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda kp, _: kp})
    assert choose_view(read_swept_results(path)).seeds == 1


def test_a_view_without_any_value_is_refused_with_the_reason(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet", [f"{KP}=1:2"], {"run.duration": lambda _: "too_short"}
    )
    with pytest.raises(SweepError, match=r"value of run.duration, found too short"):
        require_values(choose_view(read_swept_results(path)))


@pytest.mark.parametrize(("value", "is_drawn"), [(1e150, True), (1.001e150, False)])
def test_values_that_overflow_have_no_place(
    *, value: float, is_drawn: bool, tmp_path: Path
) -> None:
    path = write_table(
        tmp_path / "t.parquet", [f"{KP}=1:2"], {"run.duration": lambda kp: value * (kp - 1)}
    )
    (metric,) = read_swept_results(path).metrics
    assert np.isfinite(metric.values).tolist() == [True, is_drawn]
    assert metric.reasons[1] == (None if is_drawn else "beyond 1e150")


def test_metrics_that_vary_come_first_and_at_most_four_unasked(tmp_path: Path) -> None:
    names = ("run.duration", "rotate.overshoot", "translate.overshoot", "translate.stable")
    more = ("final.position_error", "translate.peak")
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=1:3"],
        {name: (lambda _: 1.0) if name.startswith("rotate") else float for name in (*names, *more)},
    )
    found = [metric.name for metric in read_swept_results(path).metrics]
    assert found == [
        "translate.stable",
        "translate.overshoot",
        "final.position_error",
        "run.duration",
    ]
    asked = read_swept_results(path, ["rotate.*"])
    assert [metric.name for metric in asked.metrics] == ["rotate.overshoot"]
    with pytest.raises(
        SweepError, match=r't\.parquet: no metric "nope"; there are run\.duration, .*'
    ):
        read_swept_results(path, ["nope"])


def test_rows_of_a_sample_are_all_shown(tmp_path: Path) -> None:
    plan = build_plan(
        [f"{KP}=1.0:3.0", "law.kp_angular=1.0:3.0", "goal.x_m=1.0:3.0"], (), Sampling(count=9)
    )
    results = read_swept_results(
        write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda *_: 1.0})
    )
    view = choose_view(results, gains=GAINS)
    assert results.is_sampled
    assert (len(view.rows), dict(view.held)) == (9, {})


def test_rows_keep_their_numbers_in_a_table_that_was_filtered(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet", [f"{KP}=1:9"], {"run.duration": lambda kp: abs(kp - 7)}
    )
    table = pq.read_table(path)
    pq.write_table(table.slice(3, 5), path)
    results = read_swept_results(path)
    (best,) = find_best_rows(choose_view(results), results.metrics[0])
    number = results.row_numbers[best]
    assert (best, number) == (3, 6)
    assert results.build_scenario(best) == load_row_scenario(path, number)
    assert flatten_scenario(load_row_scenario(path, number))[KP] == 7
    for none in (2, 8):
        with pytest.raises(SweepError, match=f"expected a row from 3 to 7, found {none}"):
            load_row_scenario(path, none)


@pytest.mark.parametrize("cells", [None, [4, 4], ["4", "5"], [4, None]])
def test_rows_that_no_number_tells_apart_are_counted(cells: list[object] | None) -> None:
    assert list(list_row_numbers(cells, 2)) == [0, 1]


def test_a_plan_that_nests_too_deeply_is_no_plan(tmp_path: Path) -> None:
    facts = {"kind": "sweep", "format": "1", "version": "0", "base": "", "plan": "[" * 100_000}
    named = {f"turtlelog.{name}": text for name, text in facts.items()}
    table = pa.table({"row": [0]}).replace_schema_metadata(named)
    pq.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(LogError, match="not a table of turtlelog sweep"):
        read_swept_results(tmp_path / "a.parquet")
