"""What one does in a notebook: tasks of at most six lines, with no file where none is asked for."""

import importlib.util
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import turtlelog as tl
from tests.notebook_kernel import start_notebook

MOST_LINES: Final = 6
BAG: Final = str(Path("recordings/paper/kp10.mcap").resolve())
GIVEN: Final = f"""
import numpy as np
import turtlelog as tl
BAG = {BAG!r}
run = tl.read_recording(BAG)
"""

Check = Callable[[dict[str, Any]], bool]

TASKS: Final[dict[str, tuple[str, Check]]] = {
    "read a bag": ("bag = tl.read_bag(BAG)", lambda a: len(a["bag"].poses) == 793),
    "a signal as array and series": (
        """
heading = tl.read_signal(run, "heading")
array = np.asarray(heading)
series = heading.to_pandas()
""",
        lambda a: (
            a["array"].tolist() == a["series"].tolist() and a["series"].index.name == "time_s"
        ),
    ),
    "poses as pandas, polars, Arrow, xarray": (
        """
import polars as pl
frame = run.to_pandas()
lazy = pl.DataFrame(run)
arrow = run.to_arrow()
labelled = run.to_xarray()
""",
        lambda a: (
            {len(a["frame"]), len(a["lazy"]), a["arrow"].num_rows, a["labelled"].sizes["time_s"]}
            == {793}
        ),
    ),
    "all metrics as a table": (
        "frame = tl.measure_run(run).to_pandas()",
        lambda a: isinstance(a["frame"], pd.DataFrame) and len(a["frame"]) == 135,
    ),
    "one metric in an assert": (
        """
metrics = tl.measure_run(run)
assert metrics["final.position_error"] < 0.2
""",
        lambda a: 0.1 < float(a["metrics"]["final.position_error"]) < 0.2,
    ),
    "heading of four runs": (
        """
runs = [tl.simulate_run(f"paper-kp{kp}") for kp in (1, 2, 4, 10)]
figure = tl.draw_figure("heading", runs)
""",
        lambda a: a["figure"]._repr_png_()[0].startswith(b"\x89PNG"),
    ),
    "a simulation with own gains": (
        'mine = tl.simulate_run("paper", changes={"law.kp_linear": 3.0, "law.kp_angular": 2.0})',
        lambda a: a["mine"].parameters["law.kp_linear"] == 3.0,
    ),
    "a law that is a function": (
        """
def turn(time_ns, pose, goal):
    return 0.0, 2.0 * (1.0 - pose.heading_rad)
mine = tl.simulate_run("textbook", law=turn, changes={"max_duration_s": 5.0})
""",
        lambda a: abs(a["mine"].poses.heading_rad[-1] - 1.0) < 1e-3,
    ),
    "a law that is a class": (
        """
class Turn:
    def step(self, time_ns, pose):
        return 0.0, 2.0 * (1.0 - pose.heading_rad)
mine = tl.simulate_run("textbook", law=Turn, changes={"max_duration_s": 5.0})
""",
        lambda a: abs(a["mine"].poses.heading_rad[-1] - 1.0) < 1e-3,
    ),
    "a sweep over two arrays": (
        """
grid = {"law.kp_linear": np.linspace(1, 4, 3), "law.kp_angular": np.array([1.0, 2.0])}
table = tl.sweep_scenario("paper", grid, metrics="run.duration")
frame = table.to_pandas()
""",
        lambda a: frame_has(a["frame"], 6),
    ),
    "its map": (
        """
grid = {"law.kp_linear": np.linspace(1, 4, 3), "law.kp_angular": np.array([1.0, 2.0])}
table = tl.sweep_scenario("paper", grid, metrics=["run.duration"])
figure = tl.draw_map(table)
""",
        lambda a: len(a["figure"].axes) >= 1,
    ),
    "tune two gains": (
        """
ranges = {"law.kp_linear": (1, 6), "law.kp_angular": (1, 6)}
best = tl.tune_scenario("textbook", ranges, minimise="run.duration", evaluations=8)
""",
        lambda a: 1.0 <= a["best"].values["law.kp_linear"] <= 6.0,
    ),
    "explain": (
        "why = tl.attribute_run(run)",
        lambda a: {one.cause for one in a["why"].contributions} >= {"queue", "pause"},
    ),
    "compare": (
        'apart = tl.compare_runs(run, tl.simulate_run("paper-kp4"))',
        lambda a: len(a["apart"].signals) > 0,
    ),
    "identify": (
        """
law = {"law.kind": "open-loop", "law.signal": "prbs"}
model = tl.identify_robot(tl.simulate_run("lagged", changes=law))
""",
        lambda a: abs(float(a["model"].turn_rate.lag_s) - 0.1) < 0.01,
    ),
    "the robot for python-control, and as a scenario": (
        """
law = {"law.kind": "open-loop", "law.signal": "prbs"}
driven = tl.simulate_run("lagged", changes=law)
model = tl.identify_robot(driven)
plant = model.turn_rate.to_control()
robot = tl.identify.build_robot_scenario(model, driven).scenario
""",
        lambda a: abs(a["plant"].dcgain() - 1.0) < 0.01 and a["robot"].plant.kind == "lagged",
    ),
    "theory's margins of an identified robot": (
        """
law = {"law.kind": "open-loop", "law.signal": "prbs"}
model = tl.identify_robot(tl.simulate_run("lagged", changes=law))
gains, process = tl.theory.PidGains(kp=2.0), model.turn_rate.to_process()
loop = tl.theory.analyse_pid_loop(gains, period_s=0.016, process=process)
""",
        lambda a: (
            a["loop"].margins.gain_margin > 1.0 and abs(a["process"].dead_time_s - 0.08) < 1e-3
        ),
    ),
    "compare with a reference": (
        """
tl.write_recording(tl.simulate_run("paper-kp10"), "new.mcap")
outcome = tl.Recording("new.mcap").matches(BAG)
""",
        lambda a: bool(a["outcome"]),
    ),
    "check an expression": (
        'result = tl.check_formula(run, "always(abs(cross_track) <= 0.5)")',
        lambda a: bool(a["result"]),
    ),
    "replay a function on recorded poses": (
        """
def stand(time_ns, pose, goal):
    return 0.0, 0.0
replay = tl.replay_law(run, law=stand)
""",
        lambda a: a["replay"].first_difference is not None and a["replay"].samples == 770,
    ),
    "replay a law on recorded poses": (
        """
law = tl.LAWS["sequential-p"](tl.load_scenario("paper-kp4").law.parameters)
replay = tl.replay_law(run, law=law)
""",
        lambda a: a["replay"].first_difference is not None,
    ),
    "write a recording, a bag, Parquet": (
        """
tl.write_recording(run, "run.mcap")
tl.log.export_rosbag2(run, "bag")
tl.log.export_parquet(run, "run.parquet")
""",
        lambda _: len(tl.read_run("run.mcap").poses) == len(tl.read_run("bag").poses) == 793,
    ),
    "a simulation in a widget": (
        'shown = tl.show_run(tl.simulate_run("paper-kp4"))',
        lambda a: hasattr(a["shown"], "display") or hasattr(a["shown"], "axes"),
    ),
    "a simulation for Rerun": (
        'tl.write_run_rrd(tl.simulate_run("paper-kp4"), "run.rrd")',
        lambda _: Path("run.rrd").stat().st_size > 1000,
    ),
}


needs_widget = pytest.mark.skipif(
    importlib.util.find_spec("rerun_notebook") is None, reason="the extra notebook is not installed"
)


def frame_has(frame: pd.DataFrame, rows: int) -> bool:
    return len(frame) == rows and bool(np.isfinite(frame["run.duration"]).all())


def do_task(name: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(GIVEN, names)
    exec(TASKS[name][0], names)
    return names


@pytest.mark.parametrize("name", TASKS)
def test_task_takes_few_lines_and_does_what_it_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draws, explains, sweeps and tunes: up to 8 s."""
    text, is_done = TASKS[name]
    assert len(text.strip().splitlines()) <= MOST_LINES
    monkeypatch.chdir(tmp_path)
    assert is_done(do_task(name))
    asks_for_files = name.startswith("write") or "Rerun" in name or "reference" in name
    assert bool([*tmp_path.iterdir()]) is asks_for_files


@pytest.mark.realtime
@needs_widget
def test_a_simulation_streams_into_a_widget_in_few_lines(tmp_path: Path) -> None:
    """Starts a kernel, and simulates two seconds by the clock: 8 s."""
    page = Path("docs/python.md").read_text("utf-8")
    [text] = re.findall(r"^```ipython\n(.*?)^```$", page, re.M | re.S)
    assert len(text.strip().splitlines()) <= MOST_LINES
    preset = 'tl.load_scenario("paper-kp4")'
    assert preset in text
    short = f'tl.override_scenario({preset}, {{"max_duration_s": 2.0}})'
    with start_notebook(folder=tmp_path) as notebook:
        cell = notebook.run_cell(text.replace(preset, short))
        assert cell.error == ""
        assert len(cell.sent) > 2
        assert notebook.run_cell("print(len(run.poses))").printed == "126\n"
    assert [*tmp_path.iterdir()] == []


def test_frames_of_three_libraries_are_the_same() -> None:
    run = tl.read_recording(BAG)
    assert pl.DataFrame(run).equals(pl.from_pandas(run.to_pandas()))
    assert pa.table(run).equals(run.to_arrow())
