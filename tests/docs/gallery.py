"""Draw the pictures of the gallery: the commands of its page, in the folder of the pages.

python -m tests.docs.gallery
"""

import os
import shlex
from pathlib import Path

from tests.docs.test_pages import list_console
from turtlelog.cli.app import main

DOCS = Path(__file__).parents[2] / "docs"


def draw_gallery() -> None:
    """Run each command of the page."""
    os.chdir(DOCS)
    (DOCS / "gallery").mkdir(exist_ok=True)
    for command, _ in list_console(DOCS / "gallery.md"):
        try:
            main(shlex.split(command))
        except SystemExit as stop:
            if stop.code:
                raise
    (DOCS / "delays.parquet").unlink()


if __name__ == "__main__":
    draw_gallery()
