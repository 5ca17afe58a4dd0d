"""turtlelog: what did my loop really do?

Simulate the ROS 2 turtlesim robot under feedback, record, replay, measure and compare. Names load
on first use: importing the package costs neither numpy nor rerun.
"""

import importlib
from typing import TYPE_CHECKING, Any

from turtlelog.version import __version__

if TYPE_CHECKING:
    from turtlelog.check import (
        Finding,
        check_formula,
        check_run,
        compute_robustness,
    )
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
    from turtlelog.errors import (
        CheckError,
        ExpressionError,
        TurtlelogError,
    )
    from turtlelog.expressions import (
        Expression,
        draw_caret,
        evaluate_expression,
        format_expression,
        parse_expression,
    )
    from turtlelog.laws import (
        Decision,
        Goal,
        Law,
        Pose,
    )
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
    from turtlelog.measure import (
        METRICS,
        SIGNALS,
        Metric,
        Signal,
        Status,
        measure_run,
        read_signal,
    )
    from turtlelog.replay import (
        LawReplay,
        LoopReplay,
        PlantReplay,
        replay_law,
        replay_loop,
        replay_plant,
    )
    from turtlelog.run import (
        Phase,
        Run,
    )
    from turtlelog.runner import (
        run_live,
    )
    from turtlelog.scenario import (
        PAPER_RUNS,
        PRESETS,
        Scenario,
        complete_scenario,
        flatten_scenario,
        format_scenario,
        load_scenario,
        override_scenario,
        parse_assignments,
        parse_scenario,
        restore_scenario,
    )
    from turtlelog.show import (
        FIGURES,
        TABLE_FORMATS,
        Page,
        describe_run,
        describe_runs,
        draw_figure,
        format_table,
        open_viewer,
        write_comparison_rrd,
        write_figures,
        write_run_rrd,
        write_snapshot,
        write_tables,
    )
    from turtlelog.simulate import (
        simulate_run,
    )


_ROOMS = {
    "check": (
        "Finding",
        "check_formula",
        "check_run",
        "compute_robustness",
    ),
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
    "errors": (
        "CheckError",
        "ExpressionError",
        "TurtlelogError",
    ),
    "expressions": (
        "Expression",
        "draw_caret",
        "evaluate_expression",
        "format_expression",
        "parse_expression",
    ),
    "laws": (
        "Decision",
        "Goal",
        "Law",
        "Pose",
    ),
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
    "measure": (
        "METRICS",
        "SIGNALS",
        "Metric",
        "Signal",
        "Status",
        "measure_run",
        "read_signal",
    ),
    "replay": (
        "LawReplay",
        "LoopReplay",
        "PlantReplay",
        "replay_law",
        "replay_loop",
        "replay_plant",
    ),
    "run": (
        "Phase",
        "Run",
    ),
    "runner": ("run_live",),
    "scenario": (
        "PAPER_RUNS",
        "PRESETS",
        "Scenario",
        "complete_scenario",
        "flatten_scenario",
        "format_scenario",
        "load_scenario",
        "override_scenario",
        "parse_assignments",
        "parse_scenario",
        "restore_scenario",
    ),
    "show": (
        "FIGURES",
        "TABLE_FORMATS",
        "Page",
        "describe_run",
        "describe_runs",
        "draw_figure",
        "format_table",
        "open_viewer",
        "write_comparison_rrd",
        "write_figures",
        "write_run_rrd",
        "write_snapshot",
        "write_tables",
    ),
    "simulate": ("simulate_run",),
}
_PLACES = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = [
    "FIGURES",
    "METRICS",
    "PAPER_RUNS",
    "PRESETS",
    "SIGNALS",
    "TABLE_FORMATS",
    "CheckError",
    "Column",
    "Comparison",
    "Decision",
    "Expression",
    "ExpressionError",
    "Finding",
    "Goal",
    "Law",
    "LawReplay",
    "LoopReplay",
    "Metric",
    "Page",
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
    "check_formula",
    "check_run",
    "compare_runs",
    "complete_scenario",
    "compute_robustness",
    "describe_run",
    "describe_runs",
    "draw_caret",
    "draw_figure",
    "evaluate_expression",
    "export_csv",
    "export_parquet",
    "export_rosbag2",
    "flatten_scenario",
    "format_expression",
    "format_scenario",
    "format_table",
    "import_log",
    "iter_columns",
    "load_scenario",
    "measure_run",
    "name_runs",
    "open_viewer",
    "override_scenario",
    "parse_assignments",
    "parse_expression",
    "parse_scenario",
    "read_bag",
    "read_bag_info",
    "read_columns",
    "read_info",
    "read_recording",
    "read_run",
    "read_signal",
    "recover_recording",
    "replay_law",
    "replay_loop",
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
    "write_figures",
    "write_recording",
    "write_run_rrd",
    "write_snapshot",
    "write_tables",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'turtlelog' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"turtlelog.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
