from .browser_view import serve_recordings as serve_recordings, show_run as show_run
from .figures import (
    FIGURES as FIGURES,
    Page as Page,
    draw_figure as draw_figure,
    draw_map as draw_map,
    list_left_out as list_left_out,
    list_unmarked as list_unmarked,
    write_difference_figure as write_difference_figure,
    write_figures as write_figures,
    write_map_figure as write_map_figure,
    write_prediction_figure as write_prediction_figure,
    write_robot_figure as write_robot_figure,
    write_tables as write_tables,
    write_trajectory_figure as write_trajectory_figure,
)
from .movie import write_movie as write_movie
from .report_file import (
    Explanation as Explanation,
    write_map_report as write_map_report,
    write_report as write_report,
)
from .report_sections import CheckLine as CheckLine
from .rerun.comparison_scene import (
    write_comparison_rrd as write_comparison_rrd,
    write_prediction_rrd as write_prediction_rrd,
    write_robot_rrd as write_robot_rrd,
)
from .rerun.explanation_scene import write_explanation_rrd as write_explanation_rrd
from .rerun.live_viewer import (
    LiveViewer as LiveViewer,
    follow_recording as follow_recording,
)
from .rerun.run_scene import (
    write_run_rrd as write_run_rrd,
    write_violation_rrd as write_violation_rrd,
)
from .rerun.viewer import (
    ShownView as ShownView,
    ViewReport as ViewReport,
    open_viewer as open_viewer,
    open_window as open_window,
    write_snapshot as write_snapshot,
)
from .written_tables import (
    TABLE_FORMATS as TABLE_FORMATS,
    document_run as document_run,
    format_table as format_table,
)
