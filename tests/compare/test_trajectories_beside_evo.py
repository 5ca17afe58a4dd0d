"""The figures of ATE and RPE beside those of the program evo, on trajectories made here."""

import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pytest

import turtlelog as tl
from tests.compare.trajectories import disturb, make_trajectory, write_tum
from turtlelog.compare import Delta, TrajectorySettings, compare_trajectories, parse_delta
from turtlelog.compare.trajectory_comparison import STATISTICS, AlignIn
from turtlelog.log import export_rosbag2, read_trajectory
from turtlelog.run.angles import Trajectory

_VERSION: Final = "evo==1.38.1"


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of evo's programs, in an environment of its own: its license forbids an import."""
    given = os.environ.get("TURTLELOG_EVO")
    if given:
        return Path(given)
    folder = tmp_path_factory.mktemp("evo")
    steps = (
        [sys.executable, "-m", "venv", str(folder)],
        [str(folder / "bin" / "pip"), "install", "--quiet", _VERSION],
    )
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True, timeout=600, check=False)
        if done.returncode:
            pytest.skip(f"{_VERSION} cannot be installed: {done.stderr.strip()[-200:]}")
    return folder / "bin"


def ask_evo(programs: Path, folder: Path, *words: str) -> dict[str, float]:
    results = folder / "results.zip"
    results.unlink(missing_ok=True)
    command = [
        str(programs / words[0]),
        *words[1:],
        "--no_warnings",
        "--save_results",
        str(results),
    ]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "HOME": str(folder)},
    )
    assert results.exists(), done.stdout + done.stderr
    with zipfile.ZipFile(results) as held:
        found: dict[str, float] = json.loads(held.read("stats.json"))
    return found


def _name(delta: Delta) -> str:
    return f"{delta.value:g}{delta.unit}"


_ALIGNMENTS: Final[dict[AlignIn, tuple[str, ...]]] = {
    "none": (),
    "se3": ("-a",),
    "sim3": ("-as",),
    "origin": ("--align_origin",),
}


@pytest.mark.thorough
@pytest.mark.parametrize("sync", ["nearest_time", "interpolation"])
@pytest.mark.parametrize("align", _ALIGNMENTS)
def test_errors_equal_those_of_evo(
    programs: Path, tmp_path: Path, align: AlignIn, sync: str
) -> None:
    """Each figure is one start of a program."""
    truth = make_trajectory(400)
    files = [
        write_tum(tmp_path / "truth.tum", truth),
        write_tum(tmp_path / "estimate.tum", disturb(truth, jitter_ns=20_000_000)),
    ]
    reference, estimate = map(read_trajectory, files)
    deltas: dict[str, str] = {
        "1frames": "-d 1 -u f",
        "7frames": "-d 7 -u f",
        "1m": "-d 1 -u m",
        "20deg": "-d 20 -u d",
    }
    for overlaps in (False, True):
        chosen = [name for name in deltas if "frames" in name or not overlaps]
        found = compare_trajectories(
            reference,
            estimate,
            TrajectorySettings(
                align=align,
                interpolates=sync == "interpolation",
                deltas=tuple(map(parse_delta, chosen)),
                overlaps=overlaps,
            ),
        )
        assert 50 < len(found.estimate) < len(estimate)
        words = ["tum", *map(str, files), "--sync_method", sync, *_ALIGNMENTS[align]]
        for error in found.errors[2 * overlaps :]:
            more: list[str] = []
            if error.delta is not None:
                more = [*deltas[_name(error.delta)].split(), "--pairs_from_reference"]
                more += ["--all_pairs"] * overlaps
            relation = "trans_part" if error.quantity == "position" else "angle_rad"
            theirs = ask_evo(
                programs,
                tmp_path,
                f"evo_{error.kind.replace('ate', 'ape')}",
                *words,
                "-r",
                relation,
                *more,
            )
            for name in STATISTICS:
                assert getattr(error.statistics, name) == pytest.approx(
                    theirs[name], abs=1e-9, rel=1e-9
                )


@pytest.mark.thorough
def test_alignment_in_the_plane_equals_that_of_evo_for_planar_poses(
    programs: Path, tmp_path: Path
) -> None:
    """Each figure is one start of a program."""
    truth = make_trajectory(300)
    flat: list[Trajectory] = []
    for one in (truth, disturb(truth)):
        half_rad = np.arctan2(one.orientation_quat_wxyz[:, 3], one.orientation_quat_wxyz[:, 0])
        none = np.zeros(len(one))
        turns = np.column_stack([np.cos(half_rad), none, none, np.sin(half_rad)])
        flat.append(replace(one, xyz_m=one.xyz_m * [1, 1, 0], orientation_quat_wxyz=turns))
    files = [write_tum(tmp_path / f"{one.name}.tum", one) for one in flat]
    reference, estimate = map(read_trajectory, files)
    flags: dict[AlignIn, str] = {"se2": "-a", "sim2": "-as"}
    for align, flag in flags.items():
        found = compare_trajectories(reference, estimate, TrajectorySettings(align=align))
        for error, relation in zip(found.errors, ("trans_part", "angle_rad"), strict=True):
            theirs = ask_evo(
                programs, tmp_path, "evo_ape", "tum", *map(str, files), flag, "-r", relation
            )
            assert error.statistics.rmse == pytest.approx(theirs["rmse"], abs=1e-9)


@pytest.mark.thorough
def test_evo_reads_the_odometry_of_a_converted_run(programs: Path, tmp_path: Path) -> None:
    """A program of its own reads the bag."""
    run = tl.simulate_run(tl.load_scenario("paper-kp4"))
    export_rosbag2(run, tmp_path / "bag", shares_poses=True)
    words = [programs / "evo_traj", "bag2", tmp_path / "bag", "/odom", "--save_as_tum"]
    subprocess.run(
        [*map(str, words)],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        timeout=120,
        env={**os.environ, "HOME": str(tmp_path)},
    )
    (file,) = tmp_path.glob("*.tum")
    found = read_trajectory(file)
    assert found.time_ns.tolist() == run.poses.time_ns.tolist()
    assert np.abs(found.xyz_m[:, :2] - run.poses.xy_m).max() < 1e-9
