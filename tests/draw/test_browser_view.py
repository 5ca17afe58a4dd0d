"""A run in a notebook: Rerun's widget holds what the file does; without it there is a picture."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure
from rerun.chunk import RrdReader

import turtlelog as tl
from tests.draw.rerun.rrds import list_entities, read_rows, simulate_preset
from turtlelog.errors import ShowError

RUN = simulate_preset("paper-kp4")
CURVE = ("/heading_deg", "Scalars:scalars")

needs_widget = pytest.mark.skipif(
    importlib.util.find_spec("rerun_notebook") is None, reason="the extra notebook is not installed"
)


def write_sent(shown: Any, folder: Path) -> list[Path]:
    """Write what a widget sends to its page once that is open: the parts of its recording."""
    parts = []
    for number, (content, buffers) in enumerate(shown._viewer._event_queue):
        assert content["type"] == "rrd"
        part = folder / f"sent-{number}.rrd"
        part.write_bytes(b"".join(buffers))
        if RrdReader(part).recordings():
            parts.append(part)
    return parts


@needs_widget
def test_the_widget_holds_the_run_as_its_file_does(tmp_path: Path) -> None:
    file = tmp_path / "run.rrd"
    tl.write_run_rrd(RUN, file, size=(960, 640))
    found = {part: list_entities(part) for part in write_sent(tl.show_run(RUN), tmp_path)}
    assert set().union(*found.values()) == list_entities(file)
    entity, component = CURVE
    parts = [part for part, entities in found.items() if entity in entities]
    rows = [row for part in parts for row in read_rows(part, entity, component)]
    assert len(rows) > 400
    assert rows == read_rows(file, entity, component)


@needs_widget
def test_the_widget_has_the_size_that_is_asked_for() -> None:
    shown: Any = tl.show_run(RUN, width=700, height=400)
    assert (shown._viewer._width, shown._viewer._height) == (700, 400)


def test_without_the_extra_there_is_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    find: Callable[[str], Any] = importlib.util.find_spec
    monkeypatch.setattr(
        "turtlelog.draw.browser_view.find_spec",
        lambda name: None if name == "rerun_notebook" else find(name),
    )
    assert isinstance(tl.show_run(RUN), Figure)


@pytest.mark.parametrize("size", [{"width": 0}, {"height": -1}])
def test_a_size_below_a_pixel_is_refused_by_name(size: dict[str, int]) -> None:
    ((name, value),) = size.items()
    with pytest.raises(ShowError, match=f"^{name}: must be at least 1 pixel, not {value}$"):
        tl.show_run(RUN, **size)


@needs_widget
def test_rerun_that_is_switched_off_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rerun.is_enabled", lambda *_: False)
    with pytest.raises(ShowError, match=r"^paper-kp4: expected Rerun to be switched on"):
        tl.show_run(RUN)
