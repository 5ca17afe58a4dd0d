"""Runs of a law that is like none of ours, beside each other and beside ours."""

import dataclasses

import pytest

import turtlelog as tl
from tests.strange_law import simulate_strange
from turtlelog.compare.difference import explain_lack
from turtlelog.compare.run_selection import list_usual_metrics
from turtlelog.errors import CompareError
from turtlelog.run import Run
from turtlelog.run.loops import ControlLoop, Declaration

ONE = simulate_strange()
TWO = simulate_strange(law__gain_b=2.0, name="faster")
PAPER = tl.simulate_run(tl.load_scenario("paper-kp4"))


def read_titles(table: tl.compare.Table) -> list[str]:
    return [column.title for column in table.columns]


def test_tables_have_the_columns_of_the_loops_that_the_runs_have() -> None:
    usual = ("a.rms_error", "final.heading_error", "final.position_error", "run.duration")
    assert list_usual_metrics(ONE.declaration) == usual
    table = tl.tabulate_runs([tl.summarise_run(run) for run in (ONE, TWO)])
    assert read_titles(table) == ["run", "Kp turn", "Kp drive", *usual]
    assert [row[1:3] for row in table.rows] == [(4.0, 1.0), (4.0, 2.0)]
    whole = ["run", "Kp", "4 tau", "ts b", "rms a", "heading", "position", "duration"]
    assert read_titles(tl.compare.tabulate_whole_runs([ONE, TWO])) == whole


def test_beside_another_law_a_cell_of_a_loop_that_a_run_does_not_have_is_empty() -> None:
    summaries = [tl.summarise_run(run) for run in (PAPER, ONE)]
    table = tl.tabulate_runs(summaries)
    cells = [dict(zip(read_titles(table), row, strict=True)) for row in table.rows]
    assert cells[0]["rotate.overshoot"] == PAPER_METRICS["rotate.overshoot"].value
    assert (cells[1]["rotate.overshoot"], cells[0]["a.rms_error"]) == (None, None)
    assert tl.compare.mark_metric(summaries, "rotate.overshoot") == {}
    found = summaries[1].find_metric("rotate.overshoot")
    assert found is not None
    assert (found.status, found.unit) == ("no_phase", "%")


PAPER_METRICS = tl.measure_run(PAPER)


def test_metrics_of_several_laws_stand_loop_by_loop() -> None:
    table = tl.compare.tabulate_metrics([PAPER, ONE], only=["*.rms_error", "run.duration"])
    names = [f"{loop}.rms_error" for loop in ("rotate", "translate", "b", "a")]
    assert [row[0] for row in table.rows] == [*names, "run.duration"]
    assert [row[3] for row in table.rows[:2]] == [None, None]
    assert [row[2] for row in table.rows[2:4]] == [None, None]
    assert table.breaks == (1, 3, 4)


def test_columns_are_chosen_among_those_of_the_runs() -> None:
    summaries = [tl.summarise_run(ONE)]
    assert tl.compare.choose_columns(summaries, ["*.rms_error"]) == ("a.rms_error", "b.rms_error")
    assert tl.compare.choose_columns(summaries, ["rotate.overshoot"]) == ("rotate.overshoot",)
    with pytest.raises(CompareError, match=r'only: .* "a\.rms_eror"; did you mean a\.rms_error'):
        tl.compare.choose_columns(summaries, ["a.rms_eror"])
    with pytest.raises(CompareError, match=r"only: these runs have no metric rotate\.\*"):
        tl.compare.choose_columns(summaries, ["rotate.*"])


def test_a_filter_that_names_a_loop_of_another_law_leaves_its_runs_out_and_says_so() -> None:
    chosen, notes = tl.compare.select_runs(
        [tl.summarise_run(run) for run in (PAPER, ONE)], "b.duration > 0"
    )
    assert [run.name for run in chosen] == ["strange"]
    assert notes == ("paper-kp4 is left out: b.duration is no_phase.",)


def test_a_parameter_that_is_called_like_a_metric_of_another_law_is_the_parameter() -> None:
    run = dataclasses.replace(ONE, parameters={**ONE.parameters, "law.dead_time": 3.0})
    assert tl.summarise_run(run).find_value("law.dead_time") == 3.0


def test_runs_stand_in_the_order_of_the_gains_that_their_laws_declare() -> None:
    slow = simulate_strange(law__gain_a=9.0, law__gain_b=0.5, name="slow")
    assert [run.name for run in tl.compare.order_by_gain([TWO, ONE, slow])] == [
        "slow",
        "strange",
        "faster",
    ]
    again = simulate_strange(law__gain_b=2.0)
    assert tl.compare.name_runs([ONE, again]) == ("strange gain_b 1", "strange gain_b 2")


def test_states_are_signals_where_both_runs_have_them() -> None:
    largest = {found.signal: found.largest for found in tl.compare_runs(ONE, TWO).signals}
    assert largest["memory"] > 1.0


def test_runs_are_brought_together_at_any_phase_that_both_have() -> None:
    assert tl.compare_runs(ONE, TWO, alignment="phase:two").overlap_from_s == 0.0
    with pytest.raises(
        CompareError, match=r"paper-kp4: expected a phase two .*, found rotate, pause"
    ):
        tl.compare_runs(PAPER, ONE, alignment="phase:two")
    with pytest.raises(CompareError, match=r"alignment: expected phase:two.*, found 'phase:tow'"):
        tl.compare_runs(ONE, TWO, alignment="phase:tow")


def test_metrics_of_both_laws_are_paired() -> None:
    pairs = {pair.metric.id: pair for pair in tl.compare_runs(PAPER, ONE).metrics}
    assert pairs["rotate.overshoot"].metric.status == "no_phase"
    assert pairs["a.rms_error"].reference.status == "no_phase"


def swap_signals(run: Run) -> Run:
    """Return the run with a loop `b` that turns the heading to the goal."""
    loop = ControlLoop(name="b", signal="heading", command="speed", reference="goal_bearing")
    declared = Declaration(
        loops=(run.declaration.loops[0], loop),
        phases=run.declaration.phases,
        states=run.declaration.states,
    )
    return dataclasses.replace(run, declaration=declared, name="swapped")


def test_metrics_of_one_id_and_two_units_are_not_compared() -> None:
    other = swap_signals(ONE)
    comparison = tl.compare_runs(ONE, other)
    ids = {pair.metric.id for pair in comparison.metrics}
    assert ("b.rms_error" in ids, "b.duration" in ids) == (False, True)
    assert any("The loop b controls another signal" in note for note in comparison.notes)
    summaries = [tl.summarise_run(run) for run in (ONE, other)]
    table = tl.tabulate_runs(summaries, only=["b.rms_error", "b.duration"])
    assert [str(row[-2]).rpartition(" ")[2] for row in table.rows] == ["m", "deg"]
    assert "b.rms_error is not compared" in " ".join(table.notes)
    assert tl.compare.mark_metric(summaries, "b.rms_error") == {}


def declare(run: Run, *loops: ControlLoop) -> Run:
    """Return the run as of a law with other loops, that all act in both of its phases."""
    names = tuple(loop.name for loop in loops)
    declared = Declaration(loops=loops, phases={"one": names, "two": names}, states=("memory",))
    return dataclasses.replace(run, declaration=declared)


TURNING = ControlLoop(
    name="align", signal="heading", command="turn_rate", reference="bearing_now", gain="law.gain_a"
)
CROSSING = ControlLoop(
    name="cross", signal="cross_track", command="turn_rate", reference="zero", gain="law.gain_b"
)


def test_table_1_has_theorys_columns_where_they_hold_for_a_loop() -> None:
    theory = ["Kp", "tau", "4 tau"]
    assert read_titles(tl.compare.tabulate_table1([declare(ONE, TURNING)]))[1:4] == theory
    with_integral = dataclasses.replace(TURNING, is_proportional=False)
    for loops in ((), (CROSSING,), (with_integral,)):
        titles = read_titles(tl.compare.tabulate_table1([declare(ONE, *loops)]))
        assert titles == ["run", "heading", "position"]
    (row,) = tl.compare.tabulate_table1([declare(ONE, TURNING)]).rows
    assert row[1:4] == (4.0, 0.25, 1.0)


def test_several_loops_that_turn_have_an_overshoot_and_a_gain_each() -> None:
    run = declare(ONE, TURNING, CROSSING)
    titles = ["ts align", "ts cross", "overshoot align", "overshoot cross"]
    assert read_titles(tl.compare.tabulate_whole_runs([run]))[3:7] == titles
    columns = tl.tabulate_runs([tl.summarise_run(run)]).columns[1:3]
    found = [(column.title, column.unit) for column in columns]
    assert found == [("Kp align", "1/s"), ("Kp cross", "rad/(m s)")]
    one = declare(ONE, CROSSING)
    column = tl.tabulate_runs([tl.summarise_run(one)]).columns[1]
    assert (column.title, column.unit) == ("Kp", "rad/(m s)")


def test_a_law_without_loops_has_no_columns_of_any() -> None:
    run = declare(ONE)
    ends = ("final.heading_error", "final.position_error", "run.duration")
    assert list_usual_metrics(run.declaration) == ends
    assert read_titles(tl.tabulate_runs([tl.summarise_run(run)]))[:2] == [
        "run",
        "final.heading_error",
    ]
    titles = read_titles(tl.compare.tabulate_whole_runs([run]))
    assert titles == ["run", "heading", "position", "duration"]


def test_track_of_a_path_is_not_compared_with_that_of_another_or_of_a_line() -> None:
    base = tl.override_scenario(tl.load_scenario("track-square"), {"max_duration_s": 3.0})
    square, slower, other, line = (
        tl.simulate_run(tl.override_scenario(base, changes))
        for changes in (
            {},
            {"path.speed_m_s": 0.4},
            {"path.points": [[3.0, 3.0], [8.0, 3.0], [8.0, 7.0]]},
            {"law.kind": "sequential-p"},
        )
    )
    for run, are_compared in ((slower, True), (other, False), (line, False)):
        found = tl.compare_runs(square, run)
        names = {signal.signal for signal in found.signals}
        assert ({"along_track", "cross_track"} <= names) is are_compared
        assert {"x", "y", "heading"} <= names
        note = "Along-track and cross-track are not compared: the laws do not track one path."
        assert (note in found.notes) is not are_compared
    assert explain_lack("along_track", square, line) == "the laws do not track one path"
