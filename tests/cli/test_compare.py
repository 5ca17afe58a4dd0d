import csv
import io
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.sequential import METRICS


def test_the_first_line_is_the_answer_and_the_best_are_named_below(
    call: Call, kp4: Path, kp10: Path
) -> None:
    answer = call("compare", kp4, kp10, "--sort", "-run.duration")
    assert answer.code == 0
    lines = answer.out.splitlines()
    assert lines[:3] == [
        "Most accurate: paper-kp4, 0.00852 m.",
        "2 runs, Kp = 10, 4 (law.pause_ticks and loop.start_backlog differ too, so not",
        "every difference is due to Kp): no run is best at everything.",
    ]
    said = [" ".join(line.split()) for line in lines[3:8]]
    assert said == [
        "None reaches the goal.",
        "most accurate paper-kp4 0.00852 m worst: paper-kp10, 0.107 m",
        "shortest paper-kp4 11.2 s worst: paper-kp10, 12.6 s",
        "settles first (rotate) paper-kp10 2.21 s worst: paper-kp4, 2.28 s",
        "least overshoot (rotate) paper-kp4 0.0667 % worst: paper-kp10, 1.01 %",
    ]
    assert answer.out.index("\npaper-kp10") < answer.out.index("\npaper-kp4")
    assert "11.184*" in answer.out
    assert "12.608!" in answer.out
    pasted = " ".join(answer.out.replace("\\\n", "").split())
    assert f"Why is paper-kp10 worse? turtlelog explain {kp10}" in pasted
    assert len(lines) <= 40
    assert max(map(len, [line for line in lines if str(kp10) not in line])) <= 80


def test_equal_runs_are_called_equal(call: Call, kp4: Path) -> None:
    first = call("compare", kp4, kp4).out.splitlines()[0]
    assert first == "2 runs: all metrics shown are equal."
    first = call("compare", kp4, kp4, "--metric", "run.rest_share").out.splitlines()[0]
    assert first == "2 runs: all metrics shown are equal."


def test_a_metric_of_which_neither_is_better_has_no_best(call: Call, kp4: Path, kp10: Path) -> None:
    words = " ".join(call("compare", kp4, kp10, "--metric", "run.rest_share").out.split())
    keys = "law.pause_ticks and loop.start_backlog"
    differing = f"{keys} differ too, so not every difference is due to Kp"
    assert words.startswith(f"2 runs, Kp = 4, 10 ({differing}): no metric shown has a best value.")


def test_a_robot_that_stays_short_of_its_target_overshoots_by_nothing(call: Call) -> None:
    files = [f"recordings/paper/kp{gain}.mcap" for gain in (1, 10)]
    lines = [" ".join(line.split()) for line in call("compare", *files).out.splitlines()]
    assert "least overshoot (rotate) paper-kp1 none worst: paper-kp10, 1.01 %" in lines


def test_runs_stand_in_rising_gain_where_no_order_is_asked_for(
    call: Call, kp4: Path, kp10: Path
) -> None:
    rows = call("compare", kp10, kp4, "--csv").out.splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["paper-kp4", "paper-kp10"]


def test_runs_beside_each_other_as_json(call: Call, kp4: Path, kp10: Path) -> None:
    answer = call("compare", kp4, kp10, "--json", "--where", "law.kp_linear < 5").json
    assert (answer["reference"], answer["alignment"]) == (None, None)
    (run,) = answer["runs"]
    assert (run["file"], run["name"], run["overlap_s"]) == (str(kp4), "paper-kp4", None)
    assert run["parameters"]["law.kp_linear"] == 4.0
    assert [metric["id"] for metric in run["metrics"]] == list(METRICS)


def test_marks_stand_in_json(call: Call, kp4: Path, kp10: Path) -> None:
    answer = call("compare", kp4, kp10, "--json", "--metric", "run.duration").json
    metrics = [run["metrics"] for run in answer["runs"]]
    assert [[metric["mark"] for metric in found] for found in metrics] == [["best"], ["worst"]]


def test_runs_under_other_conditions_are_not_ranked(call: Call, kp4: Path, tmp_path: Path) -> None:
    slow = tmp_path / "slow.mcap"
    call("run", "paper-kp4", "--set", "limits.speed_m_s=0.5", "--set", "name=slow", "-o", slow)
    answer = call("compare", kp4, slow)
    lines = answer.out.splitlines()
    assert lines[:2] == [
        "2 runs: limits differ, so nothing is called best.",
        "limits.speed_m_s: 1 of paper-kp4, 0.5 of slow.",
    ]
    assert "Varied on purpose? --varied limits.speed_m_s" in lines
    assert "* best" not in answer.out
    ranking = call("compare", kp4, slow, "--json").json["ranking"]
    assert (ranking["is_fair"], ranking["varied"], ranking["unknown"]) == (False, [], [])
    assert ranking["reason"] == "limits differ, so nothing is called best"
    (found,) = ranking["differences"]
    assert found == {"condition": "limits", "key": "limits.speed_m_s", "values": [1.0, 0.5]}
    runs = call("compare", kp4, slow, "--json").json["runs"]
    assert {metric["mark"] for run in runs for metric in run["metrics"]} == {None}
    assert next(iter(runs[0]["parameters"])) == "limits.speed_m_s"


def test_a_limit_that_was_varied_on_purpose_is_named_first(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    slow = tmp_path / "slow.mcap"
    call("run", "paper-kp4", "--set", "limits.speed_m_s=0.5", "--set", "name=slow", "-o", slow)
    words = ("compare", kp4, slow, "--varied", "limits.speed_m_s", "--metric", "run.duration")
    assert call(*words).out.splitlines()[:2] == [
        "Shortest: paper-kp4, 11.2 s.",
        "2 runs, limits.speed_m_s = 1, 0.5: paper-kp4 is best at run.duration.",
    ]
    ranking = call(*words, "--json").json["ranking"]
    assert (ranking["is_fair"], ranking["varied"]) == (True, ["limits.speed_m_s"])
    refused = call("compare", kp4, slow, "--varied", "limits.sped")
    assert refused.code == 2
    assert '--varied: no key "limits.sped"; did you mean limits.speed_m_s' in refused.err


def test_tables_come_as_markdown_csv_and_latex(call: Call, kp4: Path, kp10: Path) -> None:
    files = ("compare", kp4, kp10, "--metric", "run.duration")
    assert "| **11.184** |" in call(*files, "--markdown").out
    rows = list(csv.DictReader(io.StringIO(call(*files, "--csv").out)))
    assert [row["run.duration [s]"] for row in rows] == ["11.184", "12.608"]
    assert r"\textit{12.608}" in call(*files, "--latex").out


def test_differences_are_from_the_reference(call: Call, kp4: Path, kp10: Path) -> None:
    answer = call("compare", kp10, "--reference", kp4, "--json").json
    assert (answer["reference"], answer["alignment"]) == (str(kp4), "first_sample")
    (run,) = answer["runs"]
    assert (run["file"], run["overlap_s"], run["overlap_from_s"]) == (str(kp10), 11.184, 0.0)
    held = {name for name in tl.SIGNALS if not name.startswith(("sensed_", "shaped_", "measured_"))}
    assert {signal["signal"] for signal in run["signals"]} == held
    assert {*run["signals"][0]} == {"signal", "unit", "largest", "at_s"}
    errors = {metric["id"]: metric for metric in run["metrics"]}["final.position_error"]
    assert errors["value"] > errors["reference"]
    assert errors["better"] == "lower"


def test_differences_are_printed_and_drawn(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    answer = call("compare", kp10, "--reference", kp4, "--rrd", tmp_path / "both.rrd")
    lines = answer.out.splitlines()
    first = "paper-kp10 departs from the path of paper-kp4 by at most 0.1278 m, at 8.78 s."
    assert lines[0] == first
    assert "Largest differences from paper-kp4, from the first samples on" in lines
    assert "Compared over paper-kp10: 0.00 to 11.18 s." in lines
    assert len(lines) <= 40
    assert max(map(len, [line for line in lines if str(kp4) not in line])) <= 80
    assert (tmp_path / "both.rrd").exists()


def test_a_run_beside_itself_stays_on_its_path(call: Call, kp4: Path) -> None:
    lines = call("compare", kp4, "--reference", kp4).out.splitlines()
    assert lines[0] == "kp4.mcap (2) stays on the path of kp4.mcap (1), within 1e-9 m."


def test_signals_of_many_runs_stand_behind_an_option(call: Call, kp4: Path) -> None:
    words = ("compare", *[kp4] * 9, "--reference", kp4)
    answer = call(*words)
    assert answer.out.startswith("9 runs beside kp4.mcap (1): all stay on its path, within 1e-9 m.")
    assert "The largest difference of every signal: --details" in answer.out
    assert "along_track" not in answer.out
    detailed = call(*words, "--details").out
    assert detailed.count("\nalong_track") >= 2
    assert max(map(len, [line for line in detailed.splitlines() if str(kp4) not in line])) <= 80
    assert "kp4.mcap (10)" in answer.out


def test_compare_gives_no_verdict_and_says_who_does(call: Call, kp4: Path, kp10: Path) -> None:
    words = ("compare", kp10, "--reference", kp4, "--tolerances", "t.toml")
    answer = call(*words)
    assert (answer.code, answer.out) == (2, "")
    expected = f"turtlelog check t.toml RUN --reference {kp4}"
    assert answer.err == (
        f"turtlelog: error: --tolerances: leave it out; verdicts are given by {expected}\n"
    )
    assert "--tolerances" not in call("compare", "--help").out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--tolerances", "t.toml"], "--tolerances: leave it out; verdicts are given by"),
        (["--align", "sample"], "--align: needs --reference FILE"),
        (
            ["--reference", "KP4", "--sort", "name"],
            "--sort: leave out --reference",
        ),
        (["--reference", "KP4", "--where", "1 < 2"], "--where: leave out --reference"),
        (["--reference", "KP4", "--align", "samples"], "alignment: expected sample"),
        (["--csv", "--json"], "--csv and --json: choose one format"),
        (
            ["--metric", "run.durtion"],
            '--metric: no metric or parameter "run.durtion"; did you mean run.duration',
        ),
        (["--sort", "kp"], "--sort: no metric or parameter "),
        (["--where", "law.kp_liner > 1"], "--where: column 1: "),
        (["--where", "law.kp_linear >"], "--where: column 16: "),
    ],
)
def test_options_that_make_no_sense_are_refused(
    call: Call, kp4: Path, words: list[str], message: str
) -> None:
    answer = call("compare", kp4, kp4, *(str(kp4) if word == "KP4" else word for word in words))
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("turtlelog: error: ")
    assert message in answer.err
    assert len(answer.err.splitlines()) == 1


def test_runs_that_are_left_out_are_noted_beside_csv(call: Call, kp4: Path, tmp_path: Path) -> None:
    scenario = tl.override_scenario(tl.load_scenario("paper-kp4"), {"max_duration_s": 1.0})
    tl.write_recording(tl.simulate_run(scenario), tmp_path / "cut.mcap")
    words = (kp4, tmp_path / "cut.mcap", "--where", "translate.duration > 0", "--csv")
    answer = call("compare", *words)
    assert len(answer.out.splitlines()) == 2
    assert "cut.mcap is left out: translate.duration is no_phase." in answer.err


def test_a_run_that_cannot_be_read_does_not_stop_the_others(call: Call, kp4: Path) -> None:
    answer = call("compare", kp4, "none.mcap", kp4, "--metric", "run.duration")
    assert answer.code == 2
    assert "none.mcap: no such file" in answer.err
    assert answer.out.count("11.184") == 2


def test_a_run_that_is_left_alone_is_not_compared(call: Call, kp4: Path) -> None:
    answer = call("compare", kp4, "none.mcap", "--json")
    assert (answer.code, answer.out) == (2, "")


def test_where_is_parsed_before_anything_is_read(call: Call) -> None:
    answer = call("compare", "none.mcap", "none.mcap", "--where", "law.kp_linear >")
    assert answer.code == 2
    assert answer.err.startswith("turtlelog: error: --where: column 16: ")
    assert "none.mcap" not in answer.err


def test_runs_are_drawn_and_stand_beside_each_other(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    answer = call("compare", kp4, kp10, "--rrd", tmp_path / "both.rrd", "--metric", "run.duration")
    assert "11.184*" in answer.out
    assert (tmp_path / "both.rrd").exists()


def test_runs_are_sorted_by_the_gain_as_its_column_is_called(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    def list_names(*words: str | Path) -> list[str]:
        return [run["name"] for run in call("compare", *words, "--json").json["runs"]]

    assert list_names(kp10, kp4, "--sort", "Kp") == ["paper-kp4", "paper-kp10"]
    assert list_names(kp4, kp10, "--sort=-Kp") == ["paper-kp10", "paper-kp4"]
    mixed = tmp_path / "mixed.mcap"
    call("run", "textbook", "--kp", "20", "--set", "law.kp_linear=1", "-o", mixed)
    words = (kp10, kp4, mixed)
    assert list_names(*words, "--sort", "Kp turn")[-1].startswith("textbook")
    assert list_names(*words, "--sort", "Kp drive")[0].startswith("textbook")
    answer = call("compare", *words, "--sort", "Kp")
    assert (answer.code, answer.out) == (2, "")
    assert "--sort: expected Kp turn or Kp drive, found 'Kp'" in answer.err


@pytest.mark.thorough
@pytest.mark.everyday("table")
@pytest.mark.parametrize("options", [[], ["--json"], ["--csv"]], ids=["table", "json", "csv"])
def test_runs_are_held_to_a_reference_in_several_processes(
    call: Call, kp4: Path, kp10: Path, options: list[str]
) -> None:
    """Processes start, as for many files."""
    words = ("compare", kp10, kp4, kp10, "--reference", kp4, *options, "--jobs")
    alone, together = call(*words, "1"), call(*words, "2")
    assert together == alone
    assert alone.code == 0


@pytest.mark.thorough
def test_a_run_that_no_process_can_read_is_an_error_of_the_whole(
    call: Call, kp4: Path, kp10: Path
) -> None:
    words = ("compare", kp10, "none.mcap", kp10, "--reference", kp4, "--jobs")
    alone, together = call(*words, "1"), call(*words, "2")
    assert together == alone
    assert alone.code == 2
    assert "none.mcap" in alone.err


@pytest.mark.parametrize(("command", "option"), [("compare", "--metric"), ("explain", "--causes")])
def test_names_are_separated_by_one_comma(call: Call, kp4: Path, command: str, option: str) -> None:
    files = (kp4, kp4) if command == "compare" else (kp4,)
    answer = call(command, *files, option, "a,,b")
    assert answer.code == 2
    assert f"{option} a,,b: must be names separated by commas" in answer.err


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (
            ("kp1", "kp2", "kp4"),
            "Only paper-kp1 and paper-kp2 reach the goal; the shortest run does not.",
        ),
        (("kp1", "kp2"), "All reach the goal."),
        (("kp4", "kp10"), "None reaches the goal."),
    ],
)
def test_the_runs_that_reach_the_goal_are_named(
    call: Call, tmp_path: Path, names: tuple[str, ...], told: str
) -> None:
    for name in names:
        run = tl.simulate_run(tl.load_scenario(f"paper-{name}"))
        tl.write_recording(run, tmp_path / f"{name}.mcap")
    answer = call("compare", *(tmp_path / f"{name}.mcap" for name in names))
    assert told in answer.out.splitlines()


def test_a_worse_robot_is_explained_by_what_its_log_contains(call: Call, tmp_path: Path) -> None:
    """`explain` needs samples of a controller, which the logs of other programs lack."""
    files = [tmp_path / name for name in ("good.csv", "bad.csv")]
    for file, short_m in zip(files, (0.0, 0.5), strict=True):
        rows = (f"{0.05 * n},{min(0.05 * n, 4.0 - short_m)},0,0\n" for n in range(100))
        file.write_text("t,x,y,heading\n" + "".join(rows))
    answer = call("compare", *files, "--goal", "4,0", "--metric", "final.position_error")
    question, command = answer.out.partition("Why is bad worse? ")[1:]
    assert question
    assert "\\\n  " in command  # a command that goes on in the next line can be pasted
    assert command.split("\nFor other")[0].replace("\\\n  ", "").split() == [
        *("turtlelog", "compare", str(files[0]), str(files[1])),
        *("--goal=4,0", "--why", "final.position_error"),
    ]
    bounds = tmp_path / "bounds.toml"
    bounds.write_text('format = 1\n[checks.speed]\nexpect = "run.path_length <= 1"\n')
    failed = call("check", bounds, files[1])
    assert failed.code == 1
    assert "turtlelog explain" not in failed.out


def test_a_run_that_was_cut_is_explained_by_its_difference_from_the_other(
    call: Call, tmp_path: Path
) -> None:
    whole, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    call("run", "textbook", "-o", whole)
    call("run", "textbook", "--set", "max_duration_s=3", "-o", cut)
    out = " ".join(call("compare", whole, cut).out.replace("\\\n", "").split())
    command = f"turtlelog compare {whole} {cut} --why final.position_error"
    assert f"Why is cut.mcap worse? {command}" in out
    told = " ".join(call("explain", cut).out.split())
    assert told.startswith(
        "The run was cut after 2.99 s (max_duration), in the phase rotate. Translate never began."
    )
    assert "was cut" not in call("explain", whole).out
    assert "was cut" not in call("explain", cut, "--metric", "run.path_length").out


def test_gains_without_any_effect_are_explained_by_the_difference(
    call: Call, tmp_path: Path
) -> None:
    fast, slow = tmp_path / "fast.mcap", tmp_path / "slow.mcap"
    call("run", "textbook", "--kp", "120", "-o", fast)
    call("run", "textbook", "--kp", "62.5", "-o", slow)
    out = " ".join(call("compare", fast, slow).out.replace("\\\n", "").split())
    command = f"turtlelog compare {slow} {fast} --why final.position_error"
    assert f"Why is textbook kp=120 worse? {command}" in out
    call("run", "textbook", "--kp", "120", "--set", "loop.transport_delay_ticks=1", "-o", fast)
    out = " ".join(call("compare", fast, slow).out.replace("\\\n", "").split())
    assert f"Why is fast.mcap worse? turtlelog explain {fast}" in out


def test_all_runs_have_the_names_of_files_if_one_has(call: Call, tmp_path: Path) -> None:
    plain, long = tmp_path / "plain.mcap", tmp_path / "long.mcap"
    call("run", "textbook", "-o", plain)
    call("run", "textbook", "--set", "max_duration_s=30", "-o", long)
    out = call("compare", plain, long).out
    assert "\nplain.mcap " in out
    assert "\nlong.mcap " in out
    assert "\nplain.mcap: textbook\n" in out
    assert "\nlong.mcap: textbook max_duration_s=30\n" in out


def test_a_jump_of_the_poses_is_told_beside_the_other_runs(call: Call, tmp_path: Path) -> None:
    for name, jump_m in (("smooth", 0.0), ("jumps", 3.0)):
        rows = [f"{0.1 * k:.1f},{0.02 * k + jump_m * (k > 50):.2f},0,0" for k in range(100)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["time [s],x [m],y [m],heading", *rows]))
    files = [tmp_path / f"{name}.csv" for name in ("smooth", "jumps")]
    told = " ".join(call("compare", *files).out.split())
    assert "The path length of jumps counts as driven: " in told
    assert "The path length of smooth counts" not in told
