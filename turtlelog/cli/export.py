"""`turtlelog export`: a run for other programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Json, TopicOptions, read_runs
from turtlelog.cli.output import print_json, print_text
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import Run

_TableName = Literal["poses", "commands", "samples", "events"]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """What to write.

    Attributes:
        rosbag2: Write a bag into this new folder, for ros2 bag and all that reads bags.
        csv: Write a file per table into this new folder, or one table into this .csv file.
        parquet: Write a file per table into this new folder, or one table into this .parquet file.
        table: Which table; otherwise a file holds the poses, and a folder all tables.
    """

    rosbag2: Path | None = None
    csv: Path | None = None
    parquet: Path | None = None
    table: _TableName | None = None


def export(
    file: Annotated[Path, Parameter(name="FILE")],
    /,
    *,
    options: ExportOptions | None = None,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Write a run for other programs: as a ROS 2 bag, as CSV, as Parquet.

    Folders have to be new; a single file replaces one that is there.

    Example: turtlelog export kp4.mcap --rosbag2 kp4-bag --csv kp4-poses.csv

    Args:
        file: A recording (.mcap), a ROS 2 bag, or one of the paper's logs (.json, .csv).
        json: Print one JSON object instead of lines.
    """
    options = options or ExportOptions()
    tables = [path for path in (options.csv, options.parquet) if path is not None]
    if options.rosbag2 is None and not tables:
        raise UsageError("export: expected --rosbag2, --csv or --parquet, found none")
    if options.table is not None and not tables:
        raise UsageError("--table: expected together with --csv or --parquet, found alone")
    for target in tables:
        if target.exists() and file.exists() and target.samefile(file):
            raise UsageError(f"{target}: expected another file to write to, found the input itself")
    (run,) = read_runs([file], topics)
    written = [str(path) for path in _write(run, options)]
    if json:
        print_json({"file": str(file), "name": run.name, "written": written})
    else:
        print_text("\n".join(f"wrote {path}" for path in written))


def _write(run: "Run", options: ExportOptions) -> list[Path]:
    written: list[Path] = []
    if options.rosbag2 is not None:
        written += tl.export_rosbag2(run, options.rosbag2)
    if options.csv is not None:
        written += tl.export_csv(run, options.csv, table=options.table)
    if options.parquet is not None:
        written += tl.export_parquet(run, options.parquet, table=options.table)
    return written
