"""A movie of one run or several, from the first pose to the last."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from turtlelog.charts.time_axes import TIMELINE
from turtlelog.compare import order_by_gain
from turtlelog.draw.movie.encoding import PICTURES_PER_S, encode_movie, require_encoder
from turtlelog.draw.movie.film import LONGEST_S, SHORTEST_S, plan_film
from turtlelog.draw.movie.picture import draw_pictures
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.run import Run

_SIZES: Final = {".mp4": (1280, 720), ".gif": (800, 450)}
"""Width and height [pixels]: a slide, and what a page shows beside text."""


def write_movie(
    runs: Sequence[Run],
    path: str | Path,
    *,
    timeline: str = TIMELINE,
    length_s: float | None = None,
    on_picture: Callable[[int, int], None] | None = None,
) -> None:
    """Write a movie: turtles drive with growing trails, and at the end the goal comes close.

    Args:
        runs: At least one; several over each other, in the order of their gains.
        path: A .mp4 (VP9) or .gif file; replaced when the new one is complete.
        timeline: `sim_time`: from each run's first sample; or from the start of a later phase of
            each, as `translate_time`.
        length_s: Of the movie [s], 1 to 600, of a .gif to 60. None: real time, and at most 10 s.
        on_picture: Called with the number of pictures done and of all.

    Raises:
        ShowError: Where there is no run, a run lacks the timeline, the length is out of range, or
            the file cannot be written.
        LibraryError: Where what writes such a file is not installed.
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
    encode_movie(draw_pictures(runs, film, size=_SIZES[suffix], on_picture=on_picture), path)
