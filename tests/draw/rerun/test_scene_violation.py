from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.draw.rerun.headless import start_headless
from tests.draw.rerun.rrds import (
    list_entities,
    read_blueprint,
    read_blueprint_parts,
    read_layout,
    read_rows,
    read_static,
    read_times,
    simulate_preset,
    verify,
)
from turtlelog.charts.curve_marks import ViolatedSignal, ViolationMoment
from turtlelog.charts.curves import read_curve
from turtlelog.draw import write_run_rrd, write_violation_rrd
from turtlelog.measure import read_signal

RUN = simulate_preset("paper-kp10")
AT_S = 3.2
AT_NS = 3_200_000_000


def test_the_mark_is_where_the_turtle_was(violation_rrd: Path) -> None:
    verify(violation_rrd)
    (place,) = read_static(violation_rrd, "/plane/violation", "Points2D:positions")
    row = int(np.searchsorted(RUN.poses.time_ns, RUN.start_ns + AT_NS, side="right")) - 1
    np.testing.assert_array_equal(place, RUN.poses.xy_m[row])
    labels = read_static(violation_rrd, "/plane/violation", "Points2D:labels")
    assert labels == ["speed <= 0.5"]


def test_the_layout_holds_the_cursor_at_the_violation(violation_rrd: Path) -> None:
    panel = read_blueprint(violation_rrd, "/time_panel")
    assert panel["TimePanelBlueprint:timeline"] == ["sim_time"]
    (selection,) = panel["TimePanelBlueprint:time_selection"]
    assert selection == {"min": AT_NS, "max": AT_NS}


@pytest.mark.thorough
@pytest.mark.viewer
def test_the_viewer_opens_at_the_violation(violation_rrd: Path) -> None:
    """Rerun's viewer starts and draws in software."""
    with start_headless() as viewer:
        viewer.open(violation_rrd)
        viewer.wait_for_time(AT_NS)
        assert "/plane/violation" in viewer.list_entities()


def test_the_violation_is_an_event_among_the_others(violation_rrd: Path) -> None:
    texts = [row[0] for row in read_rows(violation_rrd, "/events", "TextLog:text")]
    times_ns = read_times(violation_rrd, "/events").tolist()
    assert times_ns == sorted(times_ns)
    assert texts[times_ns.index(AT_NS)] == "Violation: speed <= 0.5"
    assert len(texts) == len(RUN.events) + 1
    assert AT_NS in read_times(violation_rrd, "/speed/lines/event")


def test_the_message_is_the_first_document(violation_rrd: Path) -> None:
    (text,) = read_static(violation_rrd, "/documents/Violation", "TextDocument:text")
    assert text == "```\nspeed <= 0.5: found 1 m/s\n```"


def test_all_else_is_as_in_the_recording_of_the_run(violation_rrd: Path, tmp_path: Path) -> None:
    write_run_rrd(RUN, tmp_path / "run.rrd")
    more = {"/plane/violation", "/documents/Violation"}
    assert list_entities(violation_rrd) == list_entities(tmp_path / "run.rrd") | more


@pytest.mark.parametrize("at_s", [-1.0, 0.0, 1e6])
def test_a_violation_beyond_the_run_is_marked_at_its_end(at_s: float, tmp_path: Path) -> None:
    path = tmp_path / "x.rrd"
    write_violation_rrd(RUN, path, at_s=at_s, title="t", message="m")
    (place,) = read_static(path, "/plane/violation", "Points2D:positions")
    expected = RUN.poses.xy_m[-1 if at_s > 1.0 else 0]
    np.testing.assert_allclose(place, expected, atol=1e-6)


@pytest.fixture(scope="module")
def band_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A view of a cross-track that leaves a band of 0.05 m."""
    path = tmp_path_factory.mktemp("band") / "band.rrd"
    write_violation_rrd(
        RUN, path, at_s=5.664, title="track", message="m", violated=violate_track(0.05)
    )
    return path


def violate_track(limit: float, word: str = "worst") -> ViolatedSignal:
    curve = read_curve(RUN, "cross_track")
    assert curve is not None
    ends = np.full(len(curve.values), limit)
    outside = np.abs(curve.values) > limit
    return ViolatedSignal(
        name="cross_track",
        unit="m",
        curve=curve,
        low=-ends,
        high=ends,
        outside=outside,
        first=ViolationMoment(time_s=5.664, value=-0.05008),
        worst=ViolationMoment(time_s=8.784, value=-0.10774),
        worst_word=word,
        check="track",
    )


def test_the_violated_signal_stands_on_top_with_limits_and_what_is_outside(band_rrd: Path) -> None:
    verify(band_rrd)
    title = "cross_track [m]: worst -0.10774 m at 8.784 s, 0.0577 m outside; violates track"
    assert read_layout(band_rrd)[title] == ["/violated/**"]
    track = read_signal(RUN, "cross_track")
    red = np.array(read_rows(band_rrd, "/violated/outside", "Scalars:scalars"))[:, 0]
    shown = np.array(read_rows(band_rrd, "/violated/curve", "Scalars:scalars"))[:, 0]
    np.testing.assert_array_equal(shown, track.values)
    np.testing.assert_array_equal(red, np.where(np.abs(shown) > 0.05, shown, np.nan))
    limits = {
        side: {row[0] for row in read_rows(band_rrd, f"/violated/limit_{side}", "Scalars:scalars")}
        for side in ("low", "high")
    }
    assert limits == {"low": {-0.05}, "high": {0.05}}


def test_in_the_plane_a_mark_is_no_wider_than_half_of_it(band_rrd: Path, tmp_path: Path) -> None:
    assert read_static(band_rrd, "/plane/violation", "Points2D:labels") == ["first violated"]
    for length, shown in ((28, "t" * 28), (29, "t" * 25 + "...")):
        path = tmp_path / f"{length}.rrd"
        write_violation_rrd(RUN, path, at_s=1.0, title="t" * length, message="m")
        assert read_static(path, "/plane/violation", "Points2D:labels") == [shown]


def test_of_what_was_waited_for_the_way_there_does_not_hide_how_near_it_came(
    tmp_path: Path,
) -> None:
    waited = violate_track(0.05, "nearest")
    nearest = ViolationMoment(time_s=5.664, value=-0.051)
    waited = replace(waited, outside=np.ones_like(waited.outside), worst=nearest)
    path = tmp_path / "x.rrd"
    far = replace(waited.curve, values=waited.curve.values - 1.0)
    write_violation_rrd(
        RUN, path, at_s=1.0, title="t", message="m", violated=replace(waited, curve=far)
    )
    assert any(name.startswith("cross_track [m], close up") for name in read_layout(path))


def test_the_first_and_the_worst_moment_are_named_with_value_and_time(band_rrd: Path) -> None:
    names = [
        read_static(band_rrd, f"/violated/points/{part}", "SeriesPoints:names")
        for part in ("first", "worst")
    ]
    assert names == [
        ["first violated -0.05008 m at 5.664 s"],
        ["worst -0.10774 m at 8.784 s"],
    ]
    times_ns = [read_times(band_rrd, f"/violated/points/{p}")[0] for p in ("first", "worst")]
    assert times_ns == [5_664_000_000, 8_784_000_000]


def test_the_legend_stands_beside_the_plot_with_the_signs_of_its_marks(band_rrd: Path) -> None:
    (text,) = read_static(band_rrd, "/documents/Legend", "TextDocument:text")
    assert text.replace("\\", "").split("  \n") == [
        "◆ worst -0.10774 m at 8.784 s, 0.0577 m outside",
        "● first violated -0.05008 m at 5.664 s",
        "▲ limit 0.05 m",
        "▼ limit -0.05 m",
        "grey: allowed",
        "blue: cross_track",
        "red: outside",
    ]
    (band,) = read_static(band_rrd, "/violated/band", "SeriesLines:colors")
    assert len({band >> 24, band >> 16 & 255, band >> 8 & 255}) == 1  # as the legend says: grey
    shapes = {}
    for part in ("worst", "first", "limit_high", "limit_low"):
        entity = f"/violated/points/{part}"
        (shapes[part],) = read_static(band_rrd, entity, "SeriesPoints:markers")
    assert len({*shapes.values()}) == 4
    for side, limit in (("high", 0.05), ("low", -0.05)):
        entity = f"/violated/points/limit_{side}"
        assert read_rows(band_rrd, entity, "Scalars:scalars") == [[limit]]
    visible = read_blueprint_parts(band_rrd, "PlotLegend:visible")
    assert visible
    assert not any(visible)


@pytest.mark.parametrize(("letters", "is_cut"), [(110, False), (111, True)])
def test_a_title_has_110_letters_at_most(letters: int, *, is_cut: bool, tmp_path: Path) -> None:
    head = "cross_track [m]: worst -0.10774 m at 8.784 s, 0.0577 m outside; violates "
    violated = replace(violate_track(0.05), expected="e" * (letters - len(head)))
    path = tmp_path / "x.rrd"
    write_violation_rrd(RUN, path, at_s=1.0, title="t", message="m", violated=violated)
    (title,) = [name for name in read_layout(path) if name.startswith("cross_track")]
    assert (title.endswith("..."), len(title) == letters) == (is_cut, not is_cut)


def test_an_open_or_undecided_band_has_no_mark_where_it_has_no_limit(tmp_path: Path) -> None:
    track = violate_track(0.05)
    nowhere = np.full(len(track.curve.values), np.nan)
    path = tmp_path / "x.rrd"
    violated = replace(track, low=None, high=nowhere)
    write_violation_rrd(RUN, path, at_s=1.0, title="t", message="m", violated=violated)
    assert not {f"/violated/points/limit_{s}" for s in ("low", "high")} & list_entities(path)
    title = "cross_track [m]: worst -0.10774 m at 8.784 s; violates track"
    assert title in read_layout(path)


@pytest.mark.parametrize(
    ("value", "told"), [(-0.10774, "0.0577 m"), (0.0512, "0.0012 m"), (0.05, ""), (-0.0499, "")]
)
def test_how_far_outside_is_counted_from_the_nearer_end(value: float, told: str) -> None:
    moment = ViolationMoment(time_s=8.784, value=value)
    assert violate_track(0.05).describe_outside(moment) == told


def test_arrows_that_no_title_names_are_not_drawn(band_rrd: Path, run_rrd: Path) -> None:
    hidden = {"- /plane/error/**", "- /plane/turtle/command/**"}
    assert hidden <= set(read_layout(band_rrd)["Plane"])
    named = read_layout(run_rrd)["Plane (pink: to the goal, yellow: command)"]
    assert not hidden & set(named)


def test_the_plane_shows_where_the_turtle_was_outside(band_rrd: Path, tmp_path: Path) -> None:
    (strip,) = read_static(band_rrd, "/plane/violated", "LineStrips2D:strips")
    outside = violate_track(0.05).outside
    np.testing.assert_allclose(strip, RUN.poses.xy_m[outside], atol=1e-6)
    path = tmp_path / "x.rrd"
    waited = violate_track(0.05, "nearest")
    write_violation_rrd(RUN, path, at_s=1.0, title="t", message="m", violated=waited)
    assert "/plane/violated" not in list_entities(path)


@pytest.mark.parametrize(("span", "is_close_up"), [(3.99, False), (4.01, True)])
def test_a_curve_that_would_hide_the_violation_is_shown_close_up(
    span: float, *, is_close_up: bool, tmp_path: Path
) -> None:
    track = violate_track(0.05)
    near = 0.05 - float(track.curve.values.min())  # from the upper limit to the worst
    values = track.curve.values.copy()
    values[0] = 0.05 + (span - 1.0) * near
    far = replace(track, curve=replace(track.curve, values=values))
    path = tmp_path / "x.rrd"
    write_violation_rrd(RUN, path, at_s=1.0, title="t", message="m", violated=far)
    titles = [name for name in read_layout(path) if name.startswith("cross_track [m], close up")]
    assert bool(titles) is is_close_up
