"""`turtlelog compare --ate` and `--rpe`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Call
from tests.compare.trajectories import disturb, make_trajectory, write_tum
from tests.log.ros2.bags import Said, make_vector, write_mcap
from turtlelog.compare.trajectory_errors import build_rotations
from turtlelog.run.angles import Trajectory

TRUTH = make_trajectory()
ESTIMATE = disturb(TRUTH)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    monkeypatch.chdir(tmp_path)
    truth, estimate = Path("truth.tum"), Path("estimate.tum")
    return write_tum(truth, TRUTH), write_tum(estimate, ESTIMATE)


def write_kitti(path: Path, trajectory: Trajectory) -> Path:
    matrices = np.concatenate(
        [build_rotations(trajectory.orientation_quat_wxyz), trajectory.xyz_m[:, :, None]], axis=2
    )
    np.savetxt(path, matrices.reshape(-1, 12), fmt="%.17g")
    return path


def write_euroc(path: Path, trajectory: Trajectory) -> Path:
    head = "#timestamp [ns]," + ",".join(
        [
            *(f" p_RS_R_{axis} [m]" for axis in "xyz"),
            *(f" q_RS_{axis} []" for axis in "wxyz"),
            *(f" v_RS_R_{axis} [m s^-1]" for axis in "xyz"),
        ]
    )
    rows = np.column_stack(
        [trajectory.xyz_m, trajectory.orientation_quat_wxyz, np.zeros((len(trajectory), 3))]
    )
    lines = [
        ",".join([str(time_ns), *map(repr, row)])
        for time_ns, row in zip(trajectory.time_ns.tolist(), rows.tolist(), strict=True)
    ]
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def say_poses(topic: str, trajectory: Trajectory) -> list[Said]:
    said = []
    for time_ns, xyz, (w, x, y, z) in zip(
        trajectory.time_ns.tolist(),
        trajectory.xyz_m.tolist(),
        trajectory.orientation_quat_wxyz.tolist(),
        strict=True,
    ):
        stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
        pose = {"position": make_vector(*xyz), "orientation": make_vector(x, y, z) | {"w": w}}
        values = {"header": {"stamp": stamp, "frame_id": "map"}, "pose": pose}
        kind = "geometry_msgs/msg/PoseStamped"
        # The recorder is late by a transport that varies: the stamps are the times of the poses.
        late_ns = time_ns + 5_000_000 + time_ns % 7_000_000
        said.append(Said(topic=topic, type=kind, values=values, time_ns=late_ns))
    return said


def read_rmse(answer: object) -> list[float]:
    assert isinstance(answer, dict)
    return [error["rmse"] for error in answer["runs"][0]["errors"]]


def test_the_answer_begins_with_the_absolute_error(call: Call, files: Sequence[Path]) -> None:
    found = call("compare", files[1], "--reference", files[0], "--ate", "--rpe", "1m")
    assert found.code == 0
    assert found.flat.startswith(
        "estimate.tum: absolute trajectory error 0.162 m RMSE, rotation 0.97 deg, after alignment"
        " in SE(3). Relative pose error over 1 m: "
    )
    assert "RPE position, 1 m [m]" in found.flat
    assert (
        "of 80 moments, the nearest in time; estimate.tum has 80 poses, truth.tum 120."
        in found.flat
    )
    assert max(map(len, found.out.splitlines())) <= 80


def test_formats_and_two_topics_of_a_bag_give_the_same_errors(
    call: Call, files: Sequence[Path], tmp_path: Path
) -> None:
    truth, estimate = files
    words = ("--ate", "--rpe", "20deg", "--align", "sim3", "--json")
    expected = read_rmse(call("compare", estimate, "--reference", truth, *words).json)
    euroc = write_euroc(tmp_path / "truth.csv", TRUTH)
    assert read_rmse(call("compare", estimate, "--reference", euroc, *words).json) == pytest.approx(
        expected, abs=1e-12
    )
    kitti, times = write_kitti(tmp_path / "truth.txt", TRUTH), tmp_path / "times.txt"
    times.write_text("".join(f"{time_ns / 1e9:.9f}\n" for time_ns in TRUTH.time_ns.tolist()))
    found = call("compare", estimate, "--reference", kitti, "--times", times, *words)
    assert read_rmse(found.json) == pytest.approx(expected, abs=1e-12)
    bag = write_mcap(
        tmp_path / "bag.mcap",
        sorted(
            [*say_poses("/mocap/pose", TRUTH), *say_poses("/slam/pose", ESTIMATE)],
            key=lambda said: said.time_ns,
        ),
    )
    found = call("compare", f"{bag}:/slam/pose", "--reference", f"{bag}:/mocap/pose", *words)
    assert read_rmse(found.json) == pytest.approx(expected, abs=1e-12)
    assert found.json["runs"][0]["space"] == "space"


def test_numbered_poses_are_compared_by_their_numbers(call: Call, tmp_path: Path) -> None:
    one = write_kitti(tmp_path / "one.txt", TRUTH)
    other = write_kitti(
        tmp_path / "other.txt", replace(TRUTH, xyz_m=TRUTH.xyz_m + np.array([0.0, 0.3, 0.4]))
    )
    found = call("compare", other, "--reference", one, "--ate", "--align", "none", "--json")
    assert read_rmse(found.json) == pytest.approx([0.5, 0.0], abs=1e-12)
    assert "a KITTI trajectory has no times" in call("metrics", one).err


def test_recordings_of_runs_are_compared_in_the_plane(call: Call, tmp_path: Path) -> None:
    for kp in (1, 2):
        call("run", f"paper-kp{kp}", "-o", tmp_path / f"kp{kp}.mcap")
    words = ("compare", tmp_path / "kp2.mcap", "--reference", tmp_path / "kp1.mcap", "--ate")
    found = call(*words)
    assert "heading" in found.flat
    assert "after alignment in SE(2)" in found.flat
    assert "take se2" in call(*words, "--align", "se3").err


def test_the_advised_picture_is_not_of_the_reference_itself(
    call: Call, files: Sequence[Path]
) -> None:
    truth, estimate = files
    found = call("compare", truth, estimate, "--reference", truth, "--ate")
    picture = f"Picture: turtlelog compare {estimate} --reference {truth} --ate"
    assert picture in " ".join(found.out.replace("\\\n", "").split())


def test_a_picture_of_trajectories_is_written(call: Call, files: Sequence[Path]) -> None:
    """The first figure loads matplotlib."""
    words = ("compare", files[1], "--reference", files[0], "--ate", "--plot")
    assert call(*words, "found.svg").code == 0
    text = Path("found.svg").read_text()
    for label in ("position error [m]", "rotation error [deg]", "truth.tum, reference", "z [m]"):
        assert label in text
    assert call(*words, "truth.tum").code == 2


def test_other_trajectories_are_compared_if_one_cannot_be_read(
    call: Call, files: Sequence[Path]
) -> None:
    Path("cut.tum").write_text("0 1 2 3\n")
    found = call("compare", "cut.tum", files[1], "--reference", files[0], "--ate", "--csv")
    assert found.code == 2
    assert found.err.startswith("turtlelog: error: cut.tum: expected a header")
    assert found.out.splitlines()[0].startswith("trajectory,error,unit,count,rmse")
    assert len(found.out.splitlines()) == 3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "expected a table, found no rows"),
        ("# timestamp tx ty tz qx qy qz qw\n", "no rows"),
        ("0 nan 0 0 0 0 0 1\n" * 3, "no row has a position of finite numbers and a rotation"),
        ("0 1 0 0 0 0 0 0\n", "line 1, column qw: expected a rotation of a length other than 0"),
        ("0 1e200 0 0 0 0 0 1\n", "expected positions within 1e"),
        ("1 2 3 4 5 6 7 8 9 10 11 12\n", "line 1: expected 12 numbers of a KITTI pose"),
        ("1 0 0 4 0 1 0 8 0 0 1 12\n1 0 0 4 0 1 0 x 0 0 1 12\n", "line 2, column 8: expected a n"),
        ("0 1 2 3 4 5 6\n", "found 7 columns without names"),
        ("\0\1" * 9, "no rows below the header"),
    ],
)
def test_a_file_that_is_no_trajectory_is_refused_in_one_line(
    call: Call, files: Sequence[Path], text: str, expected: str
) -> None:
    Path("other.tum").write_text(text)
    found = call("compare", "other.tum", "--reference", files[0], "--ate")
    assert found.code == 2
    assert found.err.startswith("turtlelog: error: other.tum: ")
    assert len(found.err.splitlines()) == 1
    assert expected in found.err


def test_rows_that_are_left_out_are_counted(call: Call, files: Sequence[Path]) -> None:
    truth, estimate = files
    write_tum(Path("nan.tum"), ESTIMATE, c1=(7, "nan"))
    lines = estimate.read_text().splitlines()
    lines = [*lines[40:], *lines[:40], lines[0]]
    Path("mixed.tum").write_text("\n".join(lines))
    nan = call("compare", "nan.tum", "--reference", truth, "--ate").flat
    assert "nan.tum: 1 pose without a time, a position or a rotation." in nan
    mixed = call("compare", "mixed.tum", "--reference", truth, "--ate").flat
    assert "mixed.tum: 41 poses out of order in time, sorted." in mixed
    assert "mixed.tum: 1 pose at a time that an earlier pose has, left out." in mixed


@pytest.mark.parametrize(
    ("bound", "code"), [("< 0.17 and ate.rotation.rmse < 1", 0), ("< 0.15", 1), ("< 0.161", 1)]
)
def test_errors_in_space_are_checked(
    call: Call, files: Sequence[Path], bound: str, code: int
) -> None:
    words = ("--expect", f"ate.position.rmse {bound}", "--reference", files[0])
    found = call("check", files[1], *words)
    assert found.code == code
    if code:
        assert "turtlelog compare estimate.tum --reference truth.tum --ate --plot" in found.flat


def test_a_specification_says_how_trajectories_are_compared(
    call: Call, files: Sequence[Path]
) -> None:
    text = """format = 1
reference = "truth.tum"
[trajectory]
align = "sim3"
rpe = "10frames"
[checks.drift]
expect = "ate.position.rmse < 0.05 and rpe.position.rmse < 0.06"
"""
    Path("spec.toml").write_text(text)
    assert call("check", "spec.toml", files[1]).code == 0
    for change, expected in (
        (("sim3", "sim4"), "trajectory.align: unknown name"),
        (("10frames", "ten"), "trajectory.rpe: ten: must be a length"),
        (
            ('align = "sim3"', "max_difference_s = -1"),
            "trajectory.max_difference_s: expected a time",
        ),
        (('align = "sim3"', "all_pairs = 1"), "trajectory.all_pairs: expected true or false"),
        (('align = "sim3"', "gap = 1"), "trajectory.gap: unknown"),
        (('reference = "truth.tum"', ""), "ate.position.rmse needs a trajectory that is true"),
        (("truth.tum", "other.tum"), "other.tum: no such file"),
    ):
        Path("spec.toml").write_text(text.replace(*change))
        found = call("check", "spec.toml", files[1])
        assert found.code == 2
        assert expected in found.err


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("", "--ate"),
        ('align = "none"', "--ate --align=none"),
        ('align = "sim3"\nrpe = "10frames"\nall_pairs = true', "--ate --rpe=10frames --all-pairs"),
        (
            'associate = "linear"\nmax_difference_s = 0.02',
            "--associate=linear --max-difference=0.02",
        ),
        ('time_offset_s = "start"', "--ate --time-offset=start"),
        ("time_offset_s = -0.005", "--ate --time-offset=-0.005"),
    ],
)
def test_the_advised_picture_compares_as_the_specification_does(
    call: Call, files: Sequence[Path], settings: str, words: str
) -> None:
    text = 'format = 1\nreference = "truth.tum"\n[trajectory]\n'
    expect = '\n[checks.a]\nexpect = "ate.position.rmse < 1e-9"\n'
    Path("spec.toml").write_text(f"{text}{settings}{expect}")
    found = call("check", "spec.toml", files[1], "--json")
    value = found.json["results"][0]["value"]
    advice = call("check", "spec.toml", files[1]).flat.partition("Why? turtlelog ")[2]
    typed = advice.partition(" --plot")[0]
    assert words in typed
    errors = call(*typed.split(), "--json").json["runs"][0]["errors"]
    assert errors[0]["rmse"] == pytest.approx(value, rel=1e-9)


def test_an_error_that_cannot_be_measured_is_undecided(call: Call, files: Sequence[Path]) -> None:
    write_tum(Path("late.tum"), replace(ESTIMATE, time_ns=ESTIMATE.time_ns + 10**12))
    words = ("--expect", "ate.position.rmse < 100", "--reference", files[0])
    found = call("check", "late.tum", *words)
    assert found.code == 1
    assert "their times do not overlap" in found.flat


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--ate",), "--ate: needs --reference FILE"),
        (("--rpe", "1x", "--reference", "truth.tum"), "--rpe 1x: must be a length above 0"),
        (("--times", "t.txt", "--reference", "truth.tum"), "--times: needs --ate or --rpe LENGTH"),
        (
            ("--ate", "--align", "sample", "--reference", "truth.tum"),
            "--align sample: must be none",
        ),
        (("--ate", "--time-offset", "x", "--reference", "truth.tum"), "--time-offset x: must be a"),
        (
            ("--ate", "--max-difference", "-1", "--reference", "truth.tum"),
            "--max-difference -1: must",
        ),
        (
            ("--ate", "--sort", "name", "--reference", "truth.tum"),
            "--sort: leave it out beside --ate",
        ),
    ],
)
def test_options_that_make_no_sense_are_refused(
    call: Call, files: Sequence[Path], words: Sequence[str], expected: str
) -> None:
    found = call("compare", files[1], *words)
    assert found.code == 2
    assert expected in found.err


def test_one_motion_is_one_and_an_alignment_of_rounding_is_none(
    call: Call, files: Sequence[Path]
) -> None:
    whole = 0.6 * float(np.linalg.norm(np.diff(TRUTH.xyz_m, axis=0), axis=1).sum())
    found = call("compare", files[0], "--reference", files[0], "--ate", "--rpe", f"{whole:.3f}m")
    assert ", of 1 motion." in found.flat
    assert "The alignment turns the estimate by 0 deg about the origin and moves it by 0 m." in (
        found.flat
    )


def test_a_weak_alignment_may_be_one_of_size(call: Call, files: Sequence[Path]) -> None:
    twice = write_tum(Path("twice.tum"), replace(TRUTH, xyz_m=2.0 * TRUTH.xyz_m))
    found = call("compare", twice, "--reference", files[0], "--ate").flat
    assert "The two differ in shape or size, or hardly move." in found


def test_times_of_kitti_may_have_comments(call: Call, files: Sequence[Path]) -> None:
    poses = write_kitti(Path("poses.txt"), TRUTH)
    times = Path("times.txt")
    times.write_text("# s\n" + "".join(f"{time_ns / 1e9:.9f}\n" for time_ns in TRUTH.time_ns))
    found = call("compare", poses, "--reference", files[0], "--ate", "--times", times)
    assert (found.code, found.err) == (0, "")


def test_rotations_of_zeros_are_called_absent_and_not_nan(
    call: Call, files: Sequence[Path]
) -> None:
    said = say_poses("/pose", TRUTH)
    for one in said:
        one.values["pose"]["orientation"] = make_vector() | {"w": 0.0}
    write_mcap(Path("zeros.mcap"), said)
    found = call("compare", "zeros.mcap", "--reference", files[0], "--ate")
    assert found.code == 2
    assert "no row has a position of finite numbers and a rotation" in found.err


def test_a_bag_without_times_is_refused_for_these(call: Call, files: Sequence[Path]) -> None:
    said = say_poses("/pose", TRUTH)
    for one in said:
        one.values["header"]["stamp"] = {"sec": 0, "nanosec": 0}
    write_mcap(Path("timeless.mcap"), [replace(one, time_ns=0) for one in said])
    found = call("compare", "timeless.mcap", "--reference", files[0], "--ate")
    assert found.code == 2
    assert f"topic /pose: expected times of poses, found 0 or before 1970 in all {len(said)}" in (
        found.err
    )
