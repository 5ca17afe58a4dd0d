"""Run -> files for other programs."""

from turtlelog.log.exporters.rosbag2 import export_rosbag2
from turtlelog.log.exporters.table_files import export_csv, export_parquet
from turtlelog.log.exporters.tables import TABLES, tabulate_run

__all__ = ["TABLES", "export_csv", "export_parquet", "export_rosbag2", "tabulate_run"]
