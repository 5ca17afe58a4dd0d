"""A good run -> the text of a first specification, its bounds marked as observed."""

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from turtlelog.measure import METRICS, Metric, measure_run
from turtlelog.run import Run

_CHOSEN: Final = (
    *("rotate.overshoot", "rotate.settling_time", "rotate.saturated_share"),
    *("translate.overshoot", "translate.settling_time", "translate.saturated_share"),
    *("final.heading_error", "final.position_error"),
    *("run.duration", "run.path_length", "run.cross_track_max", "run.largest_gap"),
)
_SHARE: Final = 0.1
_DIGITS: Final = 3
_LEAST: Final = {"s": 0.05, "m": 0.001, "deg": 0.1, "%": 0.5, "1": 0.02}
"""What a bound leaves at least beyond what was observed, by unit."""


def format_first_spec(run: Run, *, reference: str, partial: str = "") -> str:
    """Return a specification that a run passes: a tenth of its value to spare, at least a little.

    Args:
        run: A good one.
        reference: Its file, as the specification is to name it.
        partial: What it has lost, for a comment.
    """
    return "\n".join([*_list_head(run, reference, partial), *_list_checks(run)]) + "\n"


def name_reference(path: Path, target: Path | None) -> str:
    """Return the name by which a specification in `target` finds the reference."""
    folder = Path.cwd() if target is None else target.resolve().parent
    try:
        return Path(os.path.relpath(path.resolve(), folder)).as_posix()
    except ValueError:  # on Windows, where they lie on two drives
        return path.resolve().as_posix()


def _list_head(run: Run, reference: str, partial: str) -> Iterator[str]:
    yield f"# What runs like {_comment(run.name)} are held to: turtlelog check SPEC RUN..."
    yield "# Bounds marked observed = true were read off that run. Ask of each what it should be,"
    yield "# change it, and take the mark away."
    if partial:
        yield f"# The run that it was read off is not whole: {_comment(partial)}"
    yield "format = 1"
    yield f"reference = {_quote(reference)}"


def _list_checks(run: Run) -> Iterator[str]:
    for metric in measure_run(run, only=_CHOSEN).values():
        if metric.value is None:
            yield ""
            yield f"# {metric.id}: no value here: {metric.status.value} ({_comment(metric.reason)})"
        else:
            yield from _list_check(metric, metric.value)
    if run.goal_xy_m is not None and len(run.samples):
        yield from _list_arrival(run)


def _list_check(metric: Metric, value: float) -> Iterator[str]:
    kind = METRICS[metric.id]
    spare = max(abs(value) * _SHARE, _LEAST.get(metric.unit, 0.0))
    if kind.better == "higher":
        operator, bound = ">=", _round(value - spare, up=False)
    else:
        base = value if kind.floor is None else max(value, kind.floor)
        operator, bound = "<=", _round(base + spare, up=True)
    unit = "" if metric.unit == "1" else f" {metric.unit}"
    yield ""
    yield f'[checks."{metric.id}"]'
    yield f'expect = "{metric.id} {operator} {bound:.10g}"  # here {value:.5g}{unit}'
    yield "observed = true"
    yield 'reason = "observed, and a tenth to spare"'


def _list_arrival(run: Run) -> Iterator[str]:
    metric = measure_run(run, only=["run.cross_track_max"])["run.cross_track_max"]
    if metric.value is None:
        return
    bound = _round(metric.value + max(metric.value * _SHARE, _LEAST["m"]), up=True)
    yield ""
    yield "[checks.track]"
    yield f'holds = "always(abs(cross_track) <= {bound:.10g})"  # here {metric.value:.5g} m'
    yield "observed = true"
    yield 'reason = "observed: how far beside the line from start to goal, at any time"'


def _round(value: float, *, up: bool) -> float:
    """Return a value in three digits, away from what was observed."""
    if value == 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) - _DIGITS + 1)
    steps = math.ceil(value / step) if up else math.floor(value / step)
    return float(f"{steps * step:.{_DIGITS + 1}g}")


def _quote(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'


def _comment(text: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in text)
