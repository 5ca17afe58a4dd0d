"""A server of S3 on 127.0.0.1, of moto."""

from collections.abc import Iterator

import numpy as np
import pytest
from moto.server import ThreadedMotoServer

import turtlelog as tl
from turtlelog.errors import LogError
from turtlelog.remote import RemotePath


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
    with pytest.raises(LogError, match=f"^s3://{place}: expected an object or file, found none"):
        tl.read_run(f"s3://{place}")


def test_storage_that_is_not_there_is_one_line(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import s3fs

    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(LogError, match=r"kp4\.mcap: expected a server, found none that answers"):
        tl.read_run(f"{bucket}/kp4.mcap")


def test_a_recording_is_put_in_place_of_what_is_there(bucket: str, kp4: bytes) -> None:
    place = f"{bucket}/results/out.mcap"
    for name in ("kp1", "kp4"):
        run = tl.read_run(f"recordings/paper/{name}.mcap")
        tl.write_recording(run, place)
        assert tl.read_run(place).name == run.name


def test_a_bucket_that_is_not_there_takes_nothing(bucket: str) -> None:
    run = tl.read_run("recordings/paper/kp4.mcap")
    with pytest.raises(LogError, match=r"^s3://no-such-bucket/x\.mcap: expected an object or file"):
        tl.write_recording(run, "s3://no-such-bucket/x.mcap")


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
