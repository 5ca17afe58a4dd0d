"""Rerun recordings, layouts, tables. Rerun itself loads when a name is first used."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from turtlelog.show.documents import describe_run, describe_runs
    from turtlelog.show.figures import (
        FIGURES,
        Page,
        draw_figure,
        write_figures,
        write_tables,
    )
    from turtlelog.show.scene_comparison import write_comparison_rrd
    from turtlelog.show.scene_run import write_run_rrd
    from turtlelog.show.scene_violation import write_violation_rrd
    from turtlelog.show.snapshot import ShownView, ViewReport, write_snapshot
    from turtlelog.show.tables import TABLE_FORMATS, format_table
    from turtlelog.show.viewer import open_viewer

__all__ = [
    "FIGURES",
    "TABLE_FORMATS",
    "Page",
    "ShownView",
    "ViewReport",
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
    "write_violation_rrd",
]

_MODULES: Final = {
    "FIGURES": "figures",
    "Page": "figures",
    "draw_figure": "figures",
    "write_figures": "figures",
    "write_tables": "figures",
    "TABLE_FORMATS": "tables",
    "ShownView": "snapshot",
    "ViewReport": "snapshot",
    "describe_run": "documents",
    "describe_runs": "documents",
    "format_table": "tables",
    "open_viewer": "viewer",
    "write_comparison_rrd": "scene_comparison",
    "write_run_rrd": "scene_run",
    "write_snapshot": "snapshot",
    "write_violation_rrd": "scene_violation",
}


def __getattr__(name: str) -> Any:
    """Import a name's module on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
