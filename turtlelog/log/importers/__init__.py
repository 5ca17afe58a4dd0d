"""Other people's logs -> Run, one layout per file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from mcap.writer import MCAP0_MAGIC

from turtlelog.errors import LogError
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.importers.paper_layouts import parse_paper_csv, parse_paper_json
from turtlelog.log.importers.paper_log import PaperLog, build_paper_run
from turtlelog.run import Run

__all__ = ["LOG_SUFFIXES", "import_log"]

_IMPORTERS: Final[Mapping[str, Callable[[str, Path], PaperLog]]] = MappingProxyType(
    {".json": parse_paper_json, ".csv": parse_paper_csv}
)
LOG_SUFFIXES: Final = frozenset(_IMPORTERS)
"""How the names of logs end."""


def import_log(path: str | Path, *, sort: bool = False) -> Run:
    """Return the run in a log of the paper's controller, JSON or CSV.

    Args:
        path: The log; a name that ends otherwise is told by its content.
        sort: Sort rows by time and drop exact duplicates; both are counted in the run's notes.

    Raises:
        LogError: One line with the file, the list and the index, where the log is wrong.
    """
    path = Path(path)
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
        # Spreadsheets put a byte order mark in front.
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise LogError(
            f"byte {err.start}: expected UTF-8 text, found 0x{err.object[err.start]:02x}"
        ) from err
    if not text.strip():
        raise LogError("expected a log, found an empty file")
    return text
