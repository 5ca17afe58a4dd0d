"""`turtlelog run --watch`: a new run after every save, with the changes."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import (
    EXIT_FINE,
    EXIT_INTERRUPTED,
    fit_table,
    flush_stdout,
    print_error,
    print_note,
)
from turtlelog.display import describe_count
from turtlelog.errors import TurtlelogError, UsageError

if TYPE_CHECKING:
    from turtlelog import Run, Scenario

_POLL_S: Final = 0.1
"""Time between two checks of the files [s]: too short to notice, and long enough that reading some
kilobytes takes no measurable time."""

_Texts = Mapping[Path, tuple[int, bytes] | None]


def list_watched(scenario_file: Path | None, kind: str | None) -> tuple[Path, ...]:
    """Return the files that determine a run: the file of the scenario, and the file of the law.

    Raises:
        UsageError: If no such file is named, or a file is missing.
    """
    place = (kind or "").rpartition(":")[0]
    law_file = Path(place) if place.endswith(".py") else None
    files = tuple(file for file in (scenario_file, law_file) if file is not None)
    if not files:
        raise UsageError(
            f"--watch: the law {kind} has no file to watch; name a scenario file, or a law as"
            " path.py:Class"
        )
    for file in files:
        if not file.is_file():
            raise UsageError(f"{file}: no such file to watch")
    return files


def watch_runs(
    files: Sequence[Path],
    load: "Callable[[], tuple[Scenario, Sequence[Path]]]",
    simulate: "Callable[[Scenario], Run]",
    answer: "Callable[[Run, Run | None], int]",
    *,
    is_over: Callable[[], bool],
) -> int:
    """Run, and run again after each save of a file until Ctrl-C; return the exit code.

    An error of the law or the scenario is printed in one line; the next save runs again.

    Args:
        files: Files to watch until a scenario is loaded.
        load: Function that returns the present scenario, and the files to watch.
        simulate: Function that runs the scenario.
        answer: Function that prints a run next to the previous run and returns an exit code; any
            code except 0 ends the watch.
        is_over: Function that returns whether to stop, called between checks.
    """
    before: Run | None = None
    told: Sequence[Path] = ()
    try:
        while True:
            seen = _read_texts(files)
            try:
                scenario, files = load()
                seen = {**_read_texts(files), **seen}
                run = simulate(scenario)
                code = answer(run, before)
                if code != EXIT_FINE:
                    return code
                before = run
            except (TurtlelogError, OSError) as err:
                print_error(str(err))
            flush_stdout()
            if told != files:
                names = ", ".join(map(str, files))
                print_note(f"watching {names}: every save runs again, Ctrl-C ends")
                told = files
            saved = _wait_for_save(files, seen, is_over)
            if saved is None:
                return EXIT_FINE
            print_note(f"saved: {saved}")
    except KeyboardInterrupt:
        print_note("watch ended")
        return EXIT_INTERRUPTED


def describe_change(run: "Run", before: "Run") -> str:
    """Return a table of the essential metrics that changed, with their former values."""
    declarations = run.declaration, before.declaration
    essential = tl.measure.list_essential_metrics(*declarations)
    now, was = tl.measure_run(run), tl.measure_run(before)
    changed = [name for name in essential if now.get(name) != was.get(name)]
    if not changed:
        return "No metric changed."
    kept = [{name: one[name] for name in changed if name in one} for one in (now, was)]
    text = fit_table(tl.compare.tabulate_measured(("now", "before"), kept))
    same = len(essential) - len(changed)
    return f"{text}\n{describe_count(same, 'essential metric')} did not change." if same else text


def _wait_for_save(files: Sequence[Path], seen: _Texts, is_over: Callable[[], bool]) -> Path | None:
    """Return the first saved file after two equal checks of all files; None at the end.

    Editors write in several steps, or delete a file and write it again. A file that has changed
    since the last check may change again, and a missing file is not saved yet.
    """
    last: _Texts = {}
    while not is_over():
        time.sleep(_POLL_S)
        now = _read_texts(files)
        saved = [file for file in files if now[file] not in (None, seen.get(file))]
        if saved and now == last:
            return saved[0]
        last = now
    return None


def _read_texts(files: Sequence[Path]) -> _Texts:
    """Return time and content of each file; None for a file that cannot be read.

    The time shows a save without changes; the content shows a second save within one tick of the
    file system's clock, which may be two seconds long.
    """
    found: dict[Path, tuple[int, bytes] | None] = {}
    for file in files:
        found[file] = None
        with suppress(OSError):
            found[file] = file.stat().st_mtime_ns, file.read_bytes()
    return found
