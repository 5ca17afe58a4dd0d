import pytest

from turtlelog.draw.rerun.timelines import parse_timestamp


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1970-01-01T00:00:01Z", 1_000_000_000),
        ("1970-01-01T00:00:01", 1_000_000_000),
        ("1970-01-01T01:00:01+01:00", 1_000_000_000),
        ("1970-01-01T00:00:00.000000001Z", 1),
        ("1970-01-01T00:00:00.5", 500_000_000),
        ("2026-01-22T12:20:06.020038", 1_769_084_406_020_038_000),
    ],
)
def test_timestamps_are_read_to_the_nanosecond(text: str, expected: int) -> None:
    assert parse_timestamp(text) == expected


@pytest.mark.parametrize("text", ["", "yesterday", "123 ns", "9999-01-01T00:00:00", "0001-01-01"])
def test_what_is_no_usable_time_is_none(text: str) -> None:
    assert parse_timestamp(text) is None
