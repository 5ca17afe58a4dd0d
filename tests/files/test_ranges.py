import os
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.files.conftest import SIGNED
from tests.files.range_server import Fault, RangeServer
from turtlelog.errors import LogError
from turtlelog.files import RemoteNote, RemotePath, requests
from turtlelog.files.remote_file import RangeStream
from turtlelog.log import read_columns


def test_info_of_a_large_recording_fetches_its_ends_only(
    server: RangeServer, large_mcap: bytes
) -> None:
    info = tl.log.read_info(server.url("large.mcap"))
    assert info.topics[0].count == 384
    # The tail is 256 KiB of 12 MiB, the head 16 KiB: 2.2 %. One request more would be another end.
    assert server.sent < 0.025 * len(large_mcap)
    assert len(server.ranges) == 2


def test_a_window_fetches_its_chunks_in_one_request(server: RangeServer, large_mcap: bytes) -> None:
    read_columns(server.url("large.mcap"), start_ns=20_000_000_000, end_ns=25_000_000_000)
    # Five to seven chunks of some 125 KiB hold 5 s; the ends are fetched besides.
    middle = [end - start for start, end in server.ranges if 2**15 < start < 9 * 2**20]
    assert len(middle) == 1
    assert 5 * 125_000 < middle[0] < 7.5 * 131_072
    assert len(server.ranges) == 3


@pytest.mark.parametrize("window", [(None, None), (20_000_000_000, 25_000_000_000)])
def test_columns_are_those_of_the_local_file(
    server: RangeServer, large_file: Path, window: tuple[int | None, int | None]
) -> None:
    local, remote = (
        read_columns(place, start_ns=window[0], end_ns=window[1])["/block"]
        for place in (large_file, server.url("large.mcap"))
    )
    np.testing.assert_array_equal(remote.log_time_ns, local.log_time_ns)
    assert remote.fields.keys() == local.fields.keys()
    for name, column in local.fields.items():
        np.testing.assert_array_equal(np.asarray(remote.fields[name]), np.asarray(column))


def test_a_whole_read_takes_few_requests_of_bounded_size(
    server: RangeServer, large_mcap: bytes
) -> None:
    read_columns(server.url("large.mcap"))
    assert len(server.ranges) <= 4  # both ends, and 12 MiB in windows of 8
    assert max(end - start for start, end in server.ranges) <= 2**23
    assert server.sent < 1.05 * len(large_mcap)  # nothing is fetched twice but an end


def test_a_run_is_that_of_the_local_file(server: RangeServer) -> None:
    local, remote = tl.read_run("recordings/paper/kp4.mcap"), tl.read_run(server.url("kp4.mcap"))
    np.testing.assert_array_equal(remote.poses.xy_m, local.poses.xy_m)
    assert remote.name == local.name
    assert len(server.ranges) == 2  # its head and all of it, though it is opened thrice


def test_a_stream_reads_as_a_file_does(server: RangeServer, large_mcap: bytes) -> None:
    random = np.random.default_rng(1)
    with RemotePath(server.url("large.mcap")).file.open() as stream:
        for start in random.integers(0, len(large_mcap) + 10, 40).tolist():
            count = int(random.integers(0, 70_000))
            stream.seek(start)
            assert stream.read(count) == large_mcap[start : start + count]
        assert isinstance(stream, RangeStream)
        assert stream.seek(-7, os.SEEK_END) == len(large_mcap) - 7
        buffer = bytearray(20)
        assert stream.readinto(buffer) == 7
        assert buffer[:7] == large_mcap[-7:]


@pytest.mark.parametrize(("gap", "requests"), [(2**16, 1), (2**16 + 1, 2)])
def test_ranges_are_fetched_together_up_to_a_gap_of_64_kib(
    server: RangeServer, large_mcap: bytes, gap: int, requests: int
) -> None:
    first, second = (100_000, 150_000), (150_000 + gap, 200_000 + gap)
    with RemotePath(server.url("large.mcap")).file.open() as stream:
        assert isinstance(stream, RangeStream)
        before = len(server.ranges)
        stream.expect([first, second])
        for start, end in (first, second):
            stream.seek(start)
            assert stream.read(end - start) == large_mcap[start:end]
        assert len(server.ranges) - before == requests


@pytest.mark.parametrize("fault", ["cut", "error"])
def test_a_range_that_fails_is_asked_for_again(server: RangeServer, fault: Fault) -> None:
    server.faults += [fault, fault]
    assert len(tl.read_run(server.url("kp4.mcap")).poses)
    assert not server.faults


def test_a_server_that_goes_on_failing_is_one_line(server: RangeServer) -> None:
    server.faults += ["cut", "cut", "cut", "denied"]
    with pytest.raises(
        LogError, match=r"^http\S+signed\.mcap: expected all of the bytes asked for"
    ):
        tl.read_run(server.url("signed.mcap") + SIGNED)
    assert server.faults == ["denied"]  # three attempts, no more


def test_a_server_that_hangs_is_told_after_a_while(
    server: RangeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests, "STALL_S", 0.3)
    server.faults[:] = ["hang", "denied"]
    with pytest.raises(LogError, match=r"the server did not answer within 0\.3 s"):
        tl.read_run(server.url("kp4.mcap"))


def test_what_may_not_be_read_says_so_without_its_signature(server: RangeServer) -> None:
    server.faults[:] = ["denied"]
    with pytest.raises(LogError, match="found no access") as caught:
        tl.read_run(server.url("signed.mcap").replace("//", "//me:SECRET@") + SIGNED)
    assert "SECRET" not in str(caught.value)


def test_without_ranges_the_whole_is_read_and_said(kp4: bytes, large_mcap: bytes) -> None:
    files = {"kp4.mcap": kp4, "large.mcap": large_mcap}
    with RangeServer(files=files, has_ranges=False) as server:
        with pytest.warns(RemoteNote, match="the server sends no ranges, so all of it is read"):
            info = tl.log.read_info(server.url("large.mcap"))
        assert info.topics[0].count == 384


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("http://127.0.0.1:1/x.mcap?sig=SECRET", "no server answers at this address"),
        ("http://nowhere.invalid/x.mcap", "no server answers at this address"),
        ("memory://nothing/x.mcap", "no object or file of this name"),
        ("rubbish://nothing/x.mcap", "expected a URL that fsspec reads"),
        ("gs://bucket/x.mcap", "pip install gcsfs"),
    ],
)
def test_what_cannot_be_read_is_one_line_with_the_url(url: str, said: str) -> None:
    with pytest.raises(tl.TurtlelogError, match=said) as caught:
        tl.read_run(url)
    assert str(caught.value).startswith(url.partition("?")[0])
    assert "SECRET" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_such_file_on_a_server_is_one_line(server: RangeServer) -> None:
    with pytest.raises(LogError, match=r"none\.mcap: no object or file"):
        tl.read_run(server.url("none.mcap"))


@pytest.mark.parametrize(
    ("before", "after", "is_same"),
    [
        ({"ETag": '"1"'}, {"ETag": '"2"'}, False),
        ({"ETag": 'W/"1"'}, {"ETag": '"1"'}, True),
        ({"ETag": '"1"', "Last-Modified": "1"}, {"ETag": '"1"', "Last-Modified": "2"}, True),
        ({"Last-Modified": "Mon"}, {"Last-Modified": "Tue"}, False),
        ({"ETag": '"1"', "Last-Modified": "1"}, {"Last-Modified": "1"}, True),
        ({}, {"ETag": '"1"'}, True),
    ],
)
def test_a_file_that_is_replaced_between_ranges_is_one_line(
    server: RangeServer, before: dict[str, str], after: dict[str, str], *, is_same: bool
) -> None:
    """The size stays: nothing else tells."""
    server.marks = before
    server.swap = lambda: setattr(server, "marks", after)
    if is_same:
        assert len(read_columns(server.url("large.mcap"))["/block"].log_time_ns) == 384
        return
    with pytest.raises(
        LogError,
        match=r"large\.mcap: expected one file throughout, found that it was replaced while",
    ) as caught:
        read_columns(server.url("large.mcap"))
    assert "\n" not in str(caught.value)
    assert len(server.ranges) <= 2  # the other file is not asked for again
