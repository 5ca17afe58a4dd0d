"""What tests may cost: which parameters run every day, and what takes long says why."""

import inspect
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from time import process_time  # bound here: a test replaces that of the module
from typing import Any, Final

import pytest

LONG_S: Final = 2.0
"""A test that takes longer says why in the first line of its docstring."""

FAILS_S: Final = 5.0 * LONG_S
"""Without that line a test fails from this processor time on. By the clock a busy machine takes ten
times as long as an idle one; processor time of a busy one is at most twice as long."""

_USED_S: Final = pytest.StashKey[float]()

_UNEXPLAINED: Final = "unexplained"


def thin_out(items: Sequence[pytest.Item], *, is_whole: bool) -> None:
    """Mark as thorough what a test with the mark `everyday` does not name.

    Args:
        items: That were collected.
        is_whole: Whether all parameters of each test are among them.

    Raises:
        UsageError: Where a test names an id that it does not have.
    """
    named: dict[Any, set[str]] = {}
    collected: dict[Any, set[str]] = defaultdict(set)
    for item in items:
        mark = item.get_closest_marker("everyday")
        if mark is None or not isinstance(item, pytest.Function):
            continue
        found = item.callspec.id if hasattr(item, "callspec") else ""
        place = item.nodeid.partition("[")[0]
        named[place] = {*mark.args}
        collected[place].add(found)
        if found not in mark.args:
            item.add_marker("thorough")
    for place, ids in named.items():
        if is_whole and (missing := ids - collected[place]):
            raise pytest.UsageError(f"{place}: everyday: expected its ids, found {missing}")


@contextmanager
def measure_time(item: pytest.Item) -> Iterator[None]:
    """Note the processor time of this process while a test runs, without that of its children."""
    begin_s = process_time()
    try:
        yield
    finally:
        item.stash[_USED_S] = process_time() - begin_s


def require_reason(
    item: pytest.Item,
    report: pytest.TestReport,
    *,
    long_s: float = LONG_S,
    fails_s: float = FAILS_S,
) -> None:
    """Note a test that takes over 2 s without a reason; from 10 s of processor time on it fails.

    Args:
        item: The test.
        report: Of one of its phases; of the others than its call nothing is asked.
        long_s: From when on a reason is asked for [s].
        fails_s: Processor time from which on the test fails without one [s].
    """
    if report.when != "call" or report.duration <= long_s or _read_reason(item):
        return
    report.user_properties.append((_UNEXPLAINED, report.duration))
    used_s = item.stash.get(_USED_S, 0.0)
    if used_s > fails_s and report.passed:
        report.outcome = "failed"
        report.longrepr = (
            f"{item.nodeid} took {used_s:.1f} s of processor time: a test of over {long_s:g} s"
            " says why in the first line of its docstring, or becomes quicker"
        )


def _read_reason(item: pytest.Item) -> str:
    function = item.function if isinstance(item, pytest.Function) else None
    return (inspect.getdoc(function) or "").partition("\n")[0]


def list_unexplained(reports: Iterable[Any]) -> list[str]:
    """Return the tests that take over 2 s without a reason, slowest first, as lines."""
    found = [
        (value, report.nodeid)
        for report in reports
        for name, value in getattr(report, "user_properties", ())
        if name == _UNEXPLAINED and report.when == "call"
    ]
    return [f"{value:.2f}s {name}" for value, name in sorted(found, reverse=True)]
