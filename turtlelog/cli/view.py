"""`turtlelog view`: look at recordings in Rerun."""

import re
import tempfile
from pathlib import Path

import turtlelog as tl
from turtlelog.cli.options import Files, TopicOptions, read_runs, require_files
from turtlelog.cli.output import print_note
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import UsageError

_LONGEST_S = 1e9


def view(
    files: Files,
    /,
    *,
    save: Path | None = None,
    snapshot: Path | None = None,
    at: float | None = None,
    size: str = "1600x900",
    topics: TopicOptions | None = None,
) -> None:
    """Open recordings in the Rerun viewer: one alone, several overlaid as a comparison.

    Example: turtlelog view kp1.mcap kp10.mcap

    Args:
        files: Recordings (.mcap), bags, the paper's logs (.json, .csv), or .rrd files as they are.
        save: Write this .rrd file and open nothing.
        snapshot: Write a picture of the view to this .png file and open nothing; needs no display.
        at: Time of the picture, from the first sample [s]; otherwise the end.
        size: Width and height of the picture [pixels].
    """
    require_files(files)
    if at is not None and (snapshot is None or not abs(at) < _LONGEST_S):
        raise UsageError(f"--at: expected seconds together with --snapshot, found {at}")
    require_new_target(save, files, suffix=".rrd")
    require_new_target(snapshot, files, suffix=".png")
    width_and_height = _parse_size(size)
    with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
        rrds = _prepare_rrds(files, save, snapshot, Path(folder), topics)
        if save is not None:
            print_note(f"wrote {save}")
        if snapshot is not None:
            with show_progress("taking the picture"):
                tl.write_snapshot(rrds[0], snapshot, at_s=at, size=width_and_height)
            print_note(f"wrote {snapshot}")
        if save is None and snapshot is None:
            tl.open_viewer(rrds)


def _parse_size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if found is None:
        raise UsageError(f"--size: expected WIDTHxHEIGHT up to 9999, found {text!r}")
    return int(found[1]), int(found[2])


def _prepare_rrds(
    files: list[Path],
    save: Path | None,
    snapshot: Path | None,
    folder: Path,
    topics: TopicOptions | None,
) -> list[Path]:
    ready = [path for path in files if path.suffix == ".rrd"]
    if ready and (len(ready) < len(files) or save is not None):
        raise UsageError(f"FILE: expected recordings, found {ready[0]}, which is a view already")
    if len(ready) > 1 and snapshot is not None:
        raise UsageError(f"--snapshot: expected one view, found {len(ready)}")
    if ready:
        return ready
    runs = read_runs(files, topics)
    rrd = save or folder / "view.rrd"
    with show_progress("drawing"):
        if len(runs) == 1:
            tl.write_run_rrd(runs[0], rrd)
        else:
            tl.write_comparison_rrd(runs, rrd)
    return [rrd]
