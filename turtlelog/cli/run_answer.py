"""The answer of `turtlelog run`: as an object, and in words."""

from dataclasses import dataclass, replace
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import describe_metrics, fill_lines, format_table
from turtlelog.display import describe_count

if TYPE_CHECKING:
    from turtlelog import Run

_LONGEST: Final = 24
"""Of a name [characters]: of a longer one the changes have a line of their own."""

_REACHED: Final = "within_tolerance"
_MISSED: Final = ("standstill", "settled", "timeout", "max_duration")
"""Reasons to stop of built-in laws that do not reach the goal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunAnswer:
    """How a simulated run ended.

    Attributes:
        name: Of the run.
        file: The recording that was written; None without one.
        rrd: The Rerun recording that was written; None without one.
        samples: Number of samples.
        stop_reason: Why it ended.
        metrics: All its metrics.
    """

    name: str
    file: str | None
    rrd: str | None
    samples: int
    stop_reason: str | None
    metrics: list[dict[str, Any]]


def build_answer(run: "Run", *, output: Path | None, rrd: Path | None) -> RunAnswer:
    """Return the answer."""
    return RunAnswer(
        name=run.name,
        file=None if output is None else str(output),
        rrd=None if rrd is None else str(rrd),
        samples=len(run.samples),
        stop_reason=run.stop_reason,
        metrics=describe_metrics(tl.measure_run(run)),
    )


def write_end(run: "Run") -> str:
    """Return how far from the goal a run ended and when, and why it ended."""
    name, changes = _split_name(run)
    lines = [f"{name}: {_write_result(run)}."]
    lines += [f"Changed: {changes}"] if changes else []
    lines += [f"{describe_count(len(run.samples), 'sample')}. {run.events[-1].text}"]
    return fill_lines(lines)


def _split_name(run: "Run") -> tuple[str, str]:
    """Return a name that fits a table, and the changes that a longer one tells."""
    base, _, changes = run.name.partition(" ")
    return (run.name, "") if len(run.name) <= _LONGEST or not changes else (base, changes)


def _write_result(run: "Run") -> str:
    """Return the distance to the goal at the end; of a run without a goal what it did."""
    metric = tl.explain.choose_metric(run.declaration)
    found = tl.measure_run(run, only=[metric, "run.duration"])
    value, duration_s = found[metric].value, found["run.duration"].value
    after = "" if duration_s is None else f" after {duration_s:.3g} s"
    if value is None:
        return f"ended{after}; {metric} has no value: {found[metric].reason}"
    if metric != "final.position_error":
        size = f"{value:.4g} {found[metric].unit}".removesuffix(" 1")
        return f"ended{after}, {metric} {size}"
    size = f"{1e3 * value:.3g} mm" if value < 0.01 else f"{value:.3g} m"
    # A law that reads other poses than the robot's stops where it believes the goal to be.
    is_seen = run.poses.sensed_xy_m is None
    if (run.stop_reason == _REACHED and is_seen) or value <= _allow(run):
        return f"reached the goal within {size}{after}"
    if run.stop_reason in _MISSED:
        return f"missed the goal by {size}{after}"
    return f"ended {size} from the goal{after}"


def _allow(run: "Run") -> float:
    """Return the distance to the goal that the tolerances of the law allow [m]; 0 without them."""
    heading_rad = run.parameters.get("law.heading_tolerance_rad")
    position_m = run.parameters.get("law.position_tolerance_m")
    if not isinstance(heading_rad, float | int) or not isinstance(position_m, float | int):
        return 0.0
    if run.goal_xy_m is None:
        return 0.0
    from turtlelog.compare.ranking import allow_position

    return allow_position(heading_rad, position_m, dist(run.goal_xy_m, run.poses.xy_m[0]))


def format_run(run: "Run") -> str:
    """Return the essential metrics as a table."""
    only = tl.measure.list_essential_metrics(run.declaration)
    named = replace(run, name=_split_name(run)[0])
    return format_table(tl.compare.tabulate_metrics([named], only=only))
