"""Properties of a recording: what tells files apart in the viewer and in a query."""

from collections.abc import Sequence
from typing import Any

import rerun as rr

from turtlelog.run import Run


def collect_run_properties(run: Run) -> rr.AnyValues:
    """Return name, source, stop reason, start and every number of the law, its gains among them."""
    values: dict[str, Any] = {
        "name": run.name,
        "source": run.source,
        "stop_reason": run.stop_reason or "unknown",
        "start_ns": run.start_ns,
        **_collect_numbers(run),
    }
    return rr.AnyValues(**values)


def collect_comparison_properties(
    runs: Sequence[Run], names: Sequence[str], prefixes: Sequence[str]
) -> rr.AnyValues:
    """Return the same of several runs, as lists in the order given; a number not known is NaN."""
    numbers = [_collect_numbers(run) for run in runs]
    keys = sorted({key for collected in numbers for key in collected})
    values: dict[str, Any] = {
        "name": list(names),
        "entity": list(prefixes),
        "source": [run.source for run in runs],
        "stop_reason": [run.stop_reason or "unknown" for run in runs],
        "start_ns": [run.start_ns for run in runs],
        **{key: [collected.get(key, float("nan")) for collected in numbers] for key in keys},
    }
    return rr.AnyValues(**values)


def _collect_numbers(run: Run) -> dict[str, float]:
    """Return the law's numbers, all as floats: Rerun wants one type per name in a process."""
    return {
        key: float(value)
        for key, value in run.parameters.items()
        if key.startswith("law.") and not isinstance(value, bool | str | list)
    }
