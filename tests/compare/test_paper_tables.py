import dataclasses
from typing import Any

import pytest

import turtlelog as tl

RUNS = [tl.simulate_run(tl.load_scenario(name)) for name in reversed(tl.scenario.PAPER_RUNS)]


def test_table_1_has_a_row_per_gain_in_rising_order() -> None:
    table = tl.compare.tabulate_table1(RUNS)
    assert [row[1] for row in table.rows] == [1.0, 2.0, 4.0, 10.0]
    assert [row[2] for row in table.rows] == pytest.approx([1.0, 0.5, 0.25, 0.1])
    assert [row[3] for row in table.rows] == pytest.approx([4.0, 2.0, 1.0, 0.4])


def test_table_1_stands_beside_the_papers_figures() -> None:
    text = tl.draw.format_table(tl.compare.tabulate_table1(RUNS, beside_paper=True))
    assert "0.0253  0.0253  0.082518  0.081545" in text
    assert "1.0739  1.0739  0.106728  0.106728" in text
    assert "0.0825 m is not 0.0815 m because" in text


def test_a_gain_that_the_paper_did_not_run_has_no_figure_beside_it() -> None:
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("paper"), {"law.kp_linear": 3.0}))
    row = tl.compare.tabulate_table1([run], beside_paper=True).rows[0]
    assert (row[1], row[5], row[7]) == (None, None, None)


def test_whole_runs_show_measured_settling_times_beside_four_time_constants() -> None:
    table = tl.compare.tabulate_whole_runs(RUNS)
    titles = [column.title for column in table.columns]
    settled = [row[titles.index("ts rotate")] for row in table.rows]
    assert settled == pytest.approx([4.0808, 2.7821, 2.2766, 2.2139], abs=1e-4)


def test_the_table_of_metrics_says_why_a_value_is_missing() -> None:
    scenario = tl.override_scenario(tl.load_scenario("paper-kp1"), {"max_duration_s": 2.0})
    table = tl.compare.tabulate_metrics([tl.simulate_run(scenario)])
    cells = {row[0]: row[2] for row in table.rows}
    assert cells["rotate.settling_time"] == "not_reached"
    assert cells["translate.duration"] == "no_phase"


def test_runs_of_one_name_are_told_apart() -> None:
    assert tl.compare.name_runs([RUNS[0], RUNS[1], RUNS[0]]) == (
        "paper-kp10 (1)",
        "paper-kp4",
        "paper-kp10 (2)",
    )


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ([{"law.kp_angular": 2.0, "law.kp_linear": 2.0}, {}], ("paper-kp4 Kp 2", "paper-kp4 Kp 4")),
        ([{"law.kp_linear": 2.5}, {}], ("paper-kp4 kp_linear 2.5", "paper-kp4 kp_linear 4")),
        (
            [{"goal.x_m": 3.0, "start.x_m": 4.0}, {}],
            ("paper-kp4 goal.x_m 3 start.x_m 4", "paper-kp4 goal.x_m 2 start.x_m 5.54444"),
        ),
        (
            [{"loop.queue_policy": "newest"}, {}, {}],
            (
                "paper-kp4 queue_policy newest",
                "paper-kp4 queue_policy one-per-tick (1)",
                "paper-kp4 queue_policy one-per-tick (2)",
            ),
        ),
    ],
)
def test_runs_of_one_name_are_told_apart_by_the_parameters_that_differ(
    changes: list[dict[str, Any]], names: tuple[str, ...]
) -> None:
    paper = tl.load_scenario("paper-kp4")
    runs = [tl.simulate_run(tl.override_scenario(paper, change)) for change in changes]
    assert tl.compare.name_runs(runs) == names


def test_where_many_parameters_differ_runs_of_one_name_are_numbered() -> None:
    textbook = dataclasses.replace(tl.simulate_run(tl.load_scenario("textbook")), name="paper-kp10")
    assert tl.compare.name_runs([RUNS[0], textbook]) == ("paper-kp10 (1)", "paper-kp10 (2)")


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["a.mcap", "runs/b.mcap"], ("a.mcap", "b.mcap")),
        (["1/a.mcap", "2/a.mcap"], ("1/a.mcap", "2/a.mcap")),
        (["a.mcap", "a.mcap"], ("a.mcap (1)", "a.mcap (2)")),
        (["a.mcap", ""], ("paper-kp10 Kp 10", "paper-kp10 Kp 4")),
    ],
)
def test_runs_of_one_name_are_called_by_their_files(
    files: list[str], names: tuple[str, ...]
) -> None:
    slower = {**RUNS[0].parameters, "law.kp_angular": 4.0, "law.kp_linear": 4.0}
    runs = [RUNS[0], dataclasses.replace(RUNS[0], parameters=slower)]
    summaries = [
        tl.summarise_run(run, file=file, metrics={}) for run, file in zip(runs, files, strict=True)
    ]
    other = tl.summarise_run(RUNS[2], file="c.mcap", metrics={})
    assert tl.compare.name_runs([*summaries, other]) == (*names, "paper-kp2")


def test_a_numbered_name_that_is_taken_is_not_given_twice() -> None:
    runs = [dataclasses.replace(RUNS[0], name=name) for name in ("a", "a (1)", "a")]
    assert tl.compare.name_runs(runs) == ("a (2)", "a (1)", "a (3)")


def test_the_table_of_metrics_gives_every_reason_once() -> None:
    scenario = tl.override_scenario(tl.load_scenario("paper-kp1"), {"max_duration_s": 2.0})
    notes = tl.compare.tabulate_metrics([tl.simulate_run(scenario)] * 2).notes
    assert "no phase: the run has no phase translate." in notes
    assert len(set(notes)) == len(notes)


def lack(name: str, reason: str) -> tl.Metric:
    status = tl.measure.Status.UNDETERMINED
    return tl.Metric(id=name, value=None, unit="s", status=status, reason=reason)


def test_reasons_of_one_status_name_their_metrics() -> None:
    measured = {"a": lack("a", "few poses"), "b": lack("b", "few poses")}
    assert tl.compare.list_reasons([measured] * 2) == ("undetermined: few poses.",)
    assert tl.compare.list_reasons([{**measured, "c": lack("c", "a gap")}]) == (
        "undetermined (a and b): few poses.",
        "undetermined (c): a gap.",
    )


@pytest.mark.parametrize(("count", "named"), [(4, "d"), (5, "2 more")])
def test_a_reason_names_at_most_four_metrics(count: int, named: str) -> None:
    measured = {name: lack(name, "few poses") for name in "abcde"[:count]}
    notes = tl.compare.list_reasons([{**measured, "z": lack("z", "a gap")}])
    assert notes[0] == f"undetermined (a, b, c and {named}): few poses."


def test_the_table_of_differences_names_the_reference_and_every_run() -> None:
    comparisons = [tl.compare_runs(RUNS[0], run) for run in RUNS[1:]]
    names = [run.name for run in RUNS[1:]]
    table = tl.compare.tabulate_differences(comparisons, names=names, reference="paper-kp10")
    assert "from paper-kp10" in table.title
    assert [column.title for column in table.columns[2::2]] == names
    assert {row[0] for row in table.rows} == {
        name for name in tl.SIGNALS if not name.startswith(("sensed_", "shaped_", "measured_"))
    }
