"""A recording read while it is being written: every chunk once, as soon as it is whole."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from turtlelog.log.complete_files import is_live
from turtlelog.log.engine.blocks import build_walked_block
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.decode import Rows
from turtlelog.log.engine.integrity import check_start
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.source import Selection, read_piece
from turtlelog.log.engine.walk import Section, walk_growing
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.recording.contents import build_contents, reconcile_contents
from turtlelog.log.recording.reader import build_run
from turtlelog.log.recording.topics import POSE
from turtlelog.run import Run

_EVERYTHING = Selection()
_ANY_SIZE = 2**40  # bytes; nobody knows how large it becomes


class RecordingTail:
    """An open recording of turtlelog's own that may still grow.

    Attributes:
        is_finished: Whether its end has been read.
    """

    def __init__(self, path: str | Path) -> None:
        """Open it.

        Raises:
            LogError: Where it cannot be read, or is no MCAP file.
        """
        self.is_finished = False
        self._path, self._place = Path(path), len(MCAP0_MAGIC)
        self._allowance = Allowance(_ANY_SIZE)
        self._catalogue = Catalogue(self._allowance)
        self._records: list[Any] = []
        self._parts: dict[str, list[Rows]] = {}
        with ExitStack() as closing, name_file(path, expected="a turtlelog recording"):
            self._stream = closing.enter_context(open_file(self._path))
            check_start(self._stream)
            closing.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stream.close()

    @property
    def is_live(self) -> bool:
        """Whether a program still writes to it; False where the system has no locks to tell."""
        return is_live(self._path)

    def read_run(self) -> Run | None:
        """Return the run so far, None where nothing came since the last call, or no pose yet.

        Raises:
            LogError: Where it is no recording by turtlelog.
        """
        with name_file(self._path, expected="a turtlelog recording"):
            has_grown = [self._take(section) for section in self._read_sections()]
            return self._build() if any(has_grown) and POSE.name in self._parts else None

    def read_last_run(self) -> Run:
        """Return the run so far, however little of it is there.

        Raises:
            LogError: Where it is no recording by turtlelog, or holds no pose.
        """
        self.read_run()
        with name_file(self._path, expected="a turtlelog recording"):
            return self._build()

    def _build(self) -> Run:
        # What is built takes its parts over, and these are needed again.
        parts = {topic: [dict(rows) for rows in found] for topic, found in self._parts.items()}
        contents = build_contents(self._records, self._catalogue, parts, ())
        return build_run(reconcile_contents(contents)[0])

    def _read_sections(self) -> Iterator[Section]:
        for section, place in walk_growing(self._stream, self._place):
            self._place = place
            if section is not None:
                yield section

    def _take(self, section: Section) -> bool:
        """Add a section; return whether there is something to see in it."""
        if not section.is_chunk and section.data[0] == Opcode.DATA_END:
            self.is_finished = True
            return False
        block = build_walked_block(
            section.data, section.start, self._allowance, is_chunk=section.is_chunk
        )
        self._catalogue.add(block.rest, block.byte)
        self._records += block.rest
        piece = read_piece(self._catalogue, _EVERYTHING, block, block.offsets)
        for topic, rows in piece.rows.items():
            self._parts.setdefault(topic, []).append(rows)
        return True
