"""A server of S3 on 127.0.0.1, of moto."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from moto.server import ThreadedMotoServer

import turtlelog as tl
from turtlelog.cli.app import main
from turtlelog.errors import LogError
from turtlelog.files import RemotePath
from turtlelog.sweep import run_sweep, sweep_rows


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def bucket(endpoint: str, monkeypatch: pytest.MonkeyPatch, kp4: bytes) -> str:
    """A bucket with a recording; who asks for it is known by the environment, as ever."""
    import s3fs

    monkeypatch.setenv("AWS_ENDPOINT_URL", endpoint)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "someone")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "SECRET")
    s3fs.S3FileSystem.clear_instance_cache()
    system = s3fs.S3FileSystem()
    if not system.exists("s3://robots"):
        system.mkdir("s3://robots")
        system.pipe_file("s3://robots/day 1/kp4.mcap", kp4)
    return "s3://robots"


def test_a_run_in_a_bucket_is_that_of_the_local_file(bucket: str) -> None:
    local, remote = (
        tl.read_run(place) for place in ("recordings/paper/kp4.mcap", f"{bucket}/day 1/kp4.mcap")
    )
    np.testing.assert_array_equal(remote.poses.xy_m, local.poses.xy_m)


@pytest.mark.parametrize("place", ["robots/none.mcap", "no-such-bucket/kp4.mcap"])
def test_no_such_object_is_one_line(bucket: str, place: str) -> None:
    with pytest.raises(LogError, match=f"^s3://{place}: no object or file"):
        tl.read_run(f"s3://{place}")


def test_storage_that_is_not_there_is_one_line(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import s3fs

    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(LogError, match=r"kp4\.mcap: no server answers"):
        tl.read_run(f"{bucket}/kp4.mcap")


def test_a_recording_is_put_in_place_of_what_is_there(bucket: str, kp4: bytes) -> None:
    place = f"{bucket}/results/out.mcap"
    for name in ("kp1", "kp4"):
        run = tl.read_run(f"recordings/paper/{name}.mcap")
        tl.write_recording(run, place)
        assert tl.read_run(place).name == run.name


def test_a_bucket_that_is_not_there_takes_nothing(bucket: str) -> None:
    run = tl.read_run("recordings/paper/kp4.mcap")
    with pytest.raises(LogError, match=r"^s3://no-such-bucket/x\.mcap: no object or file"):
        tl.write_recording(run, "s3://no-such-bucket/x.mcap")


@pytest.mark.thorough
def test_an_object_that_is_replaced_while_it_is_read_is_one_line(
    bucket: str, large_mcap: bytes
) -> None:
    import s3fs

    system, place = s3fs.S3FileSystem(), f"{bucket}/swapped.mcap"
    system.pipe_file(place, large_mcap)
    path = RemotePath(place)
    assert tl.log.read_info(path).topics[0].count == 384
    system.pipe_file(place, large_mcap[:-1] + b"x")
    with pytest.raises(
        LogError, match=r"^s3://robots/swapped\.mcap: expected one file throughout, found that it"
    ):
        tl.log.read_columns(path)


SWEEP = ("sweep", "paper-kp4", "--grid", "law.kp_linear=1:6", "--metric", "final.*")


def _run(*words: str) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code


def _fetch(url: str) -> bytes:
    with RemotePath(url).file.open() as stream:
        return stream.read()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kp4: bytes) -> Path:
    """The working folder, with recordings."""
    (tmp_path / "runs").mkdir()
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / "runs" / name).write_bytes(kp4)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.everyday("sweep")
@pytest.mark.parametrize(
    "words",
    [
        SWEEP,
        ("metrics", "runs"),
        ("check", "--expect", "run.duration < 99", "runs"),
    ],
    ids=lambda words: words[0],
)
def test_a_table_in_a_bucket_is_that_of_a_disk_and_grows_as_it_does(
    words: tuple[str, ...],
    bucket: str,
    here: Path,
    kp4: bytes,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A server of buckets starts with the first of these tests."""
    place, said = f"{bucket}/tables/{words[0]}.parquet", []
    for count in (2, 2, 3):
        if count == 3:
            (here / "runs" / "c.mcap").write_bytes(kp4)
        for output in ("t.parquet", place):
            assert _run(*words, "-o", output) == 0
            caught = capsys.readouterr()
            text = re.sub(r"in [\d.]+ s", "", caught.out + caught.err).replace(output, "TABLE")
            said.append(text.replace(str(here), ""))
        assert _fetch(place) == (here / "t.parquet").read_bytes()
        assert said[-1] == said[-2]
    assert sorted(path.name for path in here.iterdir()) == ["runs", "t.parquet"]
    if words[0] != "sweep":
        assert "3 files, 1 read, 2 unchanged" in said[-1]


def test_a_sweep_into_a_bucket_goes_on_where_it_was(
    bucket: str, here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    place = f"{bucket}/tables/again.parquet"
    rows: list[int] = []
    simulate = sweep_rows.simulate_rows

    def stop_after_two(chunk: sweep_rows.RowChunk) -> sweep_rows.RowResults:
        if len(rows) == 2:
            raise KeyboardInterrupt
        rows.append(chunk.first)
        return simulate(chunk)

    with monkeypatch.context() as patched:
        patched.setattr(sweep_rows, "simulate_rows", stop_after_two)
        patched.setitem(run_sweep.__globals__, "_MOST_IN_CHUNK", 1)
        assert _run(*SWEEP, "-o", place, "--jobs", "1") == 130
    assert "2 of 6 rows are done; the same command goes on" in capsys.readouterr().err
    (kept,) = here.glob("*.partial")
    assert re.fullmatch(r"again\.parquet\.[0-9a-f]{8}\.partial", kept.name)

    def count(chunk: sweep_rows.RowChunk) -> sweep_rows.RowResults:
        rows.extend(range(chunk.first, chunk.first + len(chunk.values)))
        return simulate(chunk)

    monkeypatch.setattr(sweep_rows, "simulate_rows", count)
    assert _run(*SWEEP, "-o", place, "--jobs", "1") == 0
    assert rows == list(range(6))  # none twice
    assert not kept.exists()
    assert _run(*SWEEP, "-o", "t.parquet", "--jobs", "1") == 0
    assert _fetch(place) == (here / "t.parquet").read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            (*SWEEP, "-o", "s3://no-such-bucket/t.parquet"),
            "s3://no-such-bucket/t.parquet: no object or file of this name",
        ),
        (
            (*SWEEP, "-o", "s3://robots/day 1/kp4.mcap"),
            "s3://robots/day 1/kp4.mcap: the name must end in .parquet",
        ),
        (
            (*SWEEP, "-o", "t.parquet", "--record", "s3://robots/day 1"),
            "s3://robots/day 1: expected a new folder for recordings, found one with files",
        ),
        (
            (*SWEEP, "-o", "t.parquet", "--record", "https://127.0.0.1/runs"),
            "https://127.0.0.1/runs: expected a URL of an object storage to write to, found one of"
            " http",
        ),
    ],
)
def test_what_a_sweep_cannot_write_is_told_before_it_begins(
    words: tuple[str, ...],
    said: str,
    bucket: str,
    here: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert bucket == "s3://robots"
    assert _run(*words) == 2
    assert capsys.readouterr().err == f"turtlelog: error: {said}\n"
    assert [path.name for path in here.iterdir()] == ["runs"]


def test_rows_are_recorded_into_a_bucket(bucket: str, here: Path) -> None:
    place = f"{bucket}/recorded/runs"
    assert _run(*SWEEP, "-o", "t.parquet", "--record", place, "--jobs", "1") == 0
    run = tl.read_run(f"{place}/row-000003.mcap")
    expected = tl.simulate_run(tl.sweep.load_row_scenario("t.parquet", 3))
    np.testing.assert_array_equal(run.poses.xy_m, expected.poses.xy_m)
    assert sorted(path.name for path in here.iterdir()) == ["runs", "t.parquet"]
