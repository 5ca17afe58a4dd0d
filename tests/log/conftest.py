"""Reading with and without the compiled loops."""

from collections.abc import Iterator

import pytest

from tests.log.ways import load_kernels, use_kernels


@pytest.fixture(params=["plain", "compiled"])
def way(request: pytest.FixtureRequest) -> Iterator[None]:
    """Read with the compiled loops, and without; what is tested must not tell which."""
    with use_kernels(load_kernels() if request.param == "compiled" else None):
        yield
