"""A running loop in the widget of a notebook: its page gets the ticks while the cell still runs."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

import turtlelog as tl
from tests.draw.rerun.rrds import list_entities, read_times
from tests.fresh_process import run_code
from tests.notebook_kernel import Cell, Notebook, start_notebook
from turtlelog.errors import ShowError

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("rerun_notebook") is None, reason="the extra notebook is not installed"
)

SHORT = {"max_duration_s": 4.0}
CELL = f"""
import turtlelog as tl
scenario = tl.override_scenario(tl.load_scenario("paper-kp4"), {SHORT})
run = tl.simulate.run_live(scenario, [tl.draw.LiveViewer(scenario, size=(700, 400))], realtime=True)
print(run.end_ns)
"""


@pytest.fixture(scope="module")
def notebook() -> Iterator[Notebook]:
    with start_notebook() as started:
        yield started


def write_sent(cell: Cell, folder: Path) -> list[Path]:
    """Write each message that holds a recording, beside a layout, to a file."""
    parts = []
    for number, (_, content, buffers) in enumerate(cell.sent):
        assert content == {"type": "rrd"}
        part = folder / f"sent-{number}.rrd"
        part.write_bytes(b"".join(buffers))
        if RrdReader(part).recordings():
            parts.append(part)
    return parts


@pytest.mark.realtime
def test_the_page_gets_the_run_bit_by_bit_while_the_cell_runs(
    notebook: Notebook, tmp_path: Path
) -> None:
    """Starts a kernel and simulates four seconds by the clock: 10 s."""
    cell = notebook.run_cell(CELL)
    assert cell.error == ""
    run = tl.simulate_run("paper-kp4", changes=SHORT)
    assert cell.printed.splitlines()[-1] == str(run.end_ns)
    times_s = [time_s for time_s, _, _ in cell.sent]
    assert 5 <= len(times_s) <= 25  # five per second, and fewer on a busy machine
    assert times_s[-1] - times_s[0] > 2.0
    file = tmp_path / "run.rrd"
    tl.write_run_rrd(run, file, size=(700, 400))
    parts = write_sent(cell, tmp_path)
    found = [list_entities(part) for part in parts]
    assert set().union(*found) == list_entities(file)
    for entity in ("/plane/turtle", "/heading_deg", "/distance", "/turn_rate/applied"):
        holding = [part for part, entities in zip(parts, found, strict=True) if entity in entities]
        assert len(holding) >= 4
        sent_ns = [int(time) for part in holding for time in read_times(part, entity)]
        assert sent_ns == [int(time) for time in read_times(file, entity)]


def test_a_page_that_opens_late_gets_the_whole_run_then(tmp_path: Path) -> None:
    """Starts a kernel of its own: 4 s."""
    with start_notebook(is_open=False) as notebook:
        notebook.run_cell(
            "from turtlelog.draw.rerun import live_viewer\nlive_viewer._READY_S = 0.1"
        )
        cell = notebook.run_cell(CELL.replace("realtime=True", "realtime=False"))
        assert (cell.error, cell.sent) == ("", [])
        assert "Timed out" in cell.printed
        late = notebook.open_pages()
    run = tl.simulate_run("paper-kp4", changes=SHORT)
    tl.write_run_rrd(run, tmp_path / "run.rrd")
    found = [list_entities(part) for part in write_sent(late, tmp_path)]
    assert set().union(*found) == list_entities(tmp_path / "run.rrd")


def test_without_the_extra_the_error_says_what_to_install(tmp_path: Path) -> None:
    """Loads everything in a process of its own: 3 s."""
    answer = run_code(
        "import sys; sys.modules['rerun_notebook'] = None",
        "import turtlelog as tl; tl.draw.LiveViewer(tl.load_scenario('paper-kp4'))",
        folder=tmp_path,
    )
    last = answer.stderr.splitlines()[-1]
    assert last.endswith("`pip install turtlelog[notebook]`")
    assert "LibraryImportError" in last


def test_outside_a_notebook_the_error_asks_for_an_address() -> None:
    with pytest.raises(ShowError, match=r"^LiveViewer: there is no notebook here .* rerun\+http"):
        tl.draw.LiveViewer(tl.load_scenario("paper-kp4"))


def test_rerun_that_is_switched_off_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rerun.is_enabled", lambda *_: False)
    with pytest.raises(ShowError, match=r"^widget: expected Rerun to be switched on"):
        tl.draw.LiveViewer(tl.load_scenario("paper-kp4"))
