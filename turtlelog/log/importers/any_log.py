"""Import of third-party logs and tables. The name and the content determine the layout."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from turtlelog.errors import LogError
from turtlelog.files.urls import make_path
from turtlelog.log.engine.framing import MCAP0_MAGIC
from turtlelog.log.file_access import name_file, open_file
from turtlelog.log.importers.paper_log import (
    PAPER_MARKS,
    PaperLog,
    build_paper_run,
    parse_paper_csv,
    parse_paper_json,
)
from turtlelog.log.importers.plain_tables import import_plain_table
from turtlelog.log.importers.table_text import read_header
from turtlelog.run import Run

_IMPORTERS: Final[Mapping[str, Callable[[str, Path], PaperLog]]] = MappingProxyType(
    {".json": parse_paper_json, ".csv": parse_paper_csv}
)


def import_other(path: Path, columns: Mapping[str, str]) -> Run:
    """Return the run in a log of the paper, or else in a plain table.

    Args:
        path: The file.
        columns: The user's mapping of table columns; with it, the file is not read as a paper's
            log.

    Raises:
        LogError: If the file is neither or is invalid; one line with the file and the place.
    """
    if path.suffix.lower() == ".json" or (not columns and is_papers(path)):
        return import_log(path)
    return import_plain_table(path, columns)


def is_papers(path: Path) -> bool:
    """Return whether a CSV file has the columns of the paper's logs."""
    return path.suffix.lower() == ".csv" and not PAPER_MARKS.isdisjoint(read_header(path))


def import_log(path: str | Path, *, sort: bool = False) -> Run:
    """Return the run in a log of the paper's controller, JSON or CSV.

    Args:
        path: Path of the log; for other suffixes the content determines the format.
        sort: Whether to sort rows by time and drop exact duplicates; notes give both counts.

    Raises:
        LogError: If the log is invalid; one line with the file, the list and the index.
    """
    path = make_path(path)
    with name_file(path, expected="a log of the paper's layout, .json or .csv"):
        text = _read_text(path)
        suffix = path.suffix.lower()
        if suffix not in _IMPORTERS:
            suffix = ".json" if text.lstrip().startswith(("{", "[")) else ".csv"
        return build_paper_run(_IMPORTERS[suffix](text, path), sort=sort)


def _read_text(path: Path) -> str:
    with open_file(path) as stream:
        data = stream.read()
    if data.startswith(MCAP0_MAGIC):
        raise LogError("expected a log in JSON or CSV, found MCAP, which is read as it is")
    try:
        # Spreadsheet programs write a byte order mark first.
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise LogError(
            f"byte {err.start}: expected UTF-8 text, found 0x{err.object[err.start]:02x}"
        ) from err
    if not text.strip():
        raise LogError("expected a log, found an empty file")
    return text
