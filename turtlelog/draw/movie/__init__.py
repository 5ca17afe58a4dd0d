"""Movies of runs: `movie_file` chooses the time of each picture, `picture` draws it."""

from turtlelog.libraries import load_library

load_library("matplotlib")

from turtlelog.draw.movie.movie_file import write_movie

__all__ = ["write_movie"]
