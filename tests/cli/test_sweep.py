import os
import subprocess
import sys
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.cli import sweep as sweep_command
from turtlelog.cli.work import Rate
from turtlelog.sweep import read_result_table

GRID = ("--grid", "law.kp_linear=1:2")


@pytest.fixture(autouse=True)
def _stay_in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_sweep_answers_in_one_line_and_in_json(call: Call) -> None:
    done = call("sweep", "textbook", *GRID, "-o", "t.parquet")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("2 runs over law.kp_linear: final.position_error is ")
    told = call("sweep", "textbook", *GRID, "-o", "u.parquet", "--json").json
    assert told | {"elapsed_s": 0, "samples": 0} == {
        "output": "u.parquet",
        "rows": 2,
        "failed": 0,
        "samples": 0,
        "recorded": 0,
        "elapsed_s": 0,
    }
    runs = [
        tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), {"law.kp_linear": kp}))
        for kp in (1.0, 2.0)
    ]
    assert told["samples"] == sum(len(run.samples) for run in runs)
    assert told["elapsed_s"] > 0


def test_failed_rows_are_told_and_are_no_failure_of_the_sweep(call: Call) -> None:
    words = ("sweep", "textbook", "--grid", "law.kp_linear=-1:1", "-o", "t.parquet")
    done = call(*words, "--metric", "run.duration,align.overshoot")
    assert done.code == 0
    assert done.err.splitlines() == [
        "metric align.overshoot: no row has a value (no_phase)",
        "2 rows failed, the first: row 0: grid: law.kp_linear: expected a number > 0, found -1.0",
    ]


def test_base_is_a_preset_a_file_or_a_recording(call: Call, tmp_path: Path, kp4: Path) -> None:
    base = tl.load_scenario("paper-kp4")
    (tmp_path / "kp4.toml").write_text(tl.format_scenario(base))
    tables = []
    for number, name in enumerate(("paper-kp4", "kp4.toml", str(kp4))):
        done = call("sweep", name, *GRID, "--set", "max_duration_s=9", "-o", f"{number}.parquet")
        assert done.code == 0, done.err
        tables.append(read_result_table(f"{number}.parquet", kind="sweep").columns)
    assert tables[0] == tables[1] == tables[2]


def test_identified_robot_is_swept(call: Call, tmp_path: Path) -> None:
    robot = tmp_path / "robot.mcap"
    tl.write_recording(tl.simulate_run(tl.load_scenario("lagged")), robot)
    assert call("identify", robot, "--scenario", "robot.toml").code == 0
    done = call("sweep", "robot.toml", *GRID, "-o", "t.parquet", "--metric", "run.duration")
    assert done.out.startswith("2 runs over law.kp_linear: run.duration is 5.6 s to 8.5 s"), (
        done.err
    )


def test_row_of_a_table_is_run(call: Call) -> None:
    words = ("--metric", "translate.settling_time", "-o", "t.parquet")
    assert call("sweep", "paper-kp4", *GRID, *words).code == 0
    told = call("run", "--from", "t.parquet", "--row", "1", "--json").json
    assert told["name"] == "paper-kp4 row 1"
    (found,) = [one for one in told["metrics"] if one["id"] == "translate.settling_time"]
    column = read_result_table("t.parquet", kind="sweep").find("translate.settling_time")
    assert column is not None
    assert found["value"] == column.cells[1]
    changed = call("run", "--from", "t.parquet", "--row", "1", "--set", "goal.x_m=3", "--json")
    assert changed.json["name"] == "paper-kp4 row 1 goal.x_m=3"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--from", "t.parquet"), "--from: needs --row NUMBER"),
        (("--row", "1"), "--row: needs --from TABLE"),
        (("--from", "t.parquet", "--row", "2"), "t.parquet: expected a row from 0 to 1, found 2"),
        (("paper", "--from", "t.parquet", "--row", "0"), "--from: leave out the scenario paper"),
        (
            ("--from", "t.parquet", "--row", "0", "--watch"),
            "--watch: leave out --from, whose table does not change",
        ),
        (("--from", "none.parquet", "--row", "0"), "none.parquet: no such file"),
    ],
)
def test_row_that_cannot_be_run_is_one_line(
    words: tuple[str, ...], message: str, call: Call
) -> None:
    assert call("sweep", "textbook", *GRID, "-o", "t.parquet").code == 0
    done = call("run", *words)
    assert done.code == 2
    assert done.err.startswith("turtlelog: error: ")
    assert message in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "--grid: name a key to vary, for example --grid law.kp_linear=1:12"),
        (("--grid", "law.kp_linear=2:1"), "no value from 2 to 1"),
        (
            ("--grid", "law.kp=1:2"),
            "grid: law.kp: unknown key; did you mean kp_angular",
        ),
        (("--grid", "kp_linear=1:2"), "grid: kp_linear: unknown key; did you mean law.kp_linear"),
        (("--grid", "law.kp_linear=-2:-1"), "law.kp_linear: expected a number > 0, found -2"),
        (
            (*GRID, "--metric", "rotate.overshot"),
            'no metric "rotate.overshot"; did you mean rotate.overshoot',
        ),
        ((*GRID, "--metric", "a,"), "--metric a,: must be names separated by commas"),
        ((*GRID, "--seed", "1"), "--seed: needs --sample COUNT"),
        ((*GRID, "--latin"), "--latin: needs --sample COUNT"),
        ((*GRID, "--sample", "0"), "--sample: expected at least 1, found 0"),
        ((*GRID, "--record-where", "1 > 2"), "--record-where: needs --record DIR"),
        (
            ("--grid", "kp=1:2", "--set", "law.kp_linear=3"),
            "--set: law.kp_linear is varied by --grid; leave one of them out",
        ),
        (
            (*GRID, "--set", "law.kp_linear=3"),
            "--set: law.kp_linear is varied by --grid; leave one of them out",
        ),
        ((*GRID, "--jobs", "0"), "--jobs 0: must be at least 1"),
        ((*GRID, "-o", "t.csv"), "t.csv: the name must end in .parquet"),
        ((*GRID, "-o", "none/t.parquet"), "none/t.parquet: there is no such folder to write to"),
        (("--grid", "law.kp_linear=1:1000:0.0001"), "9,990,001 rows: about "),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[str, ...], message: str, call: Call, tmp_path: Path
) -> None:
    output = () if "-o" in words else ("-o", "t.parquet")
    done = call("sweep", "textbook", *words, *output)
    assert done.code == 2
    assert done.err.startswith("turtlelog: error: ")
    assert message in done.err
    assert done.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_many_rows_are_announced_and_need_consent(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("sweep", "textbook", *GRID, "-o", "t.parquet")
    monkeypatch.setattr(sweep_command, "_MANY_ROWS", 1)
    done = call(*words)
    assert done.code == 2
    assert "2 rows: about 0:00:0" in done.err
    assert "in t.parquet; add --yes to start it" in done.err
    assert call(*words, "--yes").code == 0
    monkeypatch.setattr(sweep_command, "_MANY_ROWS", 2)
    assert call("sweep", "textbook", *GRID, "-o", "u.parquet").code == 0


@pytest.mark.everyday("y\\n-0")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such terminals")
@pytest.mark.parametrize(("answer", "code"), [("y\n", 0), ("n\n", 2), ("\n", 2)])
def test_consent_is_asked_for_at_a_terminal(answer: str, code: int, tmp_path: Path) -> None:
    """A command starts at a pseudo-terminal."""
    import pty

    program = (
        "from turtlelog.cli import sweep\nfrom turtlelog.cli.app import main\n"
        "sweep._MANY_ROWS = 1\nmain()\n"
    )
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", program, "sweep", "textbook", *GRID, "-o", "t.parquet"],
        stdin=theirs,
        stderr=theirs,
        stdout=subprocess.PIPE,
        cwd=tmp_path,
    ) as asked:
        os.close(theirs)
        text = b""
        while b"Go on? [y/N]" not in text:
            text += os.read(ours, 1000)
        os.write(ours, answer.encode())
        assert asked.wait(60) == code
    os.close(ours)
    assert b"2 rows: about 0:00:01, and 0 MB in t.parquet" in text
    assert (tmp_path / "t.parquet").exists() == (code == 0)


def test_rate_and_time_left_count_from_where_a_sweep_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [10.0]
    monkeypatch.setattr("turtlelog.cli.work.time.monotonic", lambda: now[0])
    rate = Rate()
    assert rate.describe(50, 150) == ""
    now[0] = 12.0
    assert rate.describe(50, 150) == ""
    assert rate.describe(60, 150) == ", 5.0/s, 0:00:18 left"
    assert rate.describe(70, 150) == ", 10/s, 0:00:08 left"


NOISE = ("--set", "sensing.noise_position_m=0.01")
GRID_OF_SEEDS = ("--grid", "seed=0:3", *NOISE)


def test_rows_of_one_seed_are_told_if_chance_has_a_part(call: Call) -> None:
    told = "Every row has the same random effects, of seed 0."
    noisy = call("sweep", "textbook", "--grid", "law.kp_linear=1,2", *NOISE, "-o", "a.parquet")
    assert told in " ".join(noisy.out.split())
    varied = call("sweep", "textbook", "--grid", f"{NOISE[1][:-5]}=0,0.01", "-o", "b.parquet")
    assert told in " ".join(varied.out.split())
    exact = call("sweep", "textbook", "--grid", "law.kp_linear=1,2", "-o", "c.parquet")
    assert "seed" not in exact.out


def test_over_seeds_the_least_mean_is_told(call: Call) -> None:
    """The first line agrees with the map: at a noise of 0.1 m the run ends elsewhere."""
    grid = ("--grid", "sensing.noise_position_m=0,0.1", "--grid", "seed=0:7")
    done = call("sweep", "textbook", *grid, "-o", "s.parquet")
    told = " ".join(done.out.split())
    assert "; its mean over 8 seeds is least with sensing.noise_position_m = 0." in told
    assert "same random effects" not in told
    alike = call(
        "sweep", "textbook", "--grid", "law.kp_linear=1,2", *GRID_OF_SEEDS, "-o", "t.parquet"
    )
    assert "over 4 seeds, all differences of the means may be chance" in " ".join(alike.out.split())
