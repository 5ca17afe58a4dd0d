"""Write what the commands of the pages print into the pages: `python -m tests.docs.console_pages`.

Lines that a page leaves out by `...` stay out. Read the difference before it is committed.
"""

import contextlib
import difflib
import io
import os
import shlex
import sys
import tempfile
from pathlib import Path
from typing import Final

from tests.docs.test_pages import PAGES, find_files, list_console, matches_shown, write_files
from turtlelog.cli.app import main

_ALIKE: Final = 0.5
"""Least similarity of a shown line and the printed line that replaces it [1]."""


def run_command(words: list[str]) -> str:
    """Return what a command prints; with an error, its stderr, too."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(words)
        except SystemExit as stop:
            code = stop.code
    return out.getvalue() if not code else out.getvalue() + err.getvalue()


def renew_shown(shown: str, printed: str) -> str:
    """Return what a page shows, with its lines as they are printed now."""
    if matches_shown(shown, printed) or "..." not in shown:
        return shown if matches_shown(shown, printed) else printed
    lines, renewed, place = printed.splitlines(), [], 0
    for line in shown.splitlines():
        if line == "...":
            renewed.append(line)
            continue
        ratios = [
            difflib.SequenceMatcher(None, line, found).ratio() - 0.001 * number
            for number, found in enumerate(lines[place:])
        ]
        best = max(range(len(ratios)), key=ratios.__getitem__, default=None)
        if best is not None and ratios[best] >= _ALIKE:
            kept = "..." in line and matches_shown(line, f"{lines[place + best]}\n")
            if best and renewed[-1:] != ["..."]:
                renewed.append("...")  # a new line is printed before this one
            renewed.append(line if kept else lines[place + best])
            place += best + 1
    return "".join(f"{line}\n" for line in renewed)


def renew_page(page: Path) -> None:
    """Run the commands of a page in an empty folder, and write what they print into it."""
    text, place = page.read_text("utf-8"), 0
    found, files = list_console(page), find_files(page)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        write_files(files, Path(folder))
        for command, shown in found:
            block = f"$ turtlelog {command}\n"
            place = text.index(block + shown, place) + len(block)
            new = renew_shown(shown, run_command(shlex.split(command)))
            text = text[:place] + new + text[place + len(shown) :]
            place += len(new)
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    names = sys.argv[1:]
    sys.path.insert(0, "")
    os.environ.setdefault("COLUMNS", "80")
    for one in PAGES:
        if list_console(one) and (not names or one.stem in names):
            renew_page(one)
