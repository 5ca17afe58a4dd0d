from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.identify.robots import Log, Truth, make_run, write_bag
from tests.log.ros2.bags import make_poses, write_mcap
from tests.log.runs import find_shared

LOG = Log(
    speed=Truth(gain=0.9, dead_time_s=0.08, lag_s=0.12),
    turn_rate=Truth(gain=0.95, dead_time_s=0.06, lag_s=0.1),
    duration_s=20.0,
    poses_hz=20.0,
    commands_hz=10.0,
)
"""A robot of known truth."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(make_run(LOG, 6), tmp_path_factory.mktemp("bag") / "robot.mcap")


def test_a_robot_becomes_a_scenario_that_every_command_reads(
    call: Call, bag: Path, tmp_path: Path
) -> None:
    target = tmp_path / "robot.toml"
    out = call("identify", bag, "--scenario", target).out
    assert f"Comments in {target} give the source of each number." in " ".join(out.split())
    assert f"Next: turtlelog theory {target}" in out
    text = " ".join(call("identify", bag, "--scenario", target, "--details").out.split())
    assert f"The scenario {target}: - Gains, dead times and time constants are those that" in text
    assert "The robot never stands for long with commands of 0" in text
    plant = tl.load_scenario(target).plant
    assert plant.speed_dead_time_s == pytest.approx(0.08, abs=0.01)
    assert plant.turn_gain == pytest.approx(0.95, abs=0.01)
    loops = call("theory", target, "--json").json["loops"]
    assert [loop["status"] for loop in loops] == ["ok", "ok"]
    assert {one["controller"] for loop in loops for one in loop["recommended"]} == {"P", "PI", "PD"}
    answer = call("run", target, "--set", "law.kp_linear=2", "--law", "sequential-pid", "--json")
    assert answer.code == 0
    law = Path(__file__).parents[2] / "examples" / "laws" / "p.py"
    assert call("run", target, "--law", f"{law}:P").code == 0


@pytest.mark.thorough
def test_the_answer_in_json_names_the_file_and_has_the_notes(
    call: Call, bag: Path, tmp_path: Path
) -> None:
    target = tmp_path / "robot.toml"
    target.write_text("what stood there before", encoding="utf-8")
    told = call("identify", bag, "--scenario", target, "--json").json["scenario"]
    assert told["file"] == str(target)
    first = target.read_text("utf-8")
    assert told["notes"][1].startswith("Poses come every 50 ms, commands every 10")
    assert call("identify", bag, "--json").json["scenario"] is None
    call("identify", bag, "--scenario", target)
    assert target.read_text("utf-8") == first


def test_what_is_no_robot_is_one_line_and_no_file(call: Call, tmp_path: Path) -> None:
    poses = write_mcap(tmp_path / "poses.mcap", make_poses())
    turtle = tmp_path / "turtle.mcap"
    call("run", "paper-kp4", "-o", turtle)
    target = tmp_path / "robot.toml"
    for file, expected in (
        (poses, "speed: not identifiable: no commands were recorded; to know it, record the"),
        (turtle, "found turtlesim, whose plant is that of the preset textbook; `turtlelog explain"),
    ):
        answer = call("identify", file, "--scenario", target)
        assert (answer.code, answer.out) == (2, "")
        assert expected in answer.err.splitlines()[-1]
        assert not target.exists()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("robot.txt", "the name must end in .toml"),
        ("missing/robot.toml", "there is no such folder to write to"),
    ],
)
def test_a_target_that_cannot_be_written_is_refused(
    call: Call, bag: Path, tmp_path: Path, name: str, expected: str
) -> None:
    answer = call("identify", bag, "--scenario", tmp_path / name)
    assert answer.code == 2
    assert expected in answer.err


@pytest.mark.thorough
def test_a_real_robot_becomes_a_scenario(call: Call, tmp_path: Path) -> None:
    target = tmp_path / "robot.toml"
    call("identify", find_shared("robots/tb3"), "--scenario", target)
    found = tl.load_scenario(target)
    assert found.plant.turn_gain == pytest.approx(0.908, abs=0.02)
    assert found.loop.period_s == pytest.approx(0.101, abs=1e-3)
    # Its wheels count nothing while it stands: jitter of the stamps is no noise of poses.
    assert found.sensing.noise_position_m < 2e-5
    assert found.sensing.noise_heading_rad == 0.0
    # That its speed ends at 0.11 m/s is no noise either.
    assert 5e-4 < found.disturbance.noise_speed < 1.5e-3
    assert 3e-3 < found.disturbance.noise_turn_rate < 1.2e-2
