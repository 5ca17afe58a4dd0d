"""Records that end in bytes which the specification does not know yet: read as without them."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode

from tests.log.padding import FIXED, pad_file
from tests.log.runs import find_shared
from tests.torture.outcomes import describe
from tests.torture.recordings import COMPRESSIONS, make_recording, pack_again
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info, read_recording
from turtlelog.log.engine import read_raw
from turtlelog.log.recovery import recover_recording


def make_head(opcode: int, length: int) -> bytes:
    return struct.pack("<BQ", opcode, length)


PADDINGS = {
    "counting": b"\1\2\3",
    "one": b"\1",
    "zeros": bytes(40),
    "forty": bytes(range(40)),
    "channel": make_head(Opcode.CHANNEL, 60),
    "message": make_head(Opcode.MESSAGE, 30),
    "message-index": make_head(Opcode.MESSAGE_INDEX, 22),
    "metadata": make_head(Opcode.METADATA, 40),
    "private": make_head(0x80, 0),
}
READS: dict[str, Callable[[Path], Any]] = {
    "columns": lambda path: dict(read_columns(path)),
    "raw": read_raw,
    "info": read_info,
    "recording": read_recording,
}


def read_all(data: bytes, folder: Path) -> dict[str, Any]:
    """Return what every way to read a file gives: values, or the error's text."""
    path, output = folder / "in.mcap", folder / "out.mcap"
    path.write_bytes(data)
    found = {}
    for name, read in READS.items():
        try:
            found[name] = describe(read(path))
        except LogError as err:
            found[name] = str(err)
    try:
        report = recover_recording(path, output)
        found["recover"] = describe(report), output.read_bytes()
    except LogError as err:
        found["recover"] = str(err)
    return found


@dataclass(frozen=True, kw_only=True)
class Suite:
    """The files of the conformance suite, and what reading each gives."""

    folder: Path
    files: dict[str, tuple[bytes, dict[str, Any]]]


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    folder, files = tmp_path_factory.mktemp("suite"), {}
    for path in sorted(find_shared("conformance").glob("*/*.mcap")):
        data = path.read_bytes()
        files[path.stem] = data, read_all(data, folder)
    return Suite(folder=folder, files=files)


@pytest.mark.parametrize(
    ("padding", "fixed"),
    [*((padding, FIXED) for padding in PADDINGS.values()), (b"\1\2\3", FIXED | {Opcode.CHUNK})],
    ids=[*PADDINGS, "no-chunk"],
)
def test_padded_files_of_the_suite_are_read_as_their_twins(
    suite: Suite, padding: bytes, fixed: frozenset[int]
) -> None:
    differing = [
        name
        for name, (data, expected) in suite.files.items()
        if read_all(pad_file(data, padding, fixed=fixed), suite.folder) != expected
    ]
    assert (len(suite.files), differing) == (208, [])


@pytest.mark.parametrize("padding", PADDINGS.values(), ids=PADDINGS)
@pytest.mark.parametrize("kind", [*COMPRESSIONS, "alone"])
def test_padded_recordings_are_read_as_their_twins(
    kind: str, padding: bytes, tmp_path: Path
) -> None:
    data = make_recording(tmp_path, "none" if kind == "alone" else kind)
    if kind == "alone":
        data = pack_again(data, "none", use_chunking=False)
    twin = read_all(pad_file(data, padding), tmp_path)
    assert twin == read_all(data, tmp_path)
    assert dict(twin["recover"][0])["complete"] == "True"
