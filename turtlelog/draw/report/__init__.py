"""A report as one file of HTML: plots to zoom, a plane to play, tables and provenance."""

from turtlelog.draw.report.map_report import write_map_report
from turtlelog.draw.report.report_file import Explanation, write_report
from turtlelog.draw.report.sections import CheckLine

__all__ = ["CheckLine", "Explanation", "write_map_report", "write_report"]
