"""Movie options, shared by `plot` and `view`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from turtlelog.cli.options import Place
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import Run

_SUFFIXES = (".mp4", ".gif")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MovieOptions:
    """A movie of the runs.

    Attributes:
        movie: Write a movie of the runs driving into this .mp4 (VP9) or .gif file.
        length: Length of the movie [s], 1 to 600. Default: real time, at most 10 s.
    """

    movie: Place | None = None
    length: Annotated[float | None, Parameter(metavar="SECONDS")] = None


def require_movie(options: MovieOptions, files: Sequence[Path]) -> None:
    """Refuse a movie that cannot be written, before any file is read."""
    if options.movie is None:
        if options.length is not None:
            raise UsageError("--length: needs --movie NAME.mp4")
        return
    suffix = options.movie.suffix.lower()
    if suffix not in _SUFFIXES:
        raise UsageError(f"--movie {options.movie}: the name must end in .mp4 or .gif")
    require_new_target(options.movie, files, suffix=suffix)
    from turtlelog.draw.movie.movie_file import require_encoder

    require_encoder(suffix)


def film_runs(runs: "Sequence[Run]", options: MovieOptions, *, timeline: str) -> None:
    """Write the movie if one is requested."""
    if options.movie is None:
        return
    from turtlelog.draw.movie import write_movie

    bare = next((run.name for run in runs if not len(run.poses)), None)
    if bare is not None:
        raise UsageError(f"--movie: {bare} has commands alone, and a movie needs poses")
    with show_progress("filming", 100.0, "%") as progress:
        write_movie(
            runs,
            options.movie,
            timeline=timeline,
            length_s=options.length,
            on_picture=progress.count,
        )
