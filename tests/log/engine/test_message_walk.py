import random
from typing import Any

import pytest

from turtlelog.log.engine.records import MessageWalk, skip_followed, take_apart


def join(lengths: list[int]) -> bytes:
    """Return message records of these lengths, each of channel 1."""
    return b"".join(
        b"\5" + length.to_bytes(8, "little") + b"\1\0" + bytes(length - 2) for length in lengths
    )


def list_starts(lengths: list[int]) -> list[int]:
    starts = [0]
    for length in lengths:
        starts.append(starts[-1] + 9 + length)
    return starts


def draw_lengths(seed: int) -> list[int]:
    """Return lengths in turns; some interrupted, replaced, or of other turns, or none at all."""
    rng = random.Random(seed)
    lengths: list[int] = []
    for _ in range(rng.randint(1, 4)):
        turn = [rng.choice([22, 30, 54, 82]) for _ in range(rng.choice([1, 3, 7, 60, 70]))]
        for place in range(rng.choice([10, 300, 2500])):
            if rng.random() < 0.004:
                lengths.append(rng.randint(22, 90))
            if rng.random() > 0.002:
                lengths.append(turn[place % len(turn)])
    return lengths


@pytest.mark.parametrize("seed", range(12))
def test_every_message_is_found_where_it_starts(seed: int) -> None:
    lengths = draw_lengths(seed)
    data, starts = join(lengths), list_starts(lengths)
    found = take_apart(data, is_chunk=True, most_records=len(lengths))
    assert (found.starts.tolist(), found.fault) == (starts[:-1], None)
    few = take_apart(data, is_chunk=True, most_records=len(lengths) - 1)
    assert few.starts.tolist() == starts[:-2]
    assert few.fault is not None
    assert skip_followed(data) == starts[-2]
    assert skip_followed(data[: starts[-2] + 40]) == starts[-2]
    assert skip_followed(data + bytes(9)) == starts[-2]
    assert skip_followed(b"\4" + data) == 0


@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_head_stops_the_walk_where_single_steps_do(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, lengths = random.Random(seed), [30, 50, 22] * 200
    sound, starts = join(lengths), list_starts(lengths)
    harmed = []
    for _ in range(40):
        data = bytearray(sound)
        data[rng.choice(starts[100:500]) + rng.randrange(9)] ^= 1 << rng.randrange(8)
        harmed.append(bytes(data))
    foretold = list_taken(harmed)
    monkeypatch.setattr(MessageWalk, "add", lambda *_: None)
    assert list_taken(harmed) == foretold


def list_taken(stretches: list[bytes]) -> list[Any]:
    found = [take_apart(data, is_chunk=False, most_records=10**6) for data in stretches]
    return [(one.starts.tolist(), one.others, one.fault, one.records) for one in found]


def test_turns_are_foretold_up_to_what_breaks_them() -> None:
    lengths = [30, 50, 22] * 400
    lengths[900] = 70
    data, starts = join(lengths), list_starts(lengths)
    walk = MessageWalk(data)
    for length in lengths[:16]:
        assert not walk.is_due
        walk.add(9 + length)
    assert walk.is_due
    found, place = walk.go_on(starts[16], 10**6)
    assert [*found.tolist(), place] == starts[16:901]
    assert not walk.is_due


def test_no_more_messages_are_foretold_than_asked_for() -> None:
    lengths = [30] * 1000
    walk = MessageWalk(join(lengths))
    for length in lengths[:16]:
        walk.add(9 + length)
    found, place = walk.go_on(16 * 39, 500)
    assert [*found.tolist(), place] == list_starts(lengths)[16:517]
