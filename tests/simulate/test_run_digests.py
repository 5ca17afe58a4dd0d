from collections.abc import Iterator

import numpy as np

from tests.simulate.run_digests import COUNT, PARTS, digest_run, probe_platform, read_digests

SHOWN = range(0, COUNT, 10), range(3, COUNT, 100), range(7, COUNT, 250), (11, 13)
"""A tenth of all, and some of those that end otherwise."""


def list_numbers() -> Iterator[int]:
    for numbers in SHOWN:
        yield from numbers


def test_runs_are_what_they_were_to_the_last_bit() -> None:
    """Some 230 scenarios are simulated, of up to a minute each."""
    platform, digests, ends = read_digests()
    is_same_platform = platform == probe_platform()
    others: list[tuple[int, object]] = []
    for number in list_numbers():
        found, end = digest_run(number)
        if is_same_platform:
            pairs = zip(PARTS, found, digests[number].tolist(), strict=True)
            parts = [name for name, now, before in pairs if now != before]
            others += [(number, parts)] if parts else []
        elif not np.allclose(end, ends[number], rtol=0.0, atol=1e-6, equal_nan=True):
            others.append((number, end))
    assert others == []
