"""What to say of a failed check: everything that one needs to go on from there."""

import math
import textwrap
from collections.abc import Iterator

from turtlelog.check.result import CheckResult, format_number
from turtlelog.check.surroundings import describe_clock, tabulate_surroundings
from turtlelog.escapes import escape_controls
from turtlelog.run import Run

_WIDTH = 92
_MOST = 3


def describe_failure(run: Run, *results: CheckResult) -> list[str]:
    """Return lines: value, limit, margin, first violation with the values around, gains, scenario.

    Args:
        run: That was checked.
        results: What came of it; of many, the first violated are told in full.
    """
    ordered = sorted(results, key=_read_first)
    lines: list[str] = []
    for result in ordered[:_MOST]:
        lines += [*_list_figures(result), *_list_violation(run, result)]
    if len(ordered) > _MOST:
        others = ", ".join(result.check for result in ordered[_MOST:])
        lines += textwrap.wrap(f"and {len(ordered) - _MOST} more: {others}", _WIDTH)
    return [escape_controls(line) for line in (*lines, *_list_scenario(run, results[0]))]


def _read_first(result: CheckResult) -> float:
    return math.inf if result.first_violation_s is None else result.first_violation_s


def _list_figures(result: CheckResult) -> Iterator[str]:
    name = "" if result.check == result.expected else f"{result.check}: "
    yield f"{name}expected {result.expected}" if result.expected else result.check
    if result.decided_by:
        yield f"  decided by      {result.decided_by}"
    if result.value is not None:
        at = "" if result.value_s is None else f" at {result.value_s:.3f} s"
        yield f"  value           {format_number(result.value, result.unit)}{at}"
    if result.limit is not None:
        yield f"  limit           {format_number(result.limit, result.unit)}"
    if result.margin is not None:
        yield f"  margin          {format_number(result.margin, result.unit)}"
    if result.reason:
        yield f"  reason          {result.reason}"


def _list_violation(run: Run, result: CheckResult) -> Iterator[str]:
    at_s = result.first_violation_s
    if not result.is_decided:
        return
    if at_s is None:
        yield f"  first violated  at no one moment ({describe_clock(run)})"
        return
    yield f"  first violated  {at_s:.3f} s ({describe_clock(run)})"
    for line in tabulate_surroundings(run, result.names, at_s):
        yield f"    {line}"


def _list_scenario(run: Run, result: CheckResult) -> Iterator[str]:
    yield f"  recording       {result.file}"
    parameters = run.parameters
    keys = dict.fromkeys(loop.gain for loop in run.declaration.loops if loop.gain is not None)
    gains = [f"{name} = {parameters[name]}" for name in keys if name in parameters]
    gains = gains or [f"{n} = {v}" for n, v in parameters.items() if n.startswith("law.")]
    yield f"  gains           {', '.join(gains) or 'not recorded'}"
    others = [f"{n} = {v}" for n, v in parameters.items() if n not in (*keys, "name")]
    text = ", ".join([run.name, *others]) if others else f"{run.name}, nothing else recorded"
    wrapped = textwrap.wrap(text, _WIDTH - 18, break_on_hyphens=False, break_long_words=False)
    yield f"  scenario        {wrapped[0]}"
    yield from (f"                  {line}" for line in wrapped[1:])
