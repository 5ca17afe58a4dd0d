"""What a replay changed of a run, in its essential metrics."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import format_table

if TYPE_CHECKING:
    from turtlelog import Metric, Run

    Measured = Mapping[str, Metric]

_OF_LOOP: Final = frozenset({"overshoot", "settling_time", "rms_error"})
_OF_RUN: Final = frozenset({"final.heading_error", "final.position_error", "run.duration"})


def _measure_both(recorded: "Run", replayed: "Run") -> "tuple[Measured, Measured]":
    """Return the essential metrics of both runs, in one order; what one does not have says so."""
    essential = tl.list_essential_metrics(recorded.declaration, replayed.declaration)
    parts = ((name, name.rpartition(".")[2]) for name in essential)
    of_loops = [name for name, plain in parts if plain in _OF_LOOP]
    names = [*(name for name in essential if name in _OF_RUN), *of_loops]
    return tl.measure_run(recorded, only=names), tl.measure_run(replayed, only=names)


def describe_changes(recorded: "Run", replayed: "Run") -> list[dict[str, Any]]:
    """Return the `metrics` list of the JSON answer."""
    was, now = _measure_both(recorded, replayed)
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
        for name in _list_ids(was, now)
    ]


def format_changes(recorded: "Run", replayed: "Run") -> str:
    """Return the essential metrics of both, and the difference."""
    was, now = _measure_both(recorded, replayed)
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
                for name in _list_ids(was, now)
            ),
        )
    )


def _get_cell(metric: "Metric") -> float | str:
    return metric.status.value if metric.value is None else metric.value


def _subtract(was: "Mapping[str, Metric]", now: "Mapping[str, Metric]", name: str) -> float | None:
    recorded, replayed = was[name].value, now[name].value
    return None if recorded is None or replayed is None else replayed - recorded


def _list_ids(was: "Measured", now: "Measured") -> list[str]:
    """Return the ids of both: the end, then loop by loop, then the whole run."""
    names = dict.fromkeys([*was, *now])
    ranks = {"final": 0, "run": 2}
    return sorted(names, key=lambda name: ranks.get(name.partition(".")[0], 1))
