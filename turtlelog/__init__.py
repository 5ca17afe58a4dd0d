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
    from turtlelog.explain import (
        MECHANISMS,
        Attribution,
        Identification,
        attribute_run,
        attribute_scenario,
        identify_run,
        write_sentences,
    )
    from turtlelog.laws import Decision, Goal, Law, Pose
    from turtlelog.log import (
        PartialRecordingWarning,
        Recorder,
        RecordingInfo,
        RecoveryReport,
        TopicColumns,
        export_csv,
        export_parquet,
        export_rosbag2,
        import_log,
        iter_columns,
        read_bag,
        read_bag_info,
        read_columns,
        read_info,
        read_recording,
        read_run,
        recover_recording,
        write_columns,
        write_recording,
    )
    from turtlelog.measure import METRICS, SIGNALS, Metric, Signal, Status, measure_run, read_signal
    from turtlelog.replay import PlantReplay, replay_plant
    from turtlelog.run import Phase, Run
    from turtlelog.runner import run_live
    from turtlelog.scenario import (
        PAPER_RUNS,
        PRESETS,
        Scenario,
        format_scenario,
        load_scenario,
        override_scenario,
        parse_assignments,
        parse_scenario,
        restore_scenario,
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
    "explain": (
        "MECHANISMS",
        "Attribution",
        "Identification",
        "attribute_run",
        "attribute_scenario",
        "identify_run",
        "write_sentences",
    ),
    "laws": ("Decision", "Goal", "Law", "Pose"),
    "log": (
        "PartialRecordingWarning",
        "Recorder",
        "RecordingInfo",
        "RecoveryReport",
        "TopicColumns",
        "export_csv",
        "export_parquet",
        "export_rosbag2",
        "import_log",
        "iter_columns",
        "read_bag",
        "read_bag_info",
        "read_columns",
        "read_info",
        "read_recording",
        "read_run",
        "recover_recording",
        "write_columns",
        "write_recording",
    ),
    "measure": ("METRICS", "SIGNALS", "Metric", "Signal", "Status", "measure_run", "read_signal"),
    "replay": ("PlantReplay", "replay_plant"),
    "run": ("Phase", "Run"),
    "runner": ("run_live",),
    "scenario": (
        "PAPER_RUNS",
        "PRESETS",
        "Scenario",
        "format_scenario",
        "load_scenario",
        "override_scenario",
        "parse_assignments",
        "parse_scenario",
        "restore_scenario",
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
    "MECHANISMS",
    "METRICS",
    "PAPER_RUNS",
    "PRESETS",
    "SIGNALS",
    "TABLE_FORMATS",
    "Attribution",
    "Column",
    "Comparison",
    "Decision",
    "Goal",
    "Identification",
    "Law",
    "Metric",
    "PartialRecordingWarning",
    "Phase",
    "PlantReplay",
    "Pose",
    "Recorder",
    "RecordingInfo",
    "RecoveryReport",
    "Run",
    "Scenario",
    "Signal",
    "Status",
    "Table",
    "TopicColumns",
    "TurtlelogError",
    "__version__",
    "attribute_run",
    "attribute_scenario",
    "compare_runs",
    "describe_run",
    "describe_runs",
    "export_csv",
    "export_parquet",
    "export_rosbag2",
    "format_scenario",
    "format_table",
    "identify_run",
    "import_log",
    "iter_columns",
    "load_scenario",
    "measure_run",
    "name_runs",
    "open_viewer",
    "override_scenario",
    "parse_assignments",
    "parse_scenario",
    "read_bag",
    "read_bag_info",
    "read_columns",
    "read_info",
    "read_recording",
    "read_run",
    "read_signal",
    "recover_recording",
    "replay_plant",
    "restore_scenario",
    "run_live",
    "simulate_run",
    "tabulate_differences",
    "tabulate_metrics",
    "tabulate_table1",
    "tabulate_whole_runs",
    "write_columns",
    "write_comparison_rrd",
    "write_recording",
    "write_run_rrd",
    "write_sentences",
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
