"""`turtlelog view`: recordings in the Rerun viewer."""

import re
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import options
from turtlelog.cli.console import fill_lines, flush_stdout, list_written, print_note, print_text
from turtlelog.cli.work import show_progress
from turtlelog.errors import UsageError

_LONGEST_S = 1e9
_HOUR_S = 3600.0
_ROUNDING_S = 1e-3
"""Rounding of the end, which is printed in milliseconds [s]."""

_USUAL_SIZE = "1600x900"
_LEAST_SIZE = 480, 320
"""Smallest width and height of a picture [pixels]. Titles and axes take 40 pixels of every row of
plots, so that 45 remain."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """A picture instead of a window.

    Attributes:
        snapshot: Write a picture of the view to this .png file and open no window; needs no
            display.
        at: Time of the picture, from the first sample [s]. Default: the end of the longest run.
        timeline: Timeline of --at and of a movie: sim_time, or for several runs also PHASE_time, as
            in translate_time. PHASE_time begins at the start of a later phase of each run.
        size: Width and height of the picture [pixels], at least 480x320. Below 1000x700, legends,
            phases and tables are left out, so that curves have room.
        no_scans: Leave out the laser scans and the map of a bag.
    """

    snapshot: options.Place | None = None
    at: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    timeline: Annotated[str, Parameter(metavar="NAME")] = "sim_time"
    size: Annotated[str, Parameter(metavar="WIDTHxHEIGHT")] = _USUAL_SIZE
    no_scans: Annotated[bool, Parameter(negative=())] = False


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WindowOptions:
    """Places to look, instead of a separate window.

    Attributes:
        web: Serve the view to browsers on this machine until Ctrl-C; needs no display.
        follow: Show one recording while it is being written, until it ends.
        connect: With --follow: show the recording in a viewer that is already open. Example:
            rerun+http://127.0.0.1:9876/proxy.
    """

    web: bool = False
    follow: bool = False
    connect: options.Connect = None


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MovieOptions:
    """A movie of the runs.

    Attributes:
        movie: Write a movie of the runs driving into this .mp4 (VP9) or .gif file.
        length: Length of the movie [s], 1 to 600. Default: real time, at most 10 s.
    """

    movie: options.Place | None = None
    length: Annotated[float | None, Parameter(metavar="SECONDS")] = None


def view(
    files: options.Files,
    /,
    *,
    save: options.Place | None = None,
    picture: PictureOptions = PictureOptions(),
    window: WindowOptions = WindowOptions(),
    movie: MovieOptions = MovieOptions(),
    topics: options.ReadingOptions = options.ReadingOptions(),
) -> None:
    """Open recordings in the Rerun viewer; several recordings are overlaid for comparison.

    Example: turtlelog view kp1.mcap kp10.mcap

    Example: turtlelog view kp1.mcap kp10.mcap --movie race.mp4

    Args:
        files: Recordings (.mcap), bags, the paper's logs (.json, .csv), or .rrd files, which are
            shown unchanged.
        save: Write this .rrd file and open no window.
    """
    options.require_files(files)
    outputs = [save, picture.snapshot, movie.movie]
    _require_one_way(files, outputs, window)
    _require_picture(picture, movie)
    require_movie(movie, files)
    options.require_there(files)
    files = options.list_files(files)
    options.require_new_target(save, files, suffix=".rrd")
    options.require_new_target(picture.snapshot, files, suffix=".png")
    width_and_height = _parse_size(picture.size)
    if window.follow:
        with suppress(KeyboardInterrupt):  # as if the window was closed
            _follow(files[0], window.connect)
        return
    if movie.movie is not None:
        ready = [path for path in files if path.suffix == ".rrd"]
        if ready:
            raise UsageError(f"--movie: {ready[0]} is a view already; name recordings")
        runs = options.read_runs(files, topics)
        film_runs(runs, movie, timeline=picture.timeline)
        _tell([movie.movie], runs)
        if save is None and picture.snapshot is None and not window.web:
            return
    from tempfile import TemporaryDirectory  # not for plot, which films as well

    with TemporaryDirectory(prefix="turtlelog-") as folder:
        rrds, runs = _prepare_rrds(files, save, picture, Path(folder), topics)
        if picture.snapshot is not None:
            with show_progress("taking the picture"):
                tl.draw.write_snapshot(
                    rrds[0],
                    picture.snapshot,
                    at_s=_choose_time(picture, _find_span(runs)),
                    timeline=picture.timeline,
                    size=width_and_height,
                )
        _tell([path for path in (save, picture.snapshot) if path is not None], runs)
        with suppress(KeyboardInterrupt):  # the user ends the view
            if window.web:
                _serve(rrds)
            elif save is None and picture.snapshot is None:
                tl.open_viewer(rrds)


def _tell(written: Sequence[Path], runs: "Sequence[tl.Run]") -> None:
    if written:
        ending = [fill_lines([tl.compare.describe_runs(runs)])] if runs else []
        print_text("\n".join([*ending, *list_written(written)]))


def _require_picture(picture: PictureOptions, movie: MovieOptions) -> None:
    if picture.at is not None and not abs(picture.at) < _LONGEST_S:
        raise UsageError(f"--at {picture.at:g}: must be seconds below {_LONGEST_S:g}")
    if picture.snapshot is None:
        given = {"--at": picture.at, "--size": picture.size != _USUAL_SIZE}
        options.refuse_given(given, "needs --snapshot NAME.png")
    is_timed = picture.snapshot is not None or movie.movie is not None
    if picture.timeline != "sim_time" and not is_timed:
        raise UsageError("--timeline: needs --snapshot NAME.png or --movie NAME.mp4")


def _require_one_way(
    files: list[Path], outputs: Sequence[Path | None], window: WindowOptions
) -> None:
    if not window.follow:
        options.refuse_given({"--connect": window.connect}, "needs --follow")
    if window.follow and (window.web or any(output is not None for output in outputs)):
        raise UsageError(
            "--follow: leave out --save, --snapshot, --movie and --web, which open no window"
        )
    if window.follow and (len(files) > 1 or files[0].suffix.lower() != ".mcap"):
        raise UsageError(
            "--follow: takes one .mcap file that is being recorded, not"
            f" {len(files) if len(files) > 1 else files[0]}"
        )
    save = outputs[0]
    if save is not None and save.suffix in {".png", ".mp4", ".gif"}:
        other = "--snapshot" if save.suffix == ".png" else "--movie"
        raise UsageError(f"--save {save}: --save writes .rrd files; did you mean {other} {save}?")


def _follow(path: Path, url: str | None) -> None:
    run = tl.draw.follow_recording(path, url)
    if run.stop_reason is None:
        print_note(f"{path}: not finished: followed up to {run.end_ns / 1e9:.3f} s")


def _serve(rrds: list[Path]) -> None:
    with tl.draw.serve_recordings(rrds) as address:
        print_text(address)
        flush_stdout()
        print_note("open it in a browser on this machine; Ctrl-C ends it")
        while True:
            time.sleep(_HOUR_S)


def _parse_size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if found is None:
        raise UsageError(f"--size {text}: must be WIDTHxHEIGHT, each up to 9999 pixels")
    width, height = int(found[1]), int(found[2])
    if width < _LEAST_SIZE[0] or height < _LEAST_SIZE[1]:
        least = "x".join(map(str, _LEAST_SIZE))
        raise UsageError(f"--size {text}: must be at least {least}, below which no curve shows")
    return width, height


def _prepare_rrds(
    files: list[Path],
    save: Path | None,
    picture: PictureOptions,
    folder: Path,
    topics: options.ReadingOptions,
) -> tuple[list[Path], "list[tl.Run]"]:
    """Return the views, and their runs, if known."""
    ready = [path for path in files if path.suffix == ".rrd"]
    if ready and (len(ready) < len(files) or save is not None):
        raise UsageError(
            f"{ready[0]}: is a view already; name recordings, or views alone without --save"
        )
    if len(ready) > 1 and picture.snapshot is not None:
        raise UsageError(f"--snapshot: takes one view, not {len(ready)}")
    if ready:
        return ready, []
    runs = options.read_runs(files, topics)
    seen = None  # the surroundings of a bag's robot
    if not picture.no_scans and len(runs) == 1 and runs[0].origin.poses is not None:
        seen = tl.log.read_surroundings(files[0], runs[0])
    for note in () if seen is None else seen.notes:
        print_note(f"{files[0]}: {note}")
    rrd = save or folder / "view.rrd"
    with show_progress("drawing"):
        size = None if picture.snapshot is None else _parse_size(picture.size)
        if len(runs) == 1:
            tl.write_run_rrd(runs[0], rrd, size=size, surroundings=seen)
        else:
            tl.write_comparison_rrd(runs, rrd, size=size)
    return [rrd], runs


def _find_span(runs: "Sequence[tl.Run]") -> tuple[float, float] | None:
    """Return the time of the first pose and the end of the longest run [s]; None without runs."""
    if not runs:
        return None
    start_ns = min(int(run.poses.time_ns[0]) - run.start_ns for run in runs)
    return start_ns / 1e9, max(run.end_ns - run.start_ns for run in runs) / 1e9


def _choose_time(picture: PictureOptions, span_s: tuple[float, float] | None) -> float | None:
    """Return the time of the picture. A view is slightly longer than its runs."""
    if picture.timeline != "sim_time" or span_s is None:
        return picture.at
    start_s, end_s = span_s
    if picture.at is None:
        return end_s
    if picture.at > end_s + _ROUNDING_S:
        raise UsageError(f"--at {picture.at}: must be at most {end_s:.3f} s, where it ends")
    if picture.at < start_s - _ROUNDING_S:
        raise UsageError(f"--at {picture.at}: must be at least {start_s:.3f} s, where it begins")
    return picture.at


def require_movie(movie: MovieOptions, files: Sequence[Path]) -> None:
    """Refuse a movie that cannot be written, before any file is read."""
    if movie.movie is None:
        options.refuse_given({"--length": movie.length}, "needs --movie NAME.mp4")
        return
    suffix = movie.movie.suffix.lower()
    if suffix not in {".mp4", ".gif"}:
        raise UsageError(f"--movie {movie.movie}: the name must end in .mp4 or .gif")
    options.require_new_target(movie.movie, files, suffix=suffix)
    from turtlelog.draw.movie import require_encoder

    require_encoder(suffix)


def require_scenes(files: Sequence[Path], movie: MovieOptions) -> None:
    """Refuse a command that would write nothing, and a movie of nothing."""
    if movie.movie is None:
        raise UsageError("plot needs a file or a folder to write: -o NAME.png or -o FOLDER")
    if not files:
        raise UsageError(
            "--movie: no recordings to film; name them: turtlelog plot FILE... --movie NAME.mp4"
        )


def film_runs(runs: "Sequence[tl.Run]", movie: MovieOptions, *, timeline: str) -> None:
    """Write the movie if one is requested."""
    if movie.movie is None:
        return
    from turtlelog.draw.movie import write_movie

    bare = next((run.name for run in runs if not len(run.poses)), None)
    if bare is not None:
        raise UsageError(f"--movie: {bare} has commands alone, and a movie needs poses")
    with show_progress("filming", 100.0, "%") as progress:
        write_movie(
            runs,
            movie.movie,
            timeline=timeline,
            length_s=movie.length,
            on_picture=progress.count,
        )
