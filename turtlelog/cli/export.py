"""`turtlelog export`: a run for other programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Json, TopicOptions, read_runs
from turtlelog.cli.output import print_json, print_note, print_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_apart, require_new_folder, require_new_target
from turtlelog.errors import LogError, UsageError

if TYPE_CHECKING:
    from turtlelog import Run

_FILE_SUFFIXES: Final = (".csv", ".parquet", ".mcap", ".db3", ".json", ".rrd", ".yaml", ".zip")
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
    _require_targets(options, file)
    (run,) = read_runs([file], topics)
    written = [str(path) for path in _write(run, options)]
    if json:
        print_json({"file": str(file), "name": run.name, "written": written})
    else:
        print_text("\n".join(f"wrote {path}" for path in written))


def _require_targets(options: ExportOptions, file: Path) -> None:
    """Refuse any target before the first is written."""
    tables = {".csv": options.csv, ".parquet": options.parquet}
    targets = [path for path in (options.rosbag2, *tables.values()) if path is not None]
    if not targets:
        raise UsageError("export: expected --rosbag2, --csv or --parquet, found none")
    if options.table is not None and targets == [options.rosbag2]:
        raise UsageError("--table: expected together with --csv or --parquet, found alone")
    if options.rosbag2 is not None:
        require_new_folder(options.rosbag2, file_suffixes=_FILE_SUFFIXES)
    for suffix, path in tables.items():
        if path is not None and path.suffix.lower() == suffix:
            require_new_target(path, [file], suffix=suffix)
        elif path is not None:
            require_new_folder(path, file_suffixes=_FILE_SUFFIXES)
    require_apart(targets)


def _write(run: "Run", options: ExportOptions) -> list[Path]:
    written: list[Path] = []
    try:
        with show_progress("writing"):
            if options.rosbag2 is not None:
                written += tl.export_rosbag2(run, options.rosbag2)
            if options.csv is not None:
                written += tl.export_csv(run, options.csv, table=options.table)
            if options.parquet is not None:
                written += tl.export_parquet(run, options.parquet, table=options.table)
    except LogError:
        for path in written:  # what stands, though another does not
            print_note(f"wrote {path}")
        raise
    return written
