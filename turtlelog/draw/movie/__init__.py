"""Movies of runs: `film` says which moment each picture shows, `picture` draws it."""

from turtlelog.libraries import load_library

load_library("matplotlib")

from turtlelog.draw.movie.movie_file import write_movie

__all__ = ["write_movie"]
