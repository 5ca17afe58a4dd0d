import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import cast

import pytest
from rerun.experimental import ViewerClient

from tests.draw.rerun.rrds import list_entities, make_foreign_run
from turtlelog.charts.time_plots import TIMELINE
from turtlelog.draw import ViewReport, open_viewer, write_run_rrd, write_snapshot
from turtlelog.draw.rerun import viewer
from turtlelog.draw.rerun.viewer import open_camera
from turtlelog.errors import ShowError

NO_GRAPHICS = "expected a graphics adapter"

SIZE = (1000, 700)

Take = Callable[..., tuple[ViewReport, Path]]


def take_snapshot(rrd: Path, png: Path) -> ViewReport:
    try:
        return write_snapshot(rrd, png, at_s=6.0, size=SIZE)
    except ShowError as err:
        skip_without_graphics(err)
        raise


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Take]:
    """Return what one viewer for all tells of a recording, and its picture; both are kept."""
    with ExitStack() as closing:
        try:
            camera = closing.enter_context(open_camera(size=SIZE))
        except ShowError as err:
            skip_without_graphics(err)
            raise

        @cache
        def take(
            rrd: Path, at_s: float | None = 6.0, timeline: str = TIMELINE
        ) -> tuple[ViewReport, Path]:
            png = tmp_path_factory.mktemp("picture") / "x.png"
            try:
                return camera.take(rrd, png, at_s=at_s, timeline=timeline), png
            except ShowError as err:
                skip_without_graphics(err)
                raise

        yield take


def skip_without_graphics(err: ShowError) -> None:
    if NO_GRAPHICS in str(err):
        pytest.skip(str(err))


def read_size(png: Path) -> tuple[int, int]:
    head = png.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", head[16:])
    return width, height


@pytest.mark.everyday("run_rrd", "explanation_rrd")
@pytest.mark.viewer
@pytest.mark.parametrize("scene", ["run_rrd", "comparison_rrd", "explanation_rrd", "violation_rrd"])
def test_viewer_shows_every_view_without_problems(
    scene: str, take: Take, request: pytest.FixtureRequest
) -> None:
    """Rerun's viewer draws in software; the first of these tests starts it."""
    rrd: Path = request.getfixturevalue(scene)
    report, png = take(rrd)
    assert read_size(png) == SIZE
    assert png.stat().st_size > 40_000
    kinds = {view.kind for view in report.views}
    assert kinds == {"2D", "TimeSeries", "StateTimeline", "TextDocument", "TextLog"}
    assert not [problem for view in report.views for problem in view.problems]
    assert not [text for text in report.messages if "rasterizer" not in text]
    assert set(report.entities) >= {name for name in list_entities(rrd) if "__" not in name}


@pytest.mark.viewer
def test_a_snapshot_without_a_time_is_of_the_end(run_rrd: Path, take: Take) -> None:
    """Rerun's viewer draws two pictures in software."""
    _, early = take(run_rrd)
    _, late = take(run_rrd, at_s=None)
    assert early.read_bytes() != late.read_bytes()


@pytest.mark.thorough
@pytest.mark.viewer
def test_a_picture_may_be_told_from_the_start_of_translation(
    comparison_rrd: Path, take: Take
) -> None:
    """Rerun's viewer draws two pictures in software."""
    _, aligned = take(comparison_rrd)
    _, translating = take(comparison_rrd, timeline="translate_time")
    assert translating.read_bytes() != aligned.read_bytes()


@pytest.mark.thorough
@pytest.mark.viewer
def test_one_picture_after_the_other_is_as_that_of_a_viewer_of_its_own(
    run_rrd: Path, comparison_rrd: Path, take: Take, tmp_path: Path
) -> None:
    """Rerun's viewer starts once more, for itself."""
    take(comparison_rrd)
    alone = take_snapshot(run_rrd, tmp_path / "x.png")
    assert alone.views == take(run_rrd)[0].views


@pytest.mark.thorough
@pytest.mark.viewer
def test_a_timeline_that_a_recording_lacks_is_named(
    run_rrd: Path, take: Take, tmp_path: Path
) -> None:
    """Rerun's viewer loads a recording."""
    take(run_rrd)  # skips where nothing can be drawn
    with pytest.raises(ShowError, match="expected sim_time, found translate_time"):
        write_snapshot(run_rrd, tmp_path / "y.png", timeline="translate_time", size=(400, 300))
    assert not (tmp_path / "y.png").exists()


def test_a_missing_recording_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match=r"none\.rrd: expected a recording, found no such file"):
        write_snapshot(tmp_path / "none.rrd", tmp_path / "x.png")


@pytest.mark.viewer
def test_a_damaged_recording_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "bad.rrd").write_bytes(b"no recording")
    with pytest.raises(ShowError, match=r"bad\.rrd: expected a recording, found") as caught:
        take_snapshot(tmp_path / "bad.rrd", tmp_path / "x.png")
    assert "\n" not in str(caught.value)


# Without a driver the viewer answers before it dies.
@pytest.mark.viewer
@pytest.mark.parametrize(
    "missing",
    [
        {"WGPU_BACKEND": "none"},
        {"VK_DRIVER_FILES": "/nonexistent", "VK_ICD_FILENAMES": "/nonexistent"},
    ],
    ids=["backend", "driver"],
)
def test_a_viewer_that_cannot_draw_names_the_packages(
    missing: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run_rrd(make_foreign_run(2), tmp_path / "run.rrd")
    for name, value in missing.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ShowError, match="apt-get install mesa-vulkan-drivers") as caught:
        write_snapshot(tmp_path / "run.rrd", tmp_path / "x.png")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "x.png").exists()


class SlowClient:
    """Draws its first picture too slowly."""

    def __init__(self, found: str) -> None:
        self.found = [found]

    def take_screenshot(self) -> bytes:
        if self.found:
            raise ConnectionError(self.found.pop())
        return b"a picture"


def test_a_picture_that_takes_longer_than_rerun_waits_is_waited_for() -> None:
    client = SlowClient("Deadline expired before operation could complete")
    assert viewer._take_picture(cast("ViewerClient", client)) == b"a picture"
    with pytest.raises(ConnectionError, match="transport error"):
        viewer._take_picture(cast("ViewerClient", SlowClient("transport error")))


@pytest.mark.viewer
def test_a_viewer_ends_with_its_block() -> None:
    with viewer.start_viewer(["--serve-grpc", "--port", "auto"]) as process:
        assert not process.has_ended
    assert process.has_ended


@pytest.mark.viewer
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="other systems have a display")
def test_no_display_is_one_line_that_names_the_alternatives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run_rrd(make_foreign_run(2), tmp_path / "run.rrd")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ShowError, match=r"window failed .*--snapshot") as caught:
        open_viewer([tmp_path / "run.rrd"])
    assert "\n" not in str(caught.value)


def test_nothing_to_open_is_an_error() -> None:
    with pytest.raises(ShowError, match="viewer: no recording to open"):
        open_viewer([])
