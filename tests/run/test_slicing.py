"""A stretch of a run is a run."""

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.display import format_path_svg
from turtlelog.errors import RunError

RUN = tl.read_recording("recordings/paper/kp10.mcap")


def test_slice_holds_what_was_recorded_between_two_times_of_the_run() -> None:
    part = RUN.slice(2, 5)
    start_ns, end_ns = RUN.start_ns + 2 * 10**9, RUN.start_ns + 5 * 10**9
    inside = (RUN.poses.time_ns >= start_ns) & (RUN.poses.time_ns <= end_ns)
    np.testing.assert_array_equal(part.poses.xy_m, RUN.poses.xy_m[inside])
    for columns in (part.samples, part.commands):
        assert start_ns <= columns.time_ns.min() <= columns.time_ns.max() <= end_ns
    read_ns = part.poses.time_ns[part.samples.pose_sequence]
    assert start_ns <= read_ns.min()
    assert part.notes["slice"] == "2 to 5 s after the first sample of its run"
    assert (part.stop_reason, part.scenario_is_complete) == (None, False)


def test_slice_to_the_end_keeps_the_stop_reason() -> None:
    assert RUN.slice(2).stop_reason == "standstill"
    assert RUN.slice(end_s=12).stop_reason is None


@pytest.mark.parametrize(
    ("start_s", "end_s", "is_complete"), [(None, None, True), (2, None, False), (None, 12, False)]
)
def test_slice_without_either_end_is_no_longer_determined_by_its_scenario(
    start_s: float | None, end_s: float | None, *, is_complete: bool
) -> None:
    assert RUN.slice(start_s, end_s).scenario_is_complete == is_complete


def test_slice_of_everything_is_the_run_itself() -> None:
    assert RUN.slice() is RUN
    assert RUN.slice(-1, RUN.duration_s) is RUN


def test_slice_has_the_line_to_the_goal_of_its_run() -> None:
    assert RUN.slice(0.5, 2).goal_line is not None
    np.testing.assert_allclose(RUN.slice(0.5, 2).goal_line.bearing_rad, RUN.goal_line.bearing_rad)  # type: ignore[union-attr]


def test_slice_holds_the_events_at_its_ends_and_none_beyond() -> None:
    dropped = [event for event in RUN.events if event.kind.endswith("_dropped")]
    at_s = 2.992
    assert {event.time_ns for event in dropped} == {RUN.start_ns + round(at_s * 1e9)}
    for start_s, end_s, events in (
        (0, at_s, dropped),
        (at_s, 9, dropped),
        (0, at_s - 1e-9, []),
        (at_s + 1e-9, 9, []),
    ):
        assert list(RUN.slice(start_s, end_s).events) == events


def test_slice_of_one_instant_holds_the_pose_there() -> None:
    at_s = (RUN.poses.time_ns[100] - RUN.start_ns) / 1e9
    np.testing.assert_array_equal(RUN.slice(at_s, at_s).poses.xy_m, RUN.poses.xy_m[100:101])
    with pytest.raises(RunError, match=r"end_s: expected start_s = .* or later"):
        RUN.slice(at_s, at_s - 1e-9)


def test_slice_survives_a_file(tmp_path: Path) -> None:
    part = RUN.slice(2, 5)
    tl.write_recording(part, tmp_path / "part.mcap")
    read = tl.read_recording(tmp_path / "part.mcap")
    np.testing.assert_array_equal(read.samples.time_ns, part.samples.time_ns)
    np.testing.assert_array_equal(read.samples.sequence, part.samples.sequence)
    assert (read.notes["slice"], read.stop_reason) == (part.notes["slice"], None)


@pytest.mark.parametrize(
    ("start_s", "end_s", "message"),
    [
        (20, 30, r"slice: expected a segment with poses, .* -0.064 to 12.608 s, found 20 to 30 s"),
        (5, 2, r"end_s: expected start_s = 5 or later, found 2"),
        (float("nan"), None, r"start_s: expected a time in s, found nan"),
        (None, float("inf"), r"end_s: expected a time in s, found inf"),
        (None, -1, r"slice: expected a segment with poses, .* found -0.064 to -1 s"),
    ],
)
def test_slice_refuses_what_is_no_stretch_of_the_run(
    start_s: float | None, end_s: float | None, message: str
) -> None:
    with pytest.raises(RunError, match=message):
        RUN.slice(start_s, end_s)


def test_run_is_one_line_in_a_console() -> None:
    assert repr(RUN) == "<Run paper-kp10: 770 samples, 12.6 s, standstill>"
    bare = tl.Run(
        name="bag",
        source="test",
        poses=RUN.poses,
        commands=RUN.commands,
        samples=dataclasses.replace(RUN.slice(0, 0.001).samples),
        declaration=RUN.declaration,
        stop_reason="\x1b[31m\nred",
    )
    assert "\n" not in repr(bare)
    assert "\x1b" not in repr(bare)
    for columns in (RUN.poses, RUN.commands, RUN.samples):
        assert repr(columns).startswith(
            f"<{type(columns).__name__}: {len(columns)} rows of time_ns"
        )


def test_run_is_a_table_in_a_notebook() -> None:
    html = dataclasses.replace(RUN, name="<b>bold</b>")._repr_html_()
    assert "<b>bold" not in html
    assert "&lt;b&gt;bold" in html
    for text in ("(2, 10) m", "12.6 s", "standstill", "770 samples", "rotate 2.992 s"):
        assert text in html


def test_run_has_a_picture_of_its_path_in_a_notebook() -> None:
    (drawn,) = [line for line in RUN._repr_html_().splitlines() if line.startswith("<svg")]
    svg = ElementTree.fromstring(drawn)
    line, start, end, goal = svg
    points = np.array(
        [[float(part) for part in pair.split(",")] for pair in line.get("points", "").split()]
    )
    assert [float(end.get(name, "")) for name in ("cx", "cy")] == points[-1].tolist()
    assert [float(start.get(name, "")) + 4.0 for name in "xy"] == points[0].tolist()
    assert goal.get("d", "").startswith("M")
    # Along the path x falls and y rises by 3.5 and 4.5 m, and the picture points downward.
    across, down = points[-1] - points[0]
    way_m = RUN.poses.xy_m[-1] - RUN.poses.xy_m[0]
    assert across / way_m[0] == pytest.approx(-down / way_m[1], rel=1e-3)
    assert points.min() >= 0.0
    assert points.max() <= 220.0


@pytest.mark.parametrize(("way_m", "is_drawn"), [(0.0203, False), (0.0205, True), (0.0, False)])
def test_a_way_that_the_marks_would_cover_has_no_picture(way_m: float, *, is_drawn: bool) -> None:
    path_m = np.array([[1.0, 2.0], [1.0 + way_m, 2.0]])
    assert bool(format_path_svg(path_m, None)) == is_drawn
    assert format_path_svg(path_m, (5.0, 2.0))


@pytest.mark.parametrize(
    ("stop_reason", "text"), [("standstill", "standstill"), (None, "its end is not recorded")]
)
def test_the_answer_of_a_run_says_why_it_stopped_or_that_nobody_knows(
    stop_reason: str | None, text: str
) -> None:
    html = dataclasses.replace(RUN, stop_reason=stop_reason)._repr_html_()
    (answer,) = [line for line in html.splitlines() if line.startswith("<p><strong>")]
    assert f"after 12.6 s, {text}.<" in answer
