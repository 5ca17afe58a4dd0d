"""Output files that are complete or absent, and the content policy of HTML pages."""

from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Final

from turtlelog.errors import LogError, ShowError
from turtlelog.files.urls import make_path
from turtlelog.log import replace_when_complete


@contextmanager
def replace_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file name; this file replaces `path` if the block succeeds.

    Raises:
        ShowError: If the folder cannot be written.
    """
    try:
        with replace_when_complete(path) as part_path:
            yield part_path
    except LogError as err:
        raise ShowError(str(err)) from err


@contextmanager
def replace_together(folder: str | Path) -> Iterator[Callable[[str, bytes], Path]]:
    """Yield a function that writes files into a folder by name; all appear together at the end.

    If the block fails, no file and no new folder remain.

    Raises:
        ShowError: If the folder cannot be written.
    """
    folder = make_path(folder)
    with ExitStack() as undoing:
        try:
            for new in [place for place in (folder, *folder.parents) if not place.exists()][::-1]:
                new.mkdir(exist_ok=True)
                undoing.callback(_remove_folder, new)
            folder.mkdir(exist_ok=True)
        except OSError as err:
            raise ShowError(
                f"{folder}: expected a folder to write to, found: {err.strerror or err}"
            ) from err
        with ExitStack() as parts:

            def write(name: str, data: bytes) -> Path:
                parts.enter_context(replace_file(folder / name)).write_bytes(data)
                return folder / name

            yield write
        undoing.pop_all()


def _remove_folder(folder: Path) -> None:
    with suppress(OSError):  # another program may write there, too
        folder.rmdir()


_SOURCES: Final = {
    "default_src": "'none'",
    "style_src": "'unsafe-inline'",
    "img_src": "data: blob:",
    "base_uri": "'none'",
    "form_action": "'none'",
}
"""Allowed sources. Bokeh and Rerun write styles while they draw; other rules prevent styles from
loading anything."""


def write_policy(scripts: Iterable[str], **more: str) -> str:
    """Return a policy that allows the scripts in the page by their hashes, and nothing remote.

    Data blocks, for example of JSON, are not scripts. `more` are further sources by directive, with
    `_` for `-`, as in `connect_src="'self'"`.
    """
    hashes = (b64encode(sha256(code.encode()).digest()).decode() for code in scripts)
    ours = {"script_src": " ".join(f"'sha256-{found}'" for found in hashes), **_SOURCES}
    sources = {
        name: f"{ours.get(name, '')} {more.get(name, '')}".strip() for name in {**ours, **more}
    }
    return "; ".join(
        f"{name.replace('_', '-')} {source}" for name, source in sources.items() if source
    )


def write_policy_tag(*scripts: str) -> str:
    """Return the policy as a tag for the head of a page, which must precede all that loads."""
    policy = write_policy(scripts)
    return f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
