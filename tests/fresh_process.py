"""Commands and code in processes of their own, forked from one that has loaded the program.

To start Python and load numpy takes most of a short command; how it starts is tested elsewhere.
"""

import multiprocessing
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

_LOADED: Final = (
    *(
        "turtlelog.cli.app",
        "turtlelog.explain",
        "turtlelog.check",
        "turtlelog.charts.curves",
    ),
    *("scipy.optimize", "scipy.signal", "matplotlib.figure", "matplotlib.backends.backend_svg"),
)
_LONGEST_S: Final = 120.0

_METHOD: Final = "forkserver" if sys.platform == "linux" else "spawn"


@dataclass(frozen=True, slots=True)
class Answer:
    """What a process left behind."""

    returncode: int
    stdout: str
    stderr: str


def run_command(*words: str, folder: Path, paths: Sequence[Path] = ()) -> Answer:
    """Run a command of turtlelog in a folder, with more places to import from."""
    return _run(_answer, words, folder, paths)


def run_code(*codes: str, folder: Path) -> Answer:
    """Run Python code as `python -W error -c` does, in a folder that it can import from.

    Of several each begins without the names of those before.
    """
    return _run(_execute, codes, folder, (folder,))


def _run(
    job: Callable[..., None], words: Sequence[str], folder: Path, paths: Sequence[Path]
) -> Answer:
    context: Any = multiprocessing.get_context(_METHOD)
    if _METHOD == "forkserver":
        context.set_forkserver_preload([*_LOADED])
    with tempfile.TemporaryDirectory() as place:
        files = Path(place, "out"), Path(place, "err")
        process = context.Process(target=_start, args=(job, words, folder, paths, files))
        process.start()
        process.join(_LONGEST_S)
        if process.exitcode is None:
            process.kill()
            raise TimeoutError(f"{words}: expected an end within {_LONGEST_S:g} s, found none")
        out, err = (file.read_text("utf-8") for file in files)
        return Answer(process.exitcode, out, err)


def _start(
    job: Callable[..., None],
    words: Sequence[str],
    folder: Path,
    paths: Sequence[Path],
    files: tuple[Path, Path],
) -> None:
    os.chdir(folder)
    sys.path[:0] = map(str, paths)
    for stream, file in zip((sys.stdout, sys.stderr), files, strict=True):
        os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), stream.fileno())
        stream.reconfigure(encoding="utf-8")  # type: ignore[union-attr]
    job(*words)


def _answer(*words: str) -> None:
    from turtlelog.cli.app import main

    sys.argv = ["turtlelog", *words]
    main(words)


def _execute(*codes: str) -> None:
    warnings.simplefilter("error")
    for number, code in enumerate(codes, 1):
        exec(compile(code, f"<block {number}>", "exec"), {"__name__": "__main__"})
