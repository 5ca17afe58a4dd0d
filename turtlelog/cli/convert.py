"""`turtlelog convert`: conversion of a run to another format, or recovery of a damaged file."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.work import show_progress
from turtlelog.display import describe_count, join_words
from turtlelog.errors import LogError, UsageError

_FILES: Final = {".mcap": "mcap", ".csv": "csv", ".parquet": "parquet", ".tum": "tum"}
_TRAJECTORIES: Final = (".tum", ".txt")

_TableName = Literal["poses", "commands", "samples", "events"]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class TableOptions:
    """Options for formats and tables, and for reading logs.

    Attributes:
        to: Format, if the name of OUT does not show it: for a folder rosbag2 (default) or one file
            per table (csv, parquet); tum writes a trajectory under any name.
        table: Table to write. Default: the poses to a file, all tables to a folder.
        sort: Sort the rows of a paper's log by time, drop exact duplicates, and report how many.
            Default: reject such a log.
        own_topics: Leave /odom, /tf and /path out of a recording or bag.
        recover: Copy every message that can still be read of a damaged or unfinished recording to a
            complete .mcap file, or of a bag to a new folder.
    """

    to: Annotated[
        Literal["rosbag2", "csv", "parquet", "tum"] | None, Parameter(name=("--to", "--format"))
    ] = None
    table: _TableName | None = None
    sort: bool = False
    own_topics: Annotated[bool, Parameter(negative=())] = False
    recover: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertAnswer:
    """Result of a conversion.

    Attributes:
        file: Name of the file as given.
        name: Name of the run.
        written: Written files.
        absent: Columns that the source does not have.
        notes: Remarks.
    """

    file: str
    name: str
    written: tuple[str, ...]
    absent: tuple[str, ...]
    notes: tuple[str, ...]


def convert(
    file: options.File,
    /,
    *,
    output: Annotated[list[options.Place], Parameter(name=("--output", "-o"), metavar="OUT")],
    tables: TableOptions = TableOptions(),
    topics: options.ReadingOptions = options.ReadingOptions(),
    json: options.Json = False,
) -> None:
    """Convert a recording, bag, log or table: to .mcap, .csv, .parquet, .tum, or a ROS 2 folder.

    The suffix of OUT chooses the format: .mcap for a recording, .csv and .parquet for one table of
    the run, .tum for its poses as a trajectory. A name without a suffix is a new folder, for a ROS
    2 bag or for one file per table. Every file is read back and compared. A file replaces an
    existing file; a folder must be new.

    A recording and a bag also contain the poses as /odom, /tf and /path, for Rerun, RViz and evo.
    turtlelog ignores these topics in its own files.

    The answer lists what the source lacks. A recording, a bag and a folder of Parquet files contain
    the whole run. CSV contains its rows, without scenario, goal and loops.

    Example: turtlelog convert kp1_210.json -o kp1.mcap

    Example: turtlelog convert kp4.mcap -o kp4-bag -o kp4-poses.csv

    Example: turtlelog convert --recover cut.mcap -o whole.mcap

    Args:
        file: A recording (.mcap), a ROS 2 bag, one of the paper's logs (.json, .csv), tables that
            convert wrote, a table with a header (.csv, .tsv, .txt, .parquet), or a trajectory
            (.tum, .txt).
        output: File or folder to write. Can be repeated.
        json: Print one JSON object instead of lines.
    """
    options.require_there([file])
    if tables.recover:
        _recover_file(file, output, json=json)
        return
    kinds = {path: _FILES.get(path.suffix.lower()) or tables.to or "rosbag2" for path in output}
    _require_targets(output, kinds, file, tables)
    if tables.sort:
        run = tl.log.import_log(file, sort=True)
    else:
        (run,) = options.read_runs([file], topics)
    written: list[str] = []
    try:
        for out, kind in kinds.items():
            written += map(str, _write(run, out, kind, tables))
    except LogError:
        for path in written:  # the files that exist, although another one failed
            console.print_note(f"wrote {path}")
        raise
    notes = [*_list_notes(run, kinds, tables)]
    if json:
        console.print_json(
            ConvertAnswer(
                file=str(file),
                name=run.name,
                written=tuple(written),
                absent=run.absent,
                notes=tuple(notes),
            )
        )
        return
    lines = [
        f"{path.name}: {_describe_held(run, path, kind, tables)} of {file.name}"
        f"{' without height and tilt' if _is_flattened(run, kind) else ''}, read back and equal."
        for path, kind in kinds.items()
    ]
    absent = [f"absent in {file}: {', '.join(_list_absent(run))}"] if run.absent else []
    ends = console.fill_lines([*absent, *notes])
    console.print_text("\n".join([console.fill_lines(lines), *console.list_written(written), ends]))


def _list_notes(run: "tl.Run", kinds: Mapping[Path, str], tables: TableOptions) -> Iterator[str]:
    """Yield the notes of a run, and what its outputs leave out."""
    for name, text in run.notes.items():
        # A count of 0 changes nothing.
        if name not in {tl.log.CHOSEN, tl.log.UNUSED} and text != "0":
            yield f"{tl.log.label_note(name)}: {text}"
    for path, kind in kinds.items():
        if kind in {"csv", "parquet"} and _is_file(path, tables) and tables.table is None:
            yield f"{path} holds the poses alone: --table chooses another table, a folder holds all"
        elif kind == "tum":
            yield f"{path} holds the poses alone, without commands, goal and scenario"
        if _is_flattened(run, kind):
            alone = "holds x, y and heading alone, without height and tilt"
            yield f"{path} {alone}; .csv and .parquet hold both"
    if not {"mcap", "rosbag2"}.isdisjoint(kinds.values()) and not tables.own_topics:
        from turtlelog.log.recording.run_writer import list_unshared

        yield from list_unshared(run)


def _describe_held(run: "tl.Run", path: Path, kind: str, tables: TableOptions) -> str:
    nouns = ("poses", "commands", "samples", "events")
    counts = {noun: len(getattr(run, noun)) for noun in nouns}
    one = "poses" if kind == "tum" or (_is_file(path, tables) and kind != "mcap") else None
    chosen = tables.table if kind in {"csv", "parquet"} and tables.table else one
    held = counts if chosen is None else {chosen: counts[chosen]}
    told = [describe_count(count, noun[:-1]) for noun, count in held.items() if count]
    return join_words(told) or "no rows"


def _is_file(path: Path, tables: TableOptions) -> bool:
    return path.suffix.lower() in _FILES or tables.to == "tum"


def _require_targets(
    outputs: list[Path], kinds: dict[Path, str], file: Path, tables: TableOptions
) -> None:
    if tables.table is not None and not {"csv", "parquet"} & {*kinds.values()}:
        raise UsageError(
            f"--table: {outputs[0]} is no table; end its name in .csv or .parquet, or write a"
            " folder with --to csv or parquet"
        )
    if tables.to == "tum":
        for path in outputs:
            if path.suffix.lower() not in _TRAJECTORIES:
                ends = " or ".join(_TRAJECTORIES)
                raise UsageError(f"--to tum: {path} must be a name that ends in {ends}")
    elif tables.to is not None and all(_is_file(path, tables) for path in outputs):
        raise UsageError(f"--to: leave it out, the name {outputs[0]} says it")
    for path in outputs:
        if _is_file(path, tables):
            options.require_new_target(path, [file], suffix=path.suffix.lower())
        else:
            _require_folder(path)
    options.require_apart(outputs)


def _require_folder(path: Path) -> None:
    # Who types an ending with letters means a file; dates and versions end in digits.
    if any(map(str.isalpha, path.suffix)):
        raise UsageError(
            f"{path}: convert writes {join_words([*_FILES])} files, or a folder, not {path.suffix}"
        )
    options.require_new_folder(path)


def _write(run: "tl.Run", path: Path, kind: str, tables: TableOptions) -> tuple[Path, ...]:
    from turtlelog.log.exported_tables import require_read_back
    from turtlelog.log.table_files import require_same_poses

    if _is_flattened(run, kind):
        run = replace(run, poses=replace(run.poses, height_m=None, tilt_rad=None))
    with show_progress("writing"):
        if kind == "mcap":
            tl.write_recording(run, path, shares_poses=not tables.own_topics)
            written: tuple[Path, ...] = (path,)
        elif kind == "rosbag2":
            written = tl.log.export_rosbag2(run, path, shares_poses=not tables.own_topics)
        elif kind == "tum":
            written = tl.log.export_tum(run, path)
        elif kind == "csv":
            written = tl.log.export_csv(run, path, table=tables.table)
        else:
            written = tl.log.export_parquet(run, path, table=tables.table)
    with show_progress("reading back"):
        if kind == "tum":
            require_same_poses(path, run)
            return written
        is_run = kind in {"mcap", "rosbag2"}
        require_read_back(run, written, tl.read_run(path) if is_run else None)
    return written


def _is_flattened(run: "tl.Run", kind: str) -> bool:
    """Return whether a format loses the heights and tilts of a run: only tables store them."""
    has_any = run.poses.height_m is not None or run.poses.tilt_rad is not None
    return has_any and kind not in {"csv", "parquet"}


def _list_absent(run: "tl.Run") -> list[str]:
    """Return the absent columns; applied rates may be absent beside measured ones."""
    poses = run.poses
    measured = {
        "poses.speed_m_s": poses.measured_speed_m_s,
        "poses.turn_rate_rad_s": poses.measured_turn_rate_rad_s,
    }
    return [
        f"{name} (applied, not measured)" if measured.get(name) is not None else name
        for name in run.absent
    ]


_MOST_LINES = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoverAnswer:
    """Result of the recovery of a damaged recording.

    Attributes:
        file: Name of the file as given.
        complete: Whether nothing was lost.
        recovered: Number of recovered messages by topic.
        unchecked: Number of recovered messages without a checksum, by topic.
        missing: Number of lost messages by topic; None if unknown.
        from_s: Log time of the first message [s].
        to_s: Log time of the last message [s].
        lost: Segments of lost bytes.
        output: Written file.
    """

    file: str
    complete: bool
    recovered: Mapping[str, int]
    unchecked: Mapping[str, int]
    missing: Mapping[str, int] | None
    from_s: float
    to_s: float
    lost: "tuple[tl.log.Loss, ...]"
    output: str


def _recover_file(file: Path, outputs: Sequence[Path], *, json: bool) -> None:
    """Write the readable contents of a damaged or unfinished recording, and print the result."""
    if len(outputs) != 1:
        raise UsageError(f"--recover writes one output, not {len(outputs)}")
    (output,) = outputs
    if file.is_dir() and output.suffix.lower() != ".mcap":
        options.require_new_folder(output)
    else:
        options.require_new_target(output, [file], suffix=".mcap")
    with show_progress("recovering"):
        report = tl.recover_recording(file, output)
    if json:
        console.print_json(console.copy_fields(RecoverAnswer, report, output=str(output)))
        return
    console.print_text(console.fill_lines(_format(report, output), indent=2))


def _format(report: "tl.log.RecoveryReport", output: Path) -> list[str]:
    count = sum(report.recovered.values())
    span = f"from {report.from_s:.3f} s to {report.to_s:.3f} s"
    source = Path(report.file).name
    lines = [f"{output.name}: {count} messages {span}, from {source}; {_describe_loss(report)}"]
    width = max(map(len, report.recovered))
    lines += [f"  {topic:<{width}}  {found}" for topic, found in report.recovered.items()]
    if report.complete:
        return lines
    if report.missing:
        lost = ", ".join(f"{count} of {topic}" for topic, count in report.missing.items())
        lines.append(f"messages lost: {lost}")
    elif report.missing is None:
        lines.append("messages lost: not known, because the file has no summary that counts them")
    if report.unchecked:
        unchecked = sum(report.unchecked.values())
        lines.append(f"messages that no checksum covers: {unchecked}")
    lines += [
        f"lost: bytes {loss.start} to {loss.end}: {loss.reason}"
        for loss in report.lost[:_MOST_LINES]
    ]
    if len(report.lost) > _MOST_LINES:
        lines.append(f"lost: and {len(report.lost) - _MOST_LINES} more segments (--json has all)")
    return lines


def _describe_loss(report: "tl.log.RecoveryReport") -> str:
    if report.complete:
        return "nothing was lost: the file is complete and undamaged"
    if report.missing is None:
        from turtlelog.log.recording.head import SUMMARY_ALONE

        count = sum(loss.end - loss.start for loss in report.lost)
        if report.lost_summary_alone:
            return f"{SUMMARY_ALONE} ({count} bytes)"
        return f"an unknown number of messages is lost{f' ({count} bytes)' if count else ''}"
    lost = sum(report.missing.values())
    if not lost:
        return "no message is lost"
    return f"{describe_count(lost, 'message')} {'is' if lost == 1 else 'are'} lost"
