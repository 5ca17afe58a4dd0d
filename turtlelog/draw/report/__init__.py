"""A report as one HTML file: zoomable plots, a plane with playback, tables and provenance."""

from turtlelog.draw.report.report_file import Explanation, write_map_report, write_report
from turtlelog.draw.report.sections import CheckLine

__all__ = ["CheckLine", "Explanation", "write_map_report", "write_report"]
