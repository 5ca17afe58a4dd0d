"""Differences of metrics between a replay and its recording."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import fit_table

if TYPE_CHECKING:
    from turtlelog import Metric, Run

    Measured = Mapping[str, Metric]


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricChange:
    """A metric of the recording and of the replay; null if a status gives the reason."""

    id: str
    unit: str
    recorded: float | None
    recorded_status: str
    replayed: float | None
    replayed_status: str
    difference: float | None


_OF_LOOP: Final = frozenset({"overshoot", "settling_time", "rms_error"})
_OF_RUN: Final = frozenset(
    {
        *("final.heading_error", "final.position_error", "run.duration"),
        *("run.speed_effort", "run.turn_rate_effort"),  # essential without a goal
    }
)


def _measure_both(recorded: "Run", replayed: "Run") -> "tuple[Measured, Measured]":
    """Return the essential metrics of both runs in one order. Missing metrics have a status."""
    essential = tl.measure.list_essential_metrics(recorded.declaration, replayed.declaration)
    parts = ((name, name.rpartition(".")[2]) for name in essential)
    of_loops = [name for name, plain in parts if plain in _OF_LOOP]
    names = [*(name for name in essential if name in _OF_RUN), *of_loops]
    return tl.measure_run(recorded, only=names), tl.measure_run(replayed, only=names)


def build_changes(recorded: "Run", replayed: "Run") -> list[MetricChange]:
    """Return the metrics of both runs."""
    was, now = _measure_both(recorded, replayed)
    return [
        MetricChange(
            id=name,
            unit=was[name].unit,
            recorded=was[name].value,
            recorded_status=was[name].status.value,
            replayed=now[name].value,
            replayed_status=now[name].status.value,
            difference=_subtract(was, now, name),
        )
        for name in _list_ids(was, now)
    ]


def format_changes(recorded: "Run", replayed: "Run") -> str:
    """Return the essential metrics of both runs, with their differences."""
    was, now = _measure_both(recorded, replayed)
    return fit_table(
        tl.compare.Table(
            title="Metrics of the recording and of the replay",
            columns=tuple(
                tl.compare.Column(title=title)
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


def _subtract(was: "Measured", now: "Measured", name: str) -> float | None:
    recorded, replayed = was[name].value, now[name].value
    return None if recorded is None or replayed is None else replayed - recorded


def _list_ids(was: "Measured", now: "Measured") -> list[str]:
    """Return the ids of both runs: the end, then each loop, then the whole run."""
    names = dict.fromkeys([*was, *now])
    ranks = {"final": 0, "run": 2}
    return sorted(names, key=lambda name: ranks.get(name.partition(".")[0], 1))
