"""`turtlelog compare` with the scenario of a robot among the files."""

from collections.abc import Mapping
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

import turtlelog as tl
from tests.cli.conftest import Call
from tests.identify.robots import Log, make_run, write_bag
from turtlelog.scenario import format_scenario

LOG = Log(duration_s=16.0, poses_hz=20.0, commands_hz=10.0, noise_m=1e-3, noise_rad=2e-3)

PLANT = {
    f"plant.{name}": value
    for axis in ("speed", "turn")
    for name, value in ((f"{axis}_dead_time_s", 0.1), (f"{axis}_lag_s", 0.1))
}
NOISE = {"sensing.noise_position_m": 1e-3, "sensing.noise_heading_rad": 2e-3}


def write_scenario(path: Path, changes: Mapping[str, float | str], preset: str = "lagged") -> Path:
    scenario = tl.override_scenario(tl.load_scenario(preset), changes, source="test")
    path.write_text(format_scenario(scenario))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(make_run(LOG, 6), tmp_path_factory.mktemp("bag") / "robot.mcap")


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "robot.toml"
    return write_scenario(path, {**PLANT, **NOISE, "name": "robot"})


def test_a_bag_is_compared_with_the_robot_of_a_scenario(
    call: Call, bag: Path, scenario: Path, tmp_path: Path
) -> None:
    """A robot is identified with its intervals."""
    plot, rrd = tmp_path / "robot.png", tmp_path / "robot.rrd"
    found = call("compare", scenario, bag, "--plot", plot, "--rrd", rrd)
    words = " ".join(found.out.split())
    assert words.startswith("robot beside the scenario robot: median position error ")
    assert "errors lie within the central 95 % of" in words
    assert "is driven with the recorded commands. Each motion is simulated with 39 seeds." in words
    paths = str(bag), str(scenario)
    lines = [line for line in found.out.splitlines() if not any(one in line for one in paths)]
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    assert plot.read_bytes().startswith(b"\x89PNG")
    entities = {chunk.entity_path for chunk in RrdReader(rrd).stream()}
    assert {"/plane/recorded", "/plane/simulated", "/plane/begins"} < entities
    for of in ("/errors/position/recorded", "/errors/heading/largest_simulated", "/speed/modelled"):
        assert of in entities


def test_the_json_gives_errors_and_the_share_within_the_band(
    call: Call, bag: Path, scenario: Path
) -> None:
    answer = call("compare", bag, scenario, "--json").json
    assert (answer["reference"], answer["alignment"], answer["seeds"]) == (
        str(scenario),
        "anchored",
        39,
    )
    (run,) = answer["runs"]
    assert (run["file"], run["signals"], run["metrics"]) == (str(bag), [], [])
    assert run["overlap_s"] == pytest.approx(16.0, abs=0.2)
    assert [(one["quantity"], one["unit"], one["horizon_s"]) for one in run["errors"]] == [
        *(("position", "m", 1.0), ("heading", "rad", 1.0)),
        *(("position", "m", 5.0), ("heading", "rad", 5.0)),
    ]
    for error in run["errors"]:
        assert error["verdict"] == "as simulated"
        outside = error["above"] + error["below"]
        assert error["within_share"] == pytest.approx(1.0 - outside / error["pieces"])
        assert error["median"] <= error["largest"]


def test_without_noise_there_is_no_share(call: Call, bag: Path, tmp_path: Path) -> None:
    quiet = write_scenario(tmp_path / "quiet.TOML", PLANT)
    (run,) = call("compare", bag, quiet, "--json").json["runs"]
    assert {error["within_share"] for error in run["errors"]} == {None}
    words = call("compare", bag, quiet, "--time=log").flat
    assert "there is no band" in words
    assert words.endswith(f"Curves: turtlelog compare {bag} {quiet} --time=log --plot FILE.pdf")


def test_several_bags_have_their_rows_and_one_that_cannot_be_read_is_told(
    call: Call, bag: Path, scenario: Path, tmp_path: Path
) -> None:
    lost = tmp_path / "lost.mcap"
    found = call("compare", bag, lost, bag, scenario, "--csv")
    assert found.code == 2
    assert str(lost) in found.err
    assert len(found.out.splitlines()) == 1 + 2 * 4


def refuse(call: Call, *arguments: str | Path) -> str:
    """Return the one line with which a comparison is refused."""
    found = call("compare", *arguments)
    assert found.code == 2
    lines = [line for line in found.err.splitlines() if "error:" in line]
    assert len(lines) == 1, found.err
    assert found.out == ""
    return lines[0]


def test_what_is_no_comparison_with_a_robot_is_refused_in_one_line(
    call: Call, bag: Path, scenario: Path, tmp_path: Path
) -> None:
    turtle = write_scenario(tmp_path / "turtle.toml", {}, "textbook")
    assert "needs a bag or a recording beside the scenario" in refuse(call, scenario)
    two = refuse(call, scenario, turtle, bag)
    assert two.endswith(f"name one scenario to compare bags with, not {scenario}, {turtle}")
    needed = f'{turtle}: must be the scenario of a robot, plant.kind = "lagged", not turtlesim; '
    assert needed in refuse(call, bag, turtle)
    for option in ("--reference", "--align", "--metric", "--sort", "--where"):
        unneeded = f"{option} {bag}: leave it out, the scenario is what bags are compared with"
        assert unneeded in refuse(call, bag, scenario, option, str(bag))
    assert "--plot: needs the scenario of a robot (.toml) among the files" in refuse(
        call, bag, bag, "--plot", tmp_path / "a.png"
    )
    assert "the name must end in .pdf" in refuse(call, bag, scenario, "--plot", tmp_path / "a.gif")
    assert "--rrd: draws one bag, not 2" in refuse(
        call, bag, bag, scenario, "--rrd", tmp_path / "a.rrd"
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("speed_gain = nan", "plant.speed_gain"),
        ("not toml", "not TOML"),
        ("speed_gain = 'fast'", "plant.speed_gain"),
        ("gains = 1.0", "plant.gains"),
    ],
)
def test_a_wrong_scenario_file_is_named(
    call: Call, bag: Path, tmp_path: Path, text: str, told: str
) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(f'[plant]\nkind = "lagged"\n{text}\n')
    line = refuse(call, bag, path)
    assert str(path) in line
    assert told in line
    path.unlink()
    assert str(path) in refuse(call, bag, path)


def test_a_bag_without_commands_has_nothing_to_drive_the_robot_with(
    call: Call, scenario: Path, tmp_path: Path
) -> None:
    run = make_run(LOG, 6)
    silent = tmp_path / "silent.csv"
    rows = zip(run.poses.time_ns / 1e9, *run.poses.xy_m.T, run.poses.heading_rad, strict=True)
    lines = [",".join(f"{float(value)!r}" for value in row) for row in rows]
    silent.write_text("\n".join(["t,x,y,heading", *lines]) + "\n")
    assert "no commands to drive the simulated robot with" in refuse(call, silent, scenario)
