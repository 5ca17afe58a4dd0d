"""Records that end in bytes which the specification does not know yet: read as without them."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from itertools import islice, pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zlib import crc32

import pytest
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from tests.log.engine.files import POINT, Row, pack, write_rows
from tests.log.engine.raw_records import read_raw
from tests.log.padding import FIXED, HEAD, pad_file
from tests.log.runs import find_shared
from tests.torture.outcomes import describe
from tests.torture.recordings import COMPRESSIONS, list_records, make_recording, pack_again
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info, read_recording
from turtlelog.log.engine.walk import Section, walk_sections
from turtlelog.log.file_access import Loss
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


ALL_PADDINGS = {name: (padding, FIXED) for name, padding in PADDINGS.items()}
ALL_PADDINGS["no-chunk"] = b"\1\2\3", FIXED | {Opcode.CHUNK}


@pytest.mark.everyday("forty")
@pytest.mark.parametrize("kind", ALL_PADDINGS)
def test_padded_files_of_the_suite_are_read_as_their_twins(suite: Suite, kind: str) -> None:
    padding, fixed = ALL_PADDINGS[kind]
    assert len(suite.files) == 208
    # A third each: by their names the files have one part more or less by turns, in powers of two.
    files = islice(suite.files.items(), [*ALL_PADDINGS].index(kind) % 3, None, 3)
    differing = [
        name
        for name, (data, expected) in files
        if read_all(pad_file(data, padding, fixed=fixed), suite.folder) != expected
    ]
    assert differing == []


@pytest.mark.everyday(
    "zstd-message-index", "lz4-zeros", "none-forty", "alone-message", "zstd-counting", "lz4-private"
)
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


def list_reasons(data: bytes) -> list[str]:
    walked = walk_sections(BytesIO(data))
    return [found.reason for found in walked if isinstance(found, Loss)]


@pytest.mark.parametrize("records", [3, 4])
def test_four_whole_records_in_a_padding_are_records_that_a_wrong_length_swallows(
    records: int, tmp_path: Path
) -> None:
    whole = make_head(Opcode.METADATA, 8) + bytes(8)
    padded = pad_file(make_recording(tmp_path, "zstd"), records * whole + b"\xff" * 9)
    assert bool(list_reasons(padded)) == (records >= 4)


@pytest.mark.parametrize("kind", COMPRESSIONS)
def test_a_length_that_swallows_the_next_record_is_damage(kind: str, tmp_path: Path) -> None:
    data = make_recording(tmp_path, kind)
    records = list_records(data)
    end = [kind for kind, _, _ in records].index(Opcode.DATA_END)
    for (_, place, length), (_, _, next_length) in pairwise(records[:end]):
        longer = length + HEAD + next_length
        damaged = data[: place + 1] + struct.pack("<Q", longer) + data[place + HEAD :]
        assert list_reasons(damaged), place


@pytest.mark.parametrize("padding", [b"\1\2\3", bytes(40)], ids=["counting", "zeros"])
@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.ATTACHMENT])
def test_a_checksum_vouches_for_a_padded_record_that_damage_follows(
    opcode: int, padding: bytes, tmp_path: Path
) -> None:
    data = pad_file(make_recording(tmp_path, "lz4"), padding)
    records = list_records(data)
    for (kind, place, _), (_, after, _) in pairwise(records):
        if kind == opcode:
            damaged = data[:after] + b"\xff" * HEAD + data[after + HEAD :]
            walked = list(walk_sections(BytesIO(damaged)))
            assert any(isinstance(one, Section) and one.start == place for one in walked)
            assert any(isinstance(one, Loss) for one in walked)


def make_attachment(size: int, name: bytes = b"a") -> bytes:
    """Return an attachment whose checksum holds; its record claims a byte more than is there."""
    body = bytes(16) + make_text(name) + make_text(b"b") + struct.pack("<Q", size) + bytes(size)
    return make_head(Opcode.ATTACHMENT, len(body) + 5) + body + struct.pack("<I", crc32(body))


def make_text(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def test_a_checksum_is_looked_for_in_as_many_bytes_as_the_file_has() -> None:
    one = MCAP0_MAGIC + make_attachment(20_000)
    assert any(isinstance(found, Section) for found in walk_sections(BytesIO(one + bytes(100))))


@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.ATTACHMENT])
def test_records_that_claim_each_others_bytes_are_not_read_many_times_over(
    opcode: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    index = make_head(Opcode.MESSAGE_INDEX, 6) + bytes(6)
    head = make_attachment(50_000)[:51]
    if opcode == Opcode.CHUNK:
        head = make_head(opcode, 50) + struct.pack("<QQQIIQ", 0, 0, 50_000, 1, 0, 50_000)
    data = MCAP0_MAGIC + 1000 * (head + index) + b"\xff" * 50_000
    counted: list[int] = []

    def count(data: bytes, start: int = 0) -> int:
        counted.append(len(data))
        return crc32(data, start)

    for module in ("walk", "limits"):
        monkeypatch.setattr(f"turtlelog.log.engine.{module}.zlib", SimpleNamespace(crc32=count))
    assert list_reasons(data)
    assert len(data) / 2 < sum(counted) <= len(data)


@pytest.mark.parametrize("padding", [b"\1\2\3", bytes(40)], ids=["counting", "zeros"])
def test_what_stands_before_a_cut_of_a_padded_file_is_recovered(
    padding: bytes, tmp_path: Path
) -> None:
    data = pad_file(make_recording(tmp_path, "zstd"), padding)
    end = next(place for kind, place, _ in list_records(data) if kind == Opcode.DATA_END)
    chunks = [(place, HEAD + length) for kind, place, length in list_records(data) if kind == 6]
    for length in range(8, end, 13):
        walked = list(walk_sections(BytesIO(data[:length])))
        found = [one.start for one in walked if isinstance(one, Section) and one.is_chunk]
        whole = [place for place, size in chunks if place + size - len(padding) <= length]
        assert found == whole
        assert isinstance(walked[-1], Loss)


@pytest.mark.parametrize("surplus", [3, 4])
def test_up_to_three_bytes_behind_the_fields_of_a_message_are_ignored(
    surplus: int, tmp_path: Path
) -> None:
    # The specification does not extend messages: what their records hold more is their data.
    data = pack([("float64", 1.0), ("float64", 2.0)]) + bytes(surplus)
    path = write_rows(
        tmp_path / "a.mcap",
        {"/p": ("test/msg/Point", POINT)},
        [Row(topic="/p", time_ns=number, data=data) for number in range(3)],
    )
    if surplus < 4:
        assert read_columns(path)["/p"].fields["y"].tolist() == [2.0] * 3
        return
    with pytest.raises(LogError, match="message 0: expected 20 bytes, found 24"):
        read_columns(path)
