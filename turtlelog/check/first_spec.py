"""Text of a first specification from a good run, with its bounds marked as observed."""

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from turtlelog.check.formula_trace import RunEnding, find_ending
from turtlelog.check.spec import READ_TEXTS
from turtlelog.display import format_number
from turtlelog.log import ReadChoice
from turtlelog.measure import (
    Metric,
    MetricKind,
    find_signal,
    list_essential_metrics,
    list_metrics,
    measure_run,
)
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.run import Run
from turtlelog.run.loops import Declaration

_OF_LOOP: Final = ("overshoot", "settling_time", "rms_error", "largest_error", "saturated_share")
_OF_RUN: Final = (
    *("final.heading_error", "final.position_error"),
    *("run.duration", "run.path_length", "run.cross_track_max", "run.largest_gap"),
)
"""Essential metrics that a specification bounds."""

_SHARE: Final = 0.1
"""Smallest margin of a bound as a share of the value, which includes the scatter of repeated runs.

The margin is a first guess, marked as observed, until a user decides on the bound."""

_MOST: Final = 0.2
"""Largest margin: two digits are readable, but round up by as much as 21 %; then three digits are
used."""

_GRAIN: Final = {"m": 1e-6, "deg": 1e-4, "%": 1e-3, "1": 1e-6, "m/s": 1e-6, "rad/s": 1e-6}
"""Smallest margin by unit, for values near zero. Poses differ by up to 1e-6 m and rad between
platforms, which is 1e-4 % of an angle of a radian. For times, the margin is a tick."""


def format_first_spec(run: Run, *, reference: str, read: ReadChoice | None = None) -> str:
    """Return a specification that a run passes; each reason gives the distance to the bound.

    `reference` is the run's file as the specification names it; `read` are the settings with which
    the run was read, so that other recordings are read equally.
    """
    head = [*_list_head(run, reference), *_list_read(read or ReadChoice())]
    return "\n".join([*head, *_list_checks(run)]) + "\n"


def name_reference(path: Path, target: Path | None) -> str:
    """Return the name by which a specification in `target` finds the reference."""
    folder = Path.cwd() if target is None else target.resolve().parent
    try:
        return Path(os.path.relpath(path.resolve(), folder)).as_posix()
    except ValueError:  # on Windows, for two different drives
        return path.resolve().as_posix()


def _list_head(run: Run, reference: str) -> Iterator[str]:
    yield f"# What runs like {_comment(run.name)} are held to: turtlelog check SPEC RUN..."
    yield "# Bounds marked observed = true were read off that run. Ask of each what it should be,"
    yield "# change it, and take the mark away."
    yield "format = 1"
    yield f"reference = {_quote(reference)}"


def _list_read(read: ReadChoice) -> Iterator[str]:
    """Yield the table `[read]` with the non-default settings; nothing if all are defaults."""
    lines = [
        f"{name} = {_quote(text)}"
        for name in READ_TEXTS
        if (text := getattr(read, name)) is not None
    ]
    if read.goal is not None:
        lines.append(f"goal = [{', '.join(map(repr, read.goal))}]")
    if read.wheels is not None:
        lines.append(f"wheels = [{', '.join(map(repr, read.wheels))}]")
    if read.wheelbase is not None:
        lines.append(f"wheelbase = {read.wheelbase!r}")
    if read.time != ReadChoice().time:
        lines.append(f"time = {_quote(read.time)}")
    if read.columns:
        columns = (f"{_quote(name)} = {_quote(text)}" for name, text in read.columns.items())
        lines.append(f"columns = {{ {', '.join(columns)} }}")
    if lines:
        yield from ("", "[read]", *lines)


def _list_checks(run: Run) -> Iterator[str]:
    if run.is_lawless:
        yield from _list_of_motion(run)
        return
    kinds = list_metrics(run.declaration)
    for metric in measure_run(run, only=_choose_metrics(run.declaration)).values():
        if not _is_name(metric.id):
            yield ""
            yield f"# {metric.id}: no formula can name it: - stands for minus"
        elif metric.value is None:
            yield ""
            yield f"# {metric.id}: no value here: {metric.status.value} ({_comment(metric.reason)})"
        else:
            tick_s = find_plant(run).period_s
            yield from _list_check(metric, metric.value, kinds[metric.id], tick_s)
    if run.goal_xy_m is not None and len(run.samples):
        yield from _list_arrival(run)


_COUNTS: Final = frozenset({"run.rest_share", "run.speed_steps", "run.turn_rate_steps"})
"""Metrics of the driving style, which a good run limits on both sides."""


def _list_of_motion(run: Run) -> Iterator[str]:
    """Yield checks for a third-party bag, on the metrics that have a value and on its commands."""
    kinds = list_metrics(run.declaration)
    steps_s = np.diff(run.poses.time_ns) / 1e9
    tick_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    for metric in measure_run(run, only=list_essential_metrics(run)).values():
        if metric.value is not None and metric.id not in _COUNTS:
            yield from _list_check(metric, metric.value, kinds[metric.id], tick_s)
    if not len(run.commands):
        return
    if find_ending(run) is RunEnding.LOST:
        yield ""
        yield "# always(abs(speed) <= ...): not read off, as part of the run is lost"
        return
    for name in ("speed", "turn_rate"):
        signal = find_signal(run, name)
        assert signal is not None
        yield from _list_bound(name, float(np.abs(signal.values).max()), signal.kind.unit)


def _list_bound(name: str, largest: float, unit: str) -> Iterator[str]:
    bound, spare = choose_bound(largest, unit, up=True)
    formula = f'holds = "always(abs({name}) <= {bound:.10g})"'
    meaning = ": as it was commanded, at any time"
    yield from _write_check(name, formula, format_number(largest, unit), spare, meaning)


def _write_check(
    title: str, formula: str, here: str, spare: str, meaning: str = ""
) -> Iterator[str]:
    yield ""
    yield f"[checks.{title}]"
    yield f"{formula}  # here {here}"
    yield "observed = true"
    yield f'reason = "observed, and {spare} to spare{meaning}"'


def _choose_metrics(declaration: Declaration) -> list[str]:
    """Return the ids of the metrics to check: those of every declared loop, the end and the run."""
    essential = list_essential_metrics(declaration)
    return [name for name in essential if name in _OF_RUN or name.rpartition(".")[2] in _OF_LOOP]


def _is_name(text: str) -> bool:
    """Return whether a formula can contain a name; a loop may be called `my-loop`."""
    return all(part.isidentifier() for part in text.split("."))


def _list_check(metric: Metric, value: float, kind: MetricKind, tick_s: float) -> Iterator[str]:
    is_higher = kind.better == "higher"
    base = value if kind.floor is None or is_higher else max(value, kind.floor)
    operator = ">=" if is_higher else "<="
    bound, spare = choose_bound(base, metric.unit, up=not is_higher, tick_s=tick_s)
    formula = f'expect = "{metric.id} {operator} {bound:.10g}"'
    yield from _write_check(f'"{metric.id}"', formula, format_number(value, metric.unit), spare)


def _list_arrival(run: Run) -> Iterator[str]:
    metric = measure_run(run, only=["run.cross_track_max"])["run.cross_track_max"]
    if metric.value is None:
        return
    if find_ending(run) in {RunEnding.CUT, RunEnding.LOST}:
        yield ""
        yield "# always(abs(cross_track) <= ...): not read off, as how the run went on is unknown"
        return
    bound, spare = choose_bound(metric.value, metric.unit, up=True)
    formula = f'holds = "always(abs(cross_track) <= {bound:.10g})"'
    meaning = ": how far beside the line, at any time"
    here = format_number(metric.value, metric.unit)
    yield from _write_check("track", formula, here, spare, meaning)


def choose_bound(
    value: float, unit: str, *, up: bool, tick_s: float = TURTLESIM.period_s
) -> tuple[float, str]:
    """Return a bound beyond an observed value, and its margin in words."""
    spare = abs(value) * _SHARE
    grain = tick_s if unit == "s" else _GRAIN.get(unit, 0.0)
    if spare < grain:
        words = f"{grain:.3g}" if unit == "1" else f"{grain:.3g} {unit}"
        return _round(value + grain if up else value - grain, digits=3, up=up), words
    bound = value
    for digits in (2, 3):
        bound = _round(value + spare if up else value - spare, digits=digits, up=up)
        if abs(bound - value) <= _MOST * abs(value):
            break
    return bound, f"{abs(bound - value) / abs(value):.0%}".replace("%", " %")


def _round(value: float, *, digits: int, up: bool) -> float:
    """Return a value with the given number of digits, rounded away from the observed value."""
    if value == 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
    steps = value / step
    if not math.isclose(steps, round(steps), rel_tol=1e-9):  # 0.1 has no more digits
        steps = math.ceil(steps) if up else math.floor(steps)
    return float(f"{steps * step:.{digits + 1}g}")


def _quote(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'


def _comment(text: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in text)
