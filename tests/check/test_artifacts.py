"""The files of a failed check show what failed, where it did."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import turtlelog as tl
from tests.check.artifact_files import read_mark
from tests.check.recordings import simulate
from turtlelog.check import CheckResult, Verdict
from turtlelog.check.failure_report import (
    Artifacts,
    describe_failure,
    describe_results,
    tabulate_surroundings,
)
from turtlelog.draw import write_violation_rrd
from turtlelog.draw.rerun.viewer import open_camera

NO_GRAPHICS = "expected a graphics adapter"


def fail(run: tl.Run, holds: str = "always(abs(cross_track) <= 0.005)") -> CheckResult:
    spec = tl.parse_spec({"checks": {"track": {"holds": holds}}})
    (result,) = tl.check_runs(spec, [(f"{run.name}.mcap", run)])
    assert result.verdict is Verdict.FAIL
    return result


def write_blind(
    run: tl.Run, result: CheckResult, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> Artifacts:
    """Write artifacts where no viewer can run."""
    for variable in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(variable, "/none")
    with tl.check.ArtifactWriter(folder) as writer:
        return writer.write(run, result)


def test_the_view_opens_at_the_violation_and_marks_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = simulate("paper-kp10")
    result = fail(run)
    rrd, mcap = write_blind(run, result, tmp_path, monkeypatch).files
    at_s = result.first_violation_s
    assert at_s is not None
    mark = read_mark(rrd)
    assert (mark.cursor_s, mark.label) == ((at_s, at_s), "first violated")
    row = run.poses.time_ns.searchsorted(run.start_ns + round(at_s * 1e9), side="right") - 1
    assert mark.xy_m == pytest.approx(run.poses.xy_m[row], abs=1e-6)
    told = [*describe_results(run, result), f"  recording       {result.file}"]
    assert mark.message.splitlines()[1:-1] == told
    assert set(told) < set(describe_failure(run, result))
    cut = tl.read_recording(mcap)
    around = np.abs((run.poses.time_ns - run.start_ns) / 1e9 - at_s) <= 1.0
    np.testing.assert_array_equal(cut.poses.time_ns, run.poses.time_ns[around])
    np.testing.assert_array_equal(cut.poses.xy_m, run.poses.xy_m[around])
    read_ns = run.poses.time_ns[run.samples.pose_sequence]
    kept = np.isin(read_ns, cut.poses.time_ns) & np.isin(run.samples.time_ns, cut.poses.time_ns)
    np.testing.assert_array_equal(cut.samples.sequence, run.samples.sequence[kept])


@pytest.mark.parametrize(
    ("at_s", "times"),
    [
        (0.991, ["0.944", "0.960", ">0.976", "0.992", "1.008"]),
        (0.992, ["0.960", "0.976", ">0.992", "1.008", "1.024"]),
        (12.608, ["12.576", "12.592", ">12.608"]),
    ],
)
def test_two_poses_stand_on_either_side_of_the_one_that_holds(
    at_s: float, times: list[str]
) -> None:
    _, *lines = tabulate_surroundings(simulate("paper-kp10"), ["heading"], at_s)
    assert [line.rpartition(" ")[0].replace(" ", "") for line in lines] == times


def test_where_no_viewer_can_run_there_is_no_picture_and_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = write_blind(simulate(), fail(simulate()), tmp_path, monkeypatch)
    assert [path.suffix for path in found.files] == [".rrd", ".mcap"]
    assert NO_GRAPHICS in found.notes[0]


@pytest.mark.thorough
def test_one_viewer_shows_every_recording_in_its_own_layout(tmp_path: Path) -> None:
    """Rerun's viewer starts and draws two pictures in software."""
    runs = [simulate("paper-kp10"), simulate()]
    names, pictures = [], []
    try:
        with open_camera(size=(1000, 700)) as camera:
            for run in runs:
                rrd, png = tmp_path / f"{run.name}.rrd", tmp_path / f"{run.name}.png"
                write_violation_rrd(run, rrd, at_s=3.0, title="track", message="track")
                report = camera.take(rrd, png, at_s=3.0)
                names.append([view.name for view in report.views if "At the goal" in view.name])
                pictures.append(imread(png))
    except tl.TurtlelogError as err:
        if NO_GRAPHICS in str(err):
            pytest.skip(str(err))
        raise
    assert all(picture.std() > 0.05 for picture in pictures)
    assert (pictures[0] != pictures[1]).any()
    assert names[0] != names[1]
    assert not [text for text in report.messages if "rasterizer" not in text]


def test_a_violation_of_no_moment_shows_the_end_and_keeps_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = simulate()
    result = CheckResult(file="a.mcap", check="b/c: d", verdict=Verdict.FAIL, reason="none")
    rrd, mcap = write_blind(run, result, tmp_path, monkeypatch).files
    end_s = (run.end_ns - run.start_ns) / 1e9
    assert read_mark(rrd).cursor_s == (end_s, end_s)
    assert len(tl.read_recording(mcap).poses) == len(run.poses)
    assert rrd.name.startswith("a-b-c-d-")


def test_tests_of_one_name_have_files_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from turtlelog.check.failure_report import name_files

    result = fail(simulate())
    names = {name_files(result, f"tests/{part}.py::test_it[paper-kp4]") for part in "ab"}
    assert len(names) == 2
    assert all(name.startswith("test_it-paper-kp4-track-") for name in names)
