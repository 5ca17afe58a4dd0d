"""Writing of a movie of one or several runs as .mp4 (VP9) or .gif.

VP9 and its encoder are free of fees, and OpenCV contains FFmpeg under the LGPL. H.264, which older
players also support, has no available encoder without the GPL.
"""

import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from turtlelog.libraries import load_library

load_library("matplotlib")

from turtlelog.charts.curves import Values
from turtlelog.charts.plotted_curves import TIMELINE, find_phase_zeros
from turtlelog.compare import order_by_gain
from turtlelog.draw.movie_picture import Picture, draw_pictures
from turtlelog.draw.output_files import replace_file
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.run import Run

_SIZES: Final = {".mp4": (1280, 720), ".gif": (800, 450)}
"""Widths and heights [pixels]: the size of a slide, and a size for a page with text next to the
movie."""


def write_movie(
    runs: Sequence[Run],
    path: str | Path,
    *,
    timeline: str = TIMELINE,
    length_s: float | None = None,
    on_picture: Callable[[int, int], None] | None = None,
) -> None:
    """Write a movie: turtles with growing trails, and a close-up of the goal at the end.

    Args:
        runs: Runs, at least one. Several runs are in one picture, in the order of their gains.
        path: A .mp4 (VP9) or .gif file. An existing file is replaced when the new one is complete.
        timeline: `sim_time`: from each run's first sample; or a later phase, such as
            `translate_time`: from each start of this phase.
        length_s: Length of the movie [s], 1 to 600, for a .gif up to 60. Default: real time, at
            most 10 s.
        on_picture: Function that is called with the numbers of pictures done and in total.

    Raises:
        ShowError: If there is no run, a run does not have the timeline, the length is out of range,
            or the file cannot be written.
        LibraryError: If the encoder of such a file is not installed.
    """
    path = make_path(path)
    suffix = path.suffix.lower()
    require_encoder(suffix)
    if not runs:
        raise ShowError(f"{path}: no run to film")
    longest_s = LONGEST_S[suffix]
    if length_s is not None and not SHORTEST_S <= length_s <= longest_s:
        raise ShowError(
            f"movie: expected a length of {SHORTEST_S:g} to {longest_s:g} s for {suffix}, found"
            f" {length_s:g}"
        )
    runs = order_by_gain(runs)
    film = plan_film(
        runs, timeline=timeline, length_s=length_s, pictures_per_s=PICTURES_PER_S[suffix]
    )
    pictures = draw_pictures(runs, film, size=_SIZES[suffix], on_picture=on_picture)
    with replace_file(path) as part:
        (_encode_mp4 if suffix == ".mp4" else _encode_gif)(pictures, part)


PICTURES_PER_S: Final = {".mp4": 24.0, ".gif": 20.0}
"""Picture rates [1/s]. For .mp4, the rate is that of the cinema; VP9 takes 0.13 s of processor time
per picture. For .gif, a picture lasts whole hundredths of a second, and many programs show none for
less than five."""

_COLORS: Final = 128
"""Number of colours of a GIF; twelve runs with faint paths and smooth edges need about 90."""


def require_encoder(suffix: str) -> None:
    """Load the encoder for files with a suffix.

    Raises:
        ShowError: If there is no movie format with this suffix.
        LibraryError: If the encoder is not installed.
    """
    if suffix not in _SIZES:
        raise ShowError(f"movie: expected a name that ends in .mp4 or .gif, found {suffix!r}")
    load_library("cv2" if suffix == ".mp4" else "PIL.Image")


def _encode_mp4(pictures: Iterable[Picture], path: Path) -> None:
    cv2 = load_library("cv2")
    # OpenCV chooses the encoder by the file's suffix, which the temporary name of the target lacks.
    with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
        whole = Path(folder) / "movie.mp4"
        writer: Any = None
        for picture in pictures:
            if writer is None:
                height, width = picture.shape[:2]
                codec = cv2.VideoWriter_fourcc(*"vp09")
                rate = PICTURES_PER_S[".mp4"]
                writer = cv2.VideoWriter(str(whole), cv2.CAP_FFMPEG, codec, rate, (width, height))
                if not writer.isOpened():
                    raise ShowError(f"{path}: expected OpenCV to write VP9, found that it cannot")
            writer.write(np.ascontiguousarray(picture[:, :, ::-1]))
        if writer is not None:
            writer.release()
        path.write_bytes(whole.read_bytes())


def _encode_gif(pictures: Iterable[Picture], path: Path) -> None:
    image = load_library("PIL.Image")
    shown = [image.fromarray(picture) for picture in pictures]
    # One colour table for all pictures, from the last, which has all colours: nothing flickers.
    table = shown[-1].quantize(_COLORS)
    frames = [picture.quantize(palette=table, dither=image.Dither.NONE) for picture in shown]
    frames[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=round(1000.0 / PICTURES_PER_S[".gif"]),
        loop=0,
        optimize=False,
    )


SHORTEST_S: Final = 1.0
"""Shortest movie [s]; shorter movies would be a picture."""

LONGEST_S: Final = {".mp4": 600.0, ".gif": 60.0}
"""Longest movie [s] by format. An .mp4 takes 3 s of work per second. A .gif is made from all
pictures at once, 22 MB per second."""

_STILL_S: Final = 1.5
"""Time without motion at the end [s], for reading the distances of the runs."""

_MOST_STILL: Final = 0.3
"""Largest share of this time in the movie."""

_SLOWEST: Final = 0.25
"""Slowest motion: a run of half a second takes two seconds, so that each pose is visible."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Film:
    """The times of a movie's pictures."""

    timeline: str  # timeline of the times
    zeros_ns: tuple[int, ...]  # zero of the timeline in each run's own time [ns]
    time_s: Values  # times on the timeline [s], shape (n,), increasing, then constant
    driving: int  # number of pictures that show the runs driving
    pace: float  # seconds of the runs per second of the movie


def plan_film(
    runs: Sequence[Run], *, timeline: str, length_s: float | None, pictures_per_s: float
) -> Film:
    """Return the times of a movie's pictures, from the first pose of any run to the last pose.

    The arguments are as in `write_movie`.

    Raises:
        ShowError: If a run has no such timeline.
    """
    zeros_ns = tuple(_find_zero_ns(run, timeline) for run in runs)
    ends_ns = [run.poses.time_ns[[0, -1]] - zero for run, zero in zip(runs, zeros_ns, strict=True)]
    first_s, last_s = float(np.min(ends_ns)) / 1e9, float(np.max(ends_ns)) / 1e9
    whole_s = _choose_length(last_s - first_s) if length_s is None else length_s
    still_s = min(_STILL_S, _MOST_STILL * whole_s)
    driving = max(round((whole_s - still_s) * pictures_per_s), 2)
    still = max(round(still_s * pictures_per_s), 1)
    moments = np.linspace(first_s, last_s, driving)
    return Film(
        timeline=timeline,
        zeros_ns=zeros_ns,
        time_s=np.append(moments, np.full(still, last_s)),
        driving=driving,
        pace=(last_s - first_s) * pictures_per_s / driving,
    )


def _choose_length(span_s: float) -> float:
    """Return the default length of a movie [s]: real time, within limits."""
    return float(np.clip(span_s + _STILL_S, min(span_s / _SLOWEST + _STILL_S, 3.0), 10.0))


def _find_zero_ns(run: Run, timeline: str) -> int:
    if timeline == TIMELINE:
        return run.start_ns
    zeros_ns = find_phase_zeros(run)
    if timeline not in zeros_ns:
        known = ", ".join([TIMELINE, *zeros_ns])
        raise ShowError(f"timeline: {run.name}: expected one of {known}, found {timeline!r}")
    return zeros_ns[timeline]
