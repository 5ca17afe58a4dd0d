import dataclasses
import pickle

import pytest

import turtlelog as tl
from tests.measure.test_breaks import make_robot, move
from turtlelog.compare.run_selection import list_usual_metrics
from turtlelog.errors import CompareError
from turtlelog.measure import Status
from turtlelog.measure.breaks import find_jumps

RUNS = [tl.simulate_run(tl.load_scenario(name)) for name in tl.scenario.PAPER_RUNS]
SUMMARIES = [tl.summarise_run(run, file=f"{run.name}.mcap") for run in RUNS]
CUT = tl.summarise_run(
    tl.simulate_run(tl.override_scenario(tl.load_scenario("paper-kp1"), {"max_duration_s": 2.0}))
)


def list_names(summaries: tuple[tl.compare.RunSummary, ...]) -> list[str]:
    return [summary.name.removeprefix("paper-") for summary in summaries]


def read_column(table: tl.compare.Table, title: str) -> list[object]:
    index = [column.title for column in table.columns].index(title)
    return [row[index] for row in table.rows]


def test_the_table_has_a_row_per_run_with_gains_and_what_else_differs() -> None:
    table = tl.tabulate_runs(SUMMARIES)
    assert read_column(table, "run") == list(tl.scenario.PAPER_RUNS)
    assert read_column(table, "Kp") == [1.0, 2.0, 4.0, 10.0]
    assert read_column(table, "loop.start_backlog") == [6, 5, 6, 5]
    assert read_column(table, "run.duration") == [20.528, 12.672, 11.184, 12.608]


def test_gains_that_differ_between_the_loops_have_a_column_each() -> None:
    scenario = tl.override_scenario(tl.load_scenario("paper-kp4"), {"law.kp_linear": 3.0})
    table = tl.tabulate_runs([SUMMARIES[2], tl.summarise_run(tl.simulate_run(scenario))])
    assert read_column(table, "Kp turn") == [4.0, 4.0]
    assert read_column(table, "Kp drive") == [4.0, 3.0]


def test_a_parameter_that_files_leave_out_by_default_is_shown_where_it_differs() -> None:
    paper = tl.load_scenario("paper-kp4")
    runs = [
        tl.simulate_run(paper),
        tl.simulate_run(tl.override_scenario(paper, {"law.timeout_s": 20.0})),
        tl.simulate_run(tl.override_scenario(paper, {"start.precision": "float64"})),
    ]
    table = tl.tabulate_runs([tl.summarise_run(run) for run in runs])
    assert read_column(table, "law.timeout_s") == [30.0, 20.0, 30.0]
    assert read_column(table, "start.precision") == ["float32", "float32", "float64"]
    heads = {one.title: (one.lines, one.unit) for one in table.columns}
    assert heads["law.timeout_s"] == (("law", "timeout"), "s")
    assert heads["start.precision"] == (("start", "precision"), "")
    assert tl.compare.name_runs(runs[:2]) == ("paper-kp4 timeout_s 30", "paper-kp4 timeout_s 20")


def test_of_a_run_without_its_whole_scenario_no_default_is_assumed() -> None:
    cut = dataclasses.replace(RUNS[2], scenario_is_complete=False)
    assert "law.timeout_s" not in tl.summarise_run(cut).parameters
    assert tl.summarise_run(RUNS[2]).parameters["law.timeout_s"] == 30.0


def test_the_best_and_the_worst_are_marked_by_direction(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tl.compare.mark_metric(SUMMARIES, "run.duration") == {2: "best", 0: "worst"}
    from turtlelog.compare import ranking

    for better, marks in (("higher", {0: "best", 2: "worst"}), (None, {})):
        kind = dataclasses.replace(tl.METRICS["run.duration"], better=better)  # type: ignore[arg-type]
        monkeypatch.setattr(ranking, "find_metric_kind", lambda _, kind=kind: kind)
        assert tl.compare.mark_metric(SUMMARIES, "run.duration") == marks


def test_a_loop_that_never_settles_is_worse_than_each_that_does() -> None:
    name = "translate.settling_time"
    never = dataclasses.replace(SUMMARIES[0].metrics[name], value=None, status=Status.NOT_REACHED)
    metrics = {**SUMMARIES[0].metrics, name: never}
    lost = dataclasses.replace(SUMMARIES[0], metrics=metrics)
    assert tl.compare.mark_metric([*SUMMARIES[2:0:-1], lost], name) == {0: "best", 2: "worst"}
    assert tl.compare.mark_metric([SUMMARIES[1], lost], name) == {0: "best", 1: "worst"}


def test_a_key_that_the_same_law_omits_differs() -> None:
    schedule = {"law.schedule.over": "distance", "law.schedule.at": [0.0, 1.0]}
    schedule["law.schedule.kp_linear"] = [4.0, 2.0]
    scenario = tl.override_scenario(tl.load_scenario("paper-kp4"), schedule)
    runs = [SUMMARIES[2], tl.summarise_run(tl.simulate_run(scenario))]
    assert read_column(tl.tabulate_runs(runs), "law.schedule.over") == [None, "distance"]


def test_equal_runs_and_runs_without_a_value_have_no_marks() -> None:
    assert tl.compare.mark_metric([SUMMARIES[0], SUMMARIES[0]], "run.duration") == {}
    assert tl.compare.mark_metric([SUMMARIES[0], CUT], "translate.duration") == {}
    assert tl.compare.mark_metric([], "run.duration") == {}


@pytest.mark.parametrize(("other_s", "marks"), [(20.54, {}), (20.56, {0: "best", 1: "worst"})])
def test_values_that_are_printed_alike_are_equally_good(
    other_s: float, marks: dict[int, str]
) -> None:
    duration = dataclasses.replace(SUMMARIES[0].metrics["run.duration"], value=other_s)
    metrics = {**SUMMARIES[0].metrics, "run.duration": duration}
    other = dataclasses.replace(SUMMARIES[0], metrics=metrics)
    assert tl.compare.mark_metric([SUMMARIES[0], other], "run.duration") == marks


def test_a_missing_value_shows_its_status() -> None:
    table = tl.tabulate_runs([SUMMARIES[0], CUT], only=["translate.duration"])
    assert read_column(table, "translate.duration")[1] == "no_phase"


def test_marks_are_written_as_each_format_has_them() -> None:
    table = tl.tabulate_runs(SUMMARIES[:2], only=["run.duration"])
    text = tl.draw.format_table(table).splitlines()
    assert text[-5:] == [
        "---------------------------",
        "paper-kp1      1    20.528!",
        "paper-kp2      2    12.672*",
        "",
        "* best, ! worst of a column.",
    ]
    assert "| paper-kp2 | 2 | **12.672** |" in tl.draw.format_table(table, "md")
    assert r"paper-kp1 & 1 & \textit{20.528} \\" in tl.draw.format_table(table, "tex")
    assert tl.draw.format_table(table, "csv").splitlines()[2] == "paper-kp2,2.0,12.672"


def test_columns_are_chosen_by_name_pattern_and_parameter() -> None:
    only = ["run.*", "law.kp_linear", "rotate.overshoot", "run.duration"]
    chosen = tl.compare.choose_columns(SUMMARIES, only)
    assert chosen[0].startswith("run.")
    assert chosen[-2:] == ("law.kp_linear", "rotate.overshoot")
    assert len(set(chosen)) == len(chosen)
    expected = r'only: no metric or parameter "run\.durtion"; did you mean run\.duration\?\Z'
    with pytest.raises(CompareError, match=expected):
        tl.tabulate_runs(SUMMARIES, only=["run.durtion"])


@pytest.mark.parametrize(
    ("where", "names"),
    [
        ("law.kp_linear >= 2", ["kp2", "kp4", "kp10"]),
        ("law.kp_linear >= 2 and run.duration < 12", ["kp4"]),
        ('name == "paper-kp1" or stop_reason == "nothing"', ["kp1"]),
        ('source == "simulation" and not (final.position_error > 0.005)', ["kp1", "kp2"]),
        ("law.kp_linear > 100", []),
    ],
)
def test_runs_are_chosen_by_an_expression(where: str, names: list[str]) -> None:
    chosen, notes = tl.compare.select_runs(SUMMARIES, where)
    assert (list_names(chosen), notes) == (names, ())


def test_a_run_without_a_value_is_left_out_and_told() -> None:
    chosen, notes = tl.compare.select_runs([*SUMMARIES, CUT], "translate.duration > 0")
    assert len(chosen) == 4
    assert notes == ("paper-kp1 is left out: translate.duration is no_phase.",)
    bare = dataclasses.replace(CUT, parameters={}, file="bag.mcap")
    _, notes = tl.compare.select_runs([SUMMARIES[0], bare], "law.kp_linear > 0")
    assert notes == ("bag.mcap is left out: law.kp_linear is not known.",)


def test_what_is_said_anyway_needs_no_value() -> None:
    chosen, notes = tl.compare.select_runs([CUT], "translate.duration > 0 or run.duration < 5")
    assert (len(chosen), notes) == (1, ())


def test_many_runs_without_a_value_are_counted() -> None:
    _, notes = tl.compare.select_runs(
        [dataclasses.replace(CUT, file=f"{number}.mcap") for number in range(9)],
        "translate.duration > 0",
    )
    assert len(notes) == 6
    assert notes[-1] == "4 more are left out for lack of values."


def test_wrong_filters_are_refused_with_the_nearest_names() -> None:
    with pytest.raises(tl.TurtlelogError, match=r'where: .*"law\.kp_liner".* law\.kp_linear\?'):
        tl.compare.select_runs(SUMMARIES, "law.kp_liner > 2")
    with pytest.raises(CompareError, match="where: expected a condition, found 3"):
        tl.compare.select_runs(SUMMARIES, "1 + 2")


def test_runs_are_sorted_by_metric_parameter_and_text() -> None:
    assert list_names(tl.compare.sort_runs(SUMMARIES, "run.duration")) == [
        "kp4",
        "kp10",
        "kp2",
        "kp1",
    ]
    assert list_names(tl.compare.sort_runs(SUMMARIES, "-law.kp_linear")) == [
        "kp10",
        "kp4",
        "kp2",
        "kp1",
    ]
    assert list_names(tl.compare.sort_runs(SUMMARIES, "name")) == ["kp1", "kp10", "kp2", "kp4"]


@pytest.mark.parametrize("by", ["translate.duration", "-translate.duration"])
def test_a_run_without_a_value_comes_last(by: str) -> None:
    assert tl.compare.sort_runs([CUT, *SUMMARIES], by)[-1] is CUT


def test_a_beginning_of_many_names_suggests_some_of_them() -> None:
    expected = r'sort: no metric or parameter "r"; there are name, .*, \.\.\.\Z'
    with pytest.raises(CompareError, match=expected) as caught:
        tl.compare.sort_runs(SUMMARIES, "r")
    assert str(caught.value).count(", ") == 14


def test_an_unknown_order_is_refused_with_the_nearest_names() -> None:
    expected = r'sort: no metric or parameter "run\.durtion"; did you mean run\.duration\?\Z'
    with pytest.raises(CompareError, match=expected):
        tl.compare.sort_runs(SUMMARIES, "run.durtion")


def test_a_table_is_made_of_the_metrics_that_it_names() -> None:
    needed = tl.compare.list_needed_metrics(
        ["final.*", "law.kp_linear"], where="run.duration < 9 and x > 1", sort="-rotate.iae"
    )
    assert needed == ("final.*", "run.duration", "rotate.iae")
    usual = tl.measure_run(RUNS[0], only=tl.compare.list_needed_metrics())
    assert {*list_usual_metrics(RUNS[0].declaration)} < {*usual}
    assert len(usual) < 10


def test_the_usual_metrics_of_the_papers_law() -> None:
    assert list_usual_metrics(RUNS[0].declaration) == (
        *("rotate.settling_time", "rotate.overshoot"),
        *("final.heading_error", "final.position_error", "run.duration"),
    )


def test_a_summary_comes_through_a_pickle_as_it_was() -> None:
    again = pickle.loads(pickle.dumps(CUT))
    assert again == CUT
    with pytest.raises(TypeError):
        again.parameters["law.kp_linear"] = 3.0


def test_an_effect_that_one_scenario_leaves_out_is_named_beside_the_seed() -> None:
    paper = tl.load_scenario("paper-kp4")
    noise = {"sensing.noise_position_m": 0.01, "seed": 3}
    runs = [tl.simulate_run(paper), tl.simulate_run(tl.override_scenario(paper, noise))]
    summaries = [tl.summarise_run(run) for run in runs]
    title = tl.tabulate_runs(summaries).title
    assert title.startswith("2 runs (seed and sensing.noise_position_m differ)")
    cut = tl.summarise_run(dataclasses.replace(runs[0], scenario_is_complete=False))
    assert "noise_position_m" not in tl.tabulate_runs([cut, summaries[1]]).title


def test_an_effect_at_its_default_does_not_differ_from_none() -> None:
    paper = tl.load_scenario("paper-kp4")
    off = tl.override_scenario(paper, {"sensing.delay_s": 0.0, "law.kp_linear": 3.0})
    summaries = [tl.summarise_run(tl.simulate_run(one)) for one in (paper, off)]
    assert "sensing" not in tl.tabulate_runs(summaries).title


@pytest.mark.parametrize(("ahead_m", "is_told"), [(0.0195, False), (0.0205, True)])
def test_jumps_that_change_the_printed_path_length_are_noted(
    ahead_m: float, *, is_told: bool
) -> None:
    """Of 40 m, 20 mm are half of the third digit's step at most."""
    run = move(make_robot(turn_rate=0.02, count=4001), 1000, ahead_m)
    assert len(find_jumps(run)) == 1
    summary = tl.summarise_run(run)
    assert summary.notes.get("jumps", "").startswith("1 jump, 0.0305 m ahead") is is_told
    turned = tl.summarise_run(move(make_robot(), 100, turned_rad=1.0))
    assert "jumps" not in turned.notes


@pytest.mark.parametrize(("lag_s", "marks"), [(9e-6, {}), (1.1e-5, {0: "best", 1: "worst"})])
def test_lags_below_their_resolution_of_10_us_are_equally_good(
    lag_s: float, marks: dict[int, str]
) -> None:
    runs = []
    for value in (3e-17, lag_s):
        metric = tl.measure.Metric(id="run.turn_rate_lag", value=value, unit="s")
        runs.append(dataclasses.replace(SUMMARIES[0], metrics={metric.id: metric}))
    assert tl.compare.mark_metric(runs, "run.turn_rate_lag") == marks
