"""Rerun recordings, layouts, tables. Rerun itself loads when a name is first used."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from turtlelog.show.documents import describe_run, describe_runs
    from turtlelog.show.figures import (
        FIGURES,
        Page,
        draw_figure,
        list_left_out,
        write_figures,
        write_tables,
    )
    from turtlelog.show.rerun.comparison_scene import write_comparison_rrd, write_explanation_rrd
    from turtlelog.show.rerun.live_viewer import LiveViewer, follow_recording, open_window
    from turtlelog.show.rerun.run_scene import write_run_rrd, write_violation_rrd
    from turtlelog.show.rerun.snapshot import ShownView, ViewReport, write_snapshot
    from turtlelog.show.rerun.viewer import open_viewer
    from turtlelog.show.rerun.web import serve_recordings
    from turtlelog.show.table_formats import TABLE_FORMATS, format_table

__all__ = [
    "FIGURES",
    "TABLE_FORMATS",
    "LiveViewer",
    "Page",
    "ShownView",
    "ViewReport",
    "describe_run",
    "describe_runs",
    "draw_figure",
    "follow_recording",
    "format_table",
    "list_left_out",
    "open_viewer",
    "open_window",
    "serve_recordings",
    "write_comparison_rrd",
    "write_explanation_rrd",
    "write_figures",
    "write_run_rrd",
    "write_snapshot",
    "write_tables",
    "write_violation_rrd",
]

_MODULES: Final = {
    "FIGURES": "figures",
    "Page": "figures",
    "draw_figure": "figures",
    "list_left_out": "figures",
    "write_figures": "figures",
    "write_tables": "figures",
    "TABLE_FORMATS": "table_formats",
    "LiveViewer": "rerun.live_viewer",
    "ShownView": "rerun.snapshot",
    "ViewReport": "rerun.snapshot",
    "describe_run": "documents",
    "describe_runs": "documents",
    "follow_recording": "rerun.live_viewer",
    "format_table": "table_formats",
    "open_viewer": "rerun.viewer",
    "open_window": "rerun.live_viewer",
    "serve_recordings": "rerun.web",
    "write_comparison_rrd": "rerun.comparison_scene",
    "write_explanation_rrd": "rerun.comparison_scene",
    "write_run_rrd": "rerun.run_scene",
    "write_snapshot": "rerun.snapshot",
    "write_violation_rrd": "rerun.run_scene",
}


def __getattr__(name: str) -> Any:
    """Import a name's module on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
