import struct
from io import BytesIO
from pathlib import Path

import pytest
from mcap.stream_reader import StreamReader

from tests.log.runs import find_shared
from tests.torture.recordings import COMPRESSIONS, list_records, make_recording, pack_again
from turtlelog.log.engine.walk import Section, walk_sections
from turtlelog.log.file_access import Loss

CHUNK, INDEX, METADATA, DATA_END, HEAD = 6, 7, 12, 15, 9
KINDS = {1: "Header", 3: "Schema", 4: "Channel", 5: "Message", 9: "Attachment", 12: "Metadata"}


@pytest.fixture(scope="module", params=COMPRESSIONS)
def sound(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return make_recording(tmp_path_factory.mktemp("recordings"), request.param)


@pytest.fixture(scope="module")
def lone(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a recording whose messages stand alone, without chunks."""
    whole = make_recording(tmp_path_factory.mktemp("recordings"), "none")
    return pack_again(whole, "none", use_chunking=False)


def walk(data: bytes) -> tuple[list[Section], list[Loss]]:
    found = list(walk_sections(BytesIO(data)))
    sections = [section for section in found if isinstance(section, Section)]
    return sections, [damage for damage in found if isinstance(damage, Loss)]


def split(sections: list[Section]) -> list[bytes]:
    """Return the records of sections, the end of the data left out."""
    records = []
    for section in sections:
        place = 0
        while place < len(section.data):
            opcode, length = struct.unpack_from("<BQ", section.data, place)
            if opcode != DATA_END:
                records.append(section.data[place : place + HEAD + length])
            place += HEAD + length
    return records


def find(data: bytes, opcode: int, number: int = 0) -> tuple[int, int]:
    """Return place and end of a record."""
    places = [(at, at + HEAD + length) for kind, at, length in list_records(data) if kind == opcode]
    return places[number]


def change(data: bytes, place: int, new: bytes) -> bytes:
    return data[:place] + new + data[place + len(new) :]


def test_a_sound_file_comes_whole_and_checked(sound: bytes) -> None:
    sections, damages = walk(sound)
    assert damages == []
    assert sections[-1].data[0] == DATA_END
    assert sections[-1].is_checked
    assert all(section.is_checked for section in sections if section.is_chunk)
    assert sum(section.is_chunk for section in sections) > 3


@pytest.mark.parametrize("folder", ["conformance", "ros2"])
def test_files_by_others_come_whole(folder: str) -> None:
    for path in sorted(find_shared(folder).rglob("*.mcap")):
        data = path.read_bytes()
        sections, damages = walk(data)
        expected = []
        for record in StreamReader(BytesIO(data)).records:
            if type(record).__name__ == "DataEnd":
                break
            expected.append(type(record).__name__)
        found = [KINDS[record[0]] for record in split(sections)]
        assert (damages, found) == ([], [name for name in expected if name != "MessageIndex"]), path


def test_everything_before_a_cut_comes(sound: bytes) -> None:
    whole, _ = walk(sound)
    end_of_data, _ = find(sound, DATA_END)
    chunks = [(at, at + HEAD + size) for kind, at, size in list_records(sound) if kind == CHUNK]
    for length in range(8, end_of_data, 7):
        sections, damages = walk(sound[:length])
        assert sections == whole[: len(sections)]
        complete = [place for place, end in chunks if end <= length]
        assert [section.start for section in sections if section.is_chunk] == complete
        assert damages[-1].end == length


def test_a_damaged_chunk_is_left_out_alone(sound: bytes) -> None:
    place, end = find(sound, CHUNK, 1)
    sections, damages = walk(change(sound, end - 40, b"\xa5\x5a\xa5"))
    whole, _ = walk(sound)
    assert [section.start for section in sections] == [
        section.start for section in whole if section.start != place
    ]
    assert [(damage.start, damage.end) for damage in damages] == [(place, end)]


@pytest.mark.parametrize("offset", [0, 4, 8], ids=["opcode", "length", "high-length"])
def test_walking_goes_on_after_a_header_that_makes_no_sense(sound: bytes, offset: int) -> None:
    place, end = find(sound, CHUNK, 1)
    sections, damages = walk(change(sound, place + offset, b"\x7f"))
    whole, _ = walk(sound)
    missing = {section.start for section in whole} - {section.start for section in sections}
    assert missing == ({place} if offset == 0 else set())
    assert damages[0].start == place
    assert damages[-1].end <= end


def test_a_wrong_length_is_made_good_by_the_checksum_and_told(sound: bytes) -> None:
    place, _ = find(sound, CHUNK, 1)
    for offset in (HEAD + 16, HEAD + 17):  # size unpacked
        sections, damages = walk(change(sound, place + offset, b"\xee"))
        assert split(sections) == split(walk(sound)[0])
        assert "found a header that says otherwise" in damages[0].reason


def test_a_length_that_lies_is_not_believed(sound: bytes) -> None:
    for opcode, place, _ in list_records(sound):
        if opcode == DATA_END:
            break
        for claim in (2**20, 2**29, 2**40, 2**63):
            sections, damages = walk(change(sound, place + 1, claim.to_bytes(8, "little")))
            assert damages
            assert set(split(sections)) <= set(split(walk(sound)[0]))


def test_messages_within_a_damaged_chunk_never_come_alone(tmp_path: Path) -> None:
    data = make_recording(tmp_path, "none")
    for number in range(5):
        place, _ = find(data, CHUNK, number)
        for header in (b"\x7f" * HEAD, b"\x00" * HEAD, b"\xff" * 60):
            sections, damages = walk(change(data, place, header))
            assert damages
            assert all(section.is_chunk for section in sections if section.data[0] in {3, 4, 5})


def test_one_bit_makes_no_message(sound: bytes) -> None:
    for opcode, place, length in list_records(sound):
        if opcode in {1, INDEX}:
            sections, damages = walk(change(sound, place, b"\x05"))
            assert not any(section.data[0] == 5 and not section.is_chunk for section in sections)
            assert damages[0].start == place
            assert damages[0].end >= place + HEAD + length


@pytest.mark.parametrize("opcode", [METADATA, 9], ids=["metadata", "attachment"])
def test_one_bit_does_not_end_the_data(sound: bytes, opcode: int) -> None:
    place, _ = find(sound, opcode)
    for bit in range(8):
        sections, damages = walk(change(sound, place, bytes([opcode ^ 1 << bit])))
        assert split(sections)[-20:] == split(walk(sound)[0])[-20:]
        assert damages


def test_a_private_record_is_stepped_over(sound: bytes) -> None:
    place, _ = find(sound, CHUNK)
    private = b"\x80" + (5).to_bytes(8, "little") + b"hello"
    data = sound[:place] + private + sound[place:]
    assert split(walk(data)[0]) == split(walk(sound)[0])


def test_a_chunk_under_a_private_opcode_is_missed(sound: bytes) -> None:
    place, end = find(sound, CHUNK, 1)
    _, damages = walk(change(sound, place, b"\x86"))
    assert [(damage.start, damage.end) for damage in damages] == [(place, end)]


def test_a_chunk_without_a_checksum_is_not_called_checked(sound: bytes) -> None:
    place, _ = find(sound, CHUNK)
    sections, _ = walk(change(sound, place + HEAD + 24, bytes(4)))
    chunks = [section for section in sections if section.is_chunk]
    assert [section.is_checked for section in chunks] == [False] + [True] * (len(chunks) - 1)


def test_the_data_checksum_finds_what_no_other_covers(sound: bytes) -> None:
    _, end = find(sound, METADATA)
    sections, damages = walk(change(sound, end - 2, b"!"))
    assert len(split(sections)) == len(split(walk(sound)[0]))
    place, _ = find(sound, DATA_END)
    assert [(damage.start, damage.end) for damage in damages] == [(place, place)]
    assert "expected data with the checksum" in damages[0].reason


def test_messages_alone_come_in_batches(lone: bytes) -> None:
    sections, damages = walk(lone)
    assert damages == []
    assert not any(section.is_chunk or section.is_checked for section in sections[:-1][-1:])
    assert sum(record[0] == 5 for record in split(sections)) == 51


def test_messages_alone_are_found_again_after_damage(lone: bytes) -> None:
    before, place = find(lone, 5, 9)
    _, end = find(lone, 5, 10)
    sections, damages = walk(change(lone, place, b"\xff\xff\x7f\xff\xff\xff\xff\xff\xff"))
    # Of the one before, nothing says any more that its length is right.
    lost = {lone[before:place], lone[place:end]}
    assert split(sections) == [record for record in split(walk(lone)[0]) if record not in lost]
    assert [(damage.start, damage.end) for damage in damages] == [(before, end)]


@pytest.mark.parametrize(("between", "found"), [(4, 0), (5, 4)])
def test_four_messages_in_a_row_are_found_between_damage(
    lone: bytes, between: int, found: int
) -> None:
    # Nothing bears out the length of the last one before damage.
    first, _ = find(lone, 5, 9)
    last, _ = find(lone, 5, 10 + between)
    garbage = b"\xff" * HEAD
    sections, _ = walk(change(change(lone, first, garbage), last, garbage))
    records = [section for section in sections if first < section.start < last]
    assert len(split(records)) == found


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r\n", bytes(5000), b"time,x\n" * 900])
def test_what_is_no_recording_is_damage(data: bytes) -> None:
    sections, damages = walk(data)
    assert sections == []
    assert damages[-1].end == len(data)
