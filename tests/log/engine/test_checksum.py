import random
import zlib
from io import BytesIO
from typing import Any

import pytest

from tests.log.ways import load_kernels, use_kernels
from turtlelog.log.engine.checksum import _LEAST, _STATE, compute_crc
from turtlelog.log.engine.summary import _STEP, Ends, check_data


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("base", [0, _STATE, _LEAST, 2 * _LEAST])
def test_the_checksum_is_that_of_zlib(base: int) -> None:
    rng = random.Random(base)
    for size in range(max(base - 2, 0), base + 2 * _STATE):
        data, before = rng.randbytes(size), rng.getrandbits(32)
        assert compute_crc(data) == zlib.crc32(data)
        assert compute_crc(data, before) == zlib.crc32(data, before)
        assert compute_crc(memoryview(data)[1:]) == zlib.crc32(data[1:])


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("start", [0, 0xFFFFFFFF])
def test_zeros_have_the_checksum_of_zlib(start: int) -> None:
    assert compute_crc(bytes(2 * _LEAST), start) == zlib.crc32(bytes(2 * _LEAST), start)


@pytest.mark.parametrize(("size", "is_folded"), [(_LEAST - 1, False), (_LEAST, True)])
def test_only_much_is_folded(
    size: int, monkeypatch: pytest.MonkeyPatch, *, is_folded: bool
) -> None:
    kernels = load_kernels()
    if kernels.fold is None:
        pytest.skip("this processor does not multiply without carries")
    calls: list[Any] = []
    fold = kernels.fold
    monkeypatch.setattr(kernels, "fold", lambda *values: calls.append(fold(*values)))
    with use_kernels(kernels):
        assert compute_crc(bytes(size)) == zlib.crc32(bytes(size))
    assert len(calls) == is_folded


def test_a_processor_that_cannot_fold_has_the_same_checksums(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernels = load_kernels()
    monkeypatch.setattr(kernels, "fold", None)
    with use_kernels(kernels):
        assert compute_crc(bytes(_LEAST)) == zlib.crc32(bytes(_LEAST))


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("size", [_STEP - 1, _STEP, 2 * _STEP + 1])
def test_the_data_of_a_file_are_checked_step_by_step(size: int) -> None:
    data = random.Random(size).randbytes(size)
    ends = Ends(data_end=size, data_crc=zlib.crc32(data), summary_start=size, summary=b"")
    check_data(BytesIO(data + b"more"), ends)
