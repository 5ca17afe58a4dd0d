"""What the commands say of a robot with limits, and of one that no model explains."""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Call
from tests.identify.limited_robots import Limited, turn_on_the_spot
from tests.identify.robots import Log, make_run, write_bag

LOG = Log(duration_s=25.0, noise_rad=2e-4, poses_hz=20.0, commands_hz=10.0)
BOUND = Limited(acceleration=2.5, bound=0.8)
BRAKING = Limited(lag_s=0.2, braking=0.45)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for name, truth in (("bound", BOUND), ("braking", BRAKING)):
        write_bag(turn_on_the_spot(truth, LOG, 2), folder / f"{name}.mcap")
    return folder


def test_a_note_of_the_identification_stands_before_all_advice(call: Call, tmp_path: Path) -> None:
    """A robot whose commands have one size is identified twice, for the text and for JSON."""
    time_s = np.arange(0.5, 24.0, 0.1)
    turns = np.array([1.0, -1.0, 0.0])[(time_s / 0.9).astype(int) % 3]
    run = make_run(LOG, 2, speed=(time_s, 0.0 * time_s), turn=(time_s, turns))
    bag, robot = tmp_path / "bag.mcap", tmp_path / "robot.toml"
    write_bag(run, bag)
    (note,) = call("identify", bag, "--json").json["notes"]
    assert note.startswith("All turn rate commands have the same magnitude.")
    said = " ".join(call("identify", bag, "--scenario", robot).out.split())
    assert said.index(note) < said.index("model_delay_wz")
    assert f"Note: {note}" in call("theory", robot).err
    assert call("theory", robot, "--json").json["loops"]


def test_identify_tells_limits_with_intervals(call: Call, bags: Path) -> None:
    """A robot with two limits is identified twice, for the text and for JSON."""
    text = " ".join(call("identify", bags / "bound.mcap").out.split())
    assert "Turn rate settles at 0.8 rad/s (" in text
    assert "Turn rate changes by at most 2.5" in text
    assert "within its velocity loop" in text
    assert "Doubt" not in text
    axis = call("identify", bags / "bound.mcap", "--json").json["axes"][1]
    assert axis["bound"]["low"] < 0.8 < axis["bound"]["high"]
    assert (axis["limit_acts"], axis["friction"], axis["doubts"]) == ("within_lag", None, [])


def test_a_doubt_goes_on_to_the_scenario_and_the_advice(
    call: Call, bags: Path, tmp_path: Path
) -> None:
    robot = tmp_path / "robot.toml"
    lines = call("identify", bags / "braking.mcap", "--scenario", robot).out.splitlines()
    doubt = next(row for row, line in enumerate(lines) if line.startswith("Doubt: No model"))
    nav2 = next(row for row, line in enumerate(lines) if "model_delay_wz" in line)
    assert doubt < nav2
    axis = call("identify", bags / "braking.mcap", "--json").json["axes"][1]
    assert axis["doubts"][0].startswith("No model explains the turn rate completely")
    delay_s = float(lines[nav2].split()[1])
    assert delay_s == pytest.approx(axis["total_delay_s"]["high"], abs=1e-3)
    for command in (
        ("theory", robot),
        (
            "tune",
            robot,
            "--grid",
            "law.kp_angular=1:2",
            "--minimise",
            "rotate.overshoot",
            "--evaluations",
            "2",
        ),
    ):
        assert f"Doubt: {axis['doubts'][0]}" in call(*command).err
