"""What a replay changed of a run, in its essential metrics."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import format_table

if TYPE_CHECKING:
    from turtlelog import Metric, Run

_ESSENTIAL: Final = (
    *("final.heading_error", "final.position_error", "rotate.overshoot", "rotate.settling_time"),
    *("translate.overshoot", "translate.settling_time", "run.duration"),
)


def describe_changes(recorded: "Run", replayed: "Run") -> list[dict[str, Any]]:
    """Return the `metrics` list of the JSON answer."""
    was, now = tl.measure_run(recorded), tl.measure_run(replayed)
    return [
        {
            "id": name,
            "unit": was[name].unit,
            "recorded": was[name].value,
            "recorded_status": was[name].status.value,
            "replayed": now[name].value,
            "replayed_status": now[name].status.value,
            "difference": _subtract(was, now, name),
        }
        for name in _ESSENTIAL
    ]


def format_changes(recorded: "Run", replayed: "Run") -> str:
    """Return the essential metrics of both, and the difference."""
    was, now = tl.measure_run(recorded), tl.measure_run(replayed)
    return format_table(
        tl.Table(
            title=f"{recorded.name}, and what became of it: {replayed.name}",
            columns=tuple(
                tl.Column(title=title)
                for title in ("metric", "unit", "recorded", "replayed", "difference")
            ),
            rows=tuple(
                (
                    name,
                    was[name].unit,
                    _get_cell(was[name]),
                    _get_cell(now[name]),
                    _subtract(was, now, name),
                )
                for name in _ESSENTIAL
            ),
        )
    )


def _get_cell(metric: "Metric") -> float | str:
    return metric.status.value if metric.value is None else metric.value


def _subtract(was: "Mapping[str, Metric]", now: "Mapping[str, Metric]", name: str) -> float | None:
    recorded, replayed = was[name].value, now[name].value
    return None if recorded is None or replayed is None else replayed - recorded
