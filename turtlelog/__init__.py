"""turtlelog: what did my loop really do?

Simulate the ROS 2 turtlesim robot under feedback, record, replay, measure and compare. Names load
on first use: importing the package costs neither numpy nor rerun.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from turtlelog.compare import (
        Column,
        Comparison,
        Table,
        compare_runs,
        name_runs,
        tabulate_differences,
        tabulate_metrics,
        tabulate_table1,
        tabulate_whole_runs,
    )
    from turtlelog.errors import TurtlelogError
    from turtlelog.log import RecordingInfo, import_log, read_info, read_recording, write_recording
    from turtlelog.measure import METRICS, SIGNALS, Metric, Signal, Status, measure_run, read_signal
    from turtlelog.run import Phase, Run
    from turtlelog.scenario import (
        PAPER_RUNS,
        PRESETS,
        Scenario,
        format_scenario,
        load_scenario,
        override_scenario,
        parse_assignments,
        parse_scenario,
    )
    from turtlelog.show import (
        TABLE_FORMATS,
        describe_run,
        describe_runs,
        format_table,
        open_viewer,
        write_comparison_rrd,
        write_run_rrd,
        write_snapshot,
    )
    from turtlelog.simulate import simulate_run

__version__ = "0.1.0"

_ROOMS = {
    "compare": (
        "Column",
        "Comparison",
        "Table",
        "compare_runs",
        "name_runs",
        "tabulate_differences",
        "tabulate_metrics",
        "tabulate_table1",
        "tabulate_whole_runs",
    ),
    "errors": ("TurtlelogError",),
    "log": ("RecordingInfo", "import_log", "read_info", "read_recording", "write_recording"),
    "measure": ("METRICS", "SIGNALS", "Metric", "Signal", "Status", "measure_run", "read_signal"),
    "run": ("Phase", "Run"),
    "scenario": (
        "PAPER_RUNS",
        "PRESETS",
        "Scenario",
        "format_scenario",
        "load_scenario",
        "override_scenario",
        "parse_assignments",
        "parse_scenario",
    ),
    "show": (
        "TABLE_FORMATS",
        "describe_run",
        "describe_runs",
        "format_table",
        "open_viewer",
        "write_comparison_rrd",
        "write_run_rrd",
        "write_snapshot",
    ),
    "simulate": ("simulate_run",),
}
_PLACES = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = [
    "METRICS",
    "PAPER_RUNS",
    "PRESETS",
    "SIGNALS",
    "TABLE_FORMATS",
    "Column",
    "Comparison",
    "Metric",
    "Phase",
    "RecordingInfo",
    "Run",
    "Scenario",
    "Signal",
    "Status",
    "Table",
    "TurtlelogError",
    "__version__",
    "compare_runs",
    "describe_run",
    "describe_runs",
    "format_scenario",
    "format_table",
    "import_log",
    "load_scenario",
    "measure_run",
    "name_runs",
    "open_viewer",
    "override_scenario",
    "parse_assignments",
    "parse_scenario",
    "read_info",
    "read_recording",
    "read_signal",
    "simulate_run",
    "tabulate_differences",
    "tabulate_metrics",
    "tabulate_table1",
    "tabulate_whole_runs",
    "write_comparison_rrd",
    "write_recording",
    "write_run_rrd",
    "write_snapshot",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'turtlelog' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"turtlelog.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
