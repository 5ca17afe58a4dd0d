"""What a server says that it sends is checked before it is taken, and its answers end."""

import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import turtlelog as tl
from tests.files import lying_server as lies
from tests.files.lying_server import Answer, LyingServer, Request
from tests.files.range_server import RangeServer
from turtlelog.cli.app import main
from turtlelog.files import RemotePath, limit_downloads, remote_file, requests
from turtlelog.files.urls import parse_size

LEAST_TAKEN = 3 * 2**20
"""Bytes that a refused answer may leave in the buffers of both ends [bytes]."""


@pytest.fixture(autouse=True)
def short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_file, "PATIENCE_S", 0.3)
    monkeypatch.setattr(requests, "_WAITS_S", (0.0,))


def run(words: list[str]) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (lies.slow_headers, "the server did not answer within 0.5 s"),
        (lies.endless_headers, "expected an answer in http, found one that breaks its rules"),
        (lies.endless_chunks, "expected an answer of 16384 bytes from the server, found a longer"),
        (
            lies.short_length,
            "expected an answer of 16384 bytes from the server, found an answer of 5",
        ),
        (lies.long_length, "found an answer of 60000000 bytes; download the file, then name"),
        (lies.negative_length, "expected an answer in http, found one that breaks its rules"),
        (lies.two_lengths, "expected an answer in http, found one that breaks its rules"),
        (
            lies.cut_short,
            "expected all of the bytes asked for, found that the connection broke off",
        ),
        (lies.other_range, "from the server, found bytes 0 to"),
        (
            lies.no_size,
            "expected a range with the size of the file from the server, found Content-",
        ),
        (lies.growing_size, "expected one file throughout, found that it was replaced"),
        (lies.growing_file, "expected one file throughout, found that it was replaced"),
        (lies.changing_mark, "expected one file throughout, found that it was replaced"),
        (lies.to_a_file, "a redirect to something other than http or https"),
        (lies.in_circles, "expected the file after 5 redirects at most, found more"),
        (lies.nowhere, "expected the file from the server, found status 302"),
        (
            lies.bomb,
            "expected the bytes of the file from the server, found bytes compressed with gzip",
        ),
        (
            lies.no_range_at_all,
            "expected the first bytes of the file from the server, found no bytes",
        ),
        (lies.no_content, "expected the file from the server, found status 204"),
        (lies.trickle, "expected at least 1 kB/s, found "),
        (lies.endless_file, "expected at most 2 MiB, found a file that is longer"),
        (lies.huge_file, "expected at most 2 MiB, found a file that is longer"),
        (lies.web_page, "expected a file, found a web page; nothing more of it was fetched"),
        (lies.long_web_page, "not an MCAP file"),
        (lies.several_parts, "expected a range with the size of the file from the server, found"),
        (lies.interim_answers, "the server did not answer within 0.5 s"),
        (lies.huge_chunk, "expected an answer in http, found one that breaks its rules"),
        # Which comes first: the reader's complaint, or the reset that it makes of the connection.
        (lies.endless_trailers, "found one that breaks its rules|found that the connection broke"),
        (lies.escapes_in_range, r"found Content-Range bytes \x1b[2J\x1b]0;x\x07 0-1/5"),
        (lies.immense_size, f"found Content-Range bytes 0-16383/{2**62}"),
        (lies.come_again_in_a_century, "expected all of the bytes asked for, found the server's"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_an_answer_that_lies_is_one_line(
    answer: Answer,
    said: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if answer in {lies.slow_headers, lies.interim_answers}:
        monkeypatch.setattr(requests, "STALL_S", 0.5)
    with LyingServer(answer=answer) as server:
        assert run(["info", server.url(), "--max-download", "2MiB"]) == 2
    told = capsys.readouterr()
    line = told.err.splitlines()[-1]
    assert line.startswith(f"turtlelog: error: {server.url()}: ")
    assert any(one in line for one in said.split("|"))
    assert (told.out, told.err.count("turtlelog: error")) == ("", 1)
    assert "Traceback" not in told.err
    assert server.sent < LEAST_TAKEN + (2**21 if answer is lies.endless_file else 0)


@pytest.mark.parametrize(
    "words", [["metrics"], ["convert", "--recover", "-o", "out.mcap"]], ids=" ".join
)
@pytest.mark.parametrize("answer", [lies.endless_chunks, lies.bomb, lies.long_web_page])
def test_other_commands_refuse_the_same(
    words: list[str],
    answer: Answer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with LyingServer(answer=answer) as server:
        assert run([*words, server.url(), "--max-download", "2MiB"]) == 2
    told = capsys.readouterr().err
    assert told.count("turtlelog: error: ") == 1
    assert f"turtlelog: error: {server.url()}: " in told
    assert server.sent < LEAST_TAKEN
    assert not list(tmp_path.iterdir())


def test_a_table_without_end_is_not_read_into_memory() -> None:
    said = r"x\.csv: expected at most 4 GiB, found a file that is longer"
    with (
        LyingServer(answer=lies.huge_ranges) as server,
        pytest.raises(tl.errors.LogError, match=said),
    ):
        tl.read_run(server.url("x.csv"))
    assert server.sent < LEAST_TAKEN


@pytest.mark.parametrize(
    ("length", "is_fetched"), [(2**23, True), (2**23 + 1, False), (2**32 - 1, False)]
)
def test_a_footer_is_not_fetched_because_the_file_is_said_to_be_large(
    length: int, *, is_fetched: bool
) -> None:
    said = (
        "found a footer that is damaged"
        if is_fetched
        else r"expected a footer of up to 8,388,608 .*; download the file, then"
    )
    with (
        LyingServer(answer=lies.long_footer(length)) as server,
        pytest.raises(tl.errors.LogError, match=said),
    ):
        tl.read_run(server.url("x.parquet"))
    assert (server.sent > LEAST_TAKEN) is is_fetched
    assert server.sent < 3 * 2**23


@pytest.mark.everyday("350001")
@pytest.mark.parametrize("rows", [350_000, 350_001])
def test_a_table_of_many_rows_is_fetched_before_they_are_believed(
    rows: int, tmp_path: Path
) -> None:
    """Between the columns and the footer are 10 MB that nothing names."""
    path, zeros = tmp_path / "x.parquet", np.zeros(rows)
    columns = {"t": np.arange(rows) / 50, "x": zeros, "y": zeros, "heading": zeros}
    parquet.write_table(pa.table(columns), path, compression="zstd")
    content = path.read_bytes()
    end = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    path.write_bytes(content[:end] + bytes(10_000_000) + content[end:])
    with RangeServer(files={"x.parquet": path.read_bytes()}) as server, limit_downloads(11 * 10**6):
        assert len(tl.read_run(server.url("x.parquet")).poses) == rows
        assert (server.sent > 10**7) is (rows > 350_000)
    with RangeServer(files={"x.parquet": path.read_bytes()}) as server, limit_downloads(10**6):
        if rows == 350_000:
            assert len(tl.read_run(server.url("x.parquet")).poses) == rows
            return
        with pytest.raises(
            tl.errors.LogError, match=r"expected at most .* --max-download SIZE allows"
        ):
            tl.read_run(server.url("x.parquet"))


@pytest.mark.parametrize(("count", "is_followed"), [(5, True), (6, False)])
def test_five_redirects_are_followed(count: int, *, is_followed: bool) -> None:
    with LyingServer(answer=lies.after_hops(count)) as server:
        path = RemotePath(server.url())
        if is_followed:
            assert path.stat().st_size == len(lies.DATA)
            return
        with pytest.raises(tl.errors.RemoteError, match="after 5 redirects at most"):
            path.stat()


@pytest.mark.parametrize(("count", "is_read"), [(250, True), (25, False)])
def test_less_than_a_kilobyte_a_second_is_refused_after_a_while(
    count: int, *, is_read: bool
) -> None:
    """At 5 kB/s the 0.3 s of patience end in the middle, at 0.5 kB/s too."""
    with LyingServer(answer=lies.drip(count)) as server:
        path = RemotePath(server.url())
        if is_read:
            assert path.open("rb").read() == lies.DATA[:1500]
            return
        with pytest.raises(
            tl.errors.RemoteError, match=r"expected at least 1 kB/s, found \d+ B/s for 0.3"
        ):
            path.stat()


@pytest.mark.filterwarnings("ignore:.*no ranges")
@pytest.mark.parametrize("answer", [lies.whole_file, lies.endless_file], ids=["known", "endless"])
def test_what_is_longer_than_allowed_is_not_fetched(answer: Answer) -> None:
    with LyingServer(answer=answer) as server:
        path = RemotePath(server.url(), max_download=len(lies.DATA) - 1)
        with pytest.raises(
            tl.errors.RemoteError, match=r"expected at most 976.6 KiB, found a file that is"
        ):
            path.open("rb").read()


@pytest.mark.filterwarnings("ignore:.*no ranges")
def test_what_is_as_long_as_allowed_is_fetched() -> None:
    with LyingServer(answer=lies.whole_file) as server, limit_downloads(len(lies.DATA)):
        assert RemotePath(server.url()).open("rb").read() == lies.DATA


def test_a_server_that_sends_on_gets_no_password_of_the_first() -> None:
    def send_on(asked: Request) -> Iterator[bytes]:
        yield lies.say(302, f"Location: {other.url()}", "Content-Length: 0")

    with (
        LyingServer(answer=lies.send_range) as other,
        LyingServer(answer=send_on) as server,
    ):
        path = RemotePath(server.url().replace("//", "//me:SECRET@"))
        assert path.stat().st_size == len(lies.DATA)
    assert "Authorization: Basic" in server.requests[0].head
    assert "Authorization" not in other.requests[0].head


def test_a_limit_goes_to_other_processes_with_the_path() -> None:
    with limit_downloads(5):
        copied = pickle.loads(pickle.dumps(RemotePath("https://host/x")))
    assert (copied.max_download, RemotePath("https://host/x").max_download) == (5, 4 * 2**30)


@pytest.mark.parametrize(
    ("text", "count"),
    [("5", 5), ("500MB", 500_000_000), ("4GiB", 2**32), ("1.5k", 1500), ("4g", None), ("", None)],
)
def test_a_size_is_read_with_its_unit(text: str, count: int | None) -> None:
    assert parse_size(text) == count


def test_a_size_that_is_none_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", "recordings/paper/kp4.mcap", "--max-download", "much"]) == 2
    assert capsys.readouterr().err == (
        "turtlelog: error: --max-download much: must be a size, as in 500MB or 4GiB\n"
    )
