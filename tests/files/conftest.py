import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from tests.files.range_server import RangeServer

CHUNKS = 96
SIGNED = "?sig=SECRET//1"
"""Without it, or with another, nothing is there."""


@pytest.fixture(scope="session")
def large_mcap() -> bytes:
    """A recording of 12 MiB that does not compress: 96 chunks of 128 KiB, one of them a second."""
    output, noise = io.BytesIO(), np.random.default_rng(3)
    writer = Writer(output, chunk_size=2**17, compression=CompressionType.ZSTD)
    writer.start("ros2", "tests")
    schema = writer.register_schema(
        "test_msgs/msg/Block", "ros2msg", b"float64 x\nuint8[32000] rest\n"
    )
    channel = writer.register_channel("/block", "cdr", schema)
    for number in range(CHUNKS * 4):
        data = b"\0\1\0\0" + np.float64(number / 3).tobytes() + noise.bytes(32000)
        time_ns = number * 250_000_000
        writer.add_message(channel, time_ns, data, time_ns, number)
    writer.finish()  # type: ignore[no-untyped-call]
    return output.getvalue()


@pytest.fixture(scope="session")
def large_file(large_mcap: bytes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("large") / "large.mcap"
    path.write_bytes(large_mcap)
    return path


@pytest.fixture(scope="session")
def kp4() -> bytes:
    return Path("recordings/paper/kp4.mcap").read_bytes()


@pytest.fixture
def server(large_mcap: bytes, kp4: bytes) -> Iterator[RangeServer]:
    files = {"large.mcap": large_mcap, "kp4.mcap": kp4, f"signed.mcap{SIGNED}": kp4}
    with RangeServer(files=files) as started:
        yield started
