"""What a recording holds, as far as its layout must know."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from turtlelog.measure import read_signal
from turtlelog.run import Run
from turtlelog.show.close_up import CloseUp, find_close_up
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.plots import LevelLines, Series
from turtlelog.show.rerun.world import Bounds, find_plane_bounds
from turtlelog.show.shared_curves import find_end_of_turn

_HEADROOM = 1.25
"""End of a command's range, as a multiple of its most extreme value."""

_ROOM = 0.08
"""Room above and below what was measured, as a share of its range; where all values are one, of
that value."""

_LEAST_ROOM = 1e-9
"""In the unit of the plot, at least where all values are one: a range needs a height."""

_LEAST_SIDE = 0.15
"""What a command's range shows at least on either side of 0, as a share of its largest limit,
times `_HEADROOM`."""

_CLOSE_UP = 2.0
"""Half-height of the close-up, as a multiple of the largest error in it: it fills half of it."""

_SMALLEST_CLOSE_UP_DEG = 0.1
"""Half-height of the close-up at least [deg]: also errors of 0 need a range with a height."""

_MOST_IN_PLOT = 4
"""How many runs a legend inside a plot names; of more, the names have a view of their own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """What a recording holds for its layout.

    Attributes:
        prefixes: Entity prefix of each run; one empty prefix for a run alone.
        series: Entity paths of the curves, in the order of drawing.
        references: Plots that have level lines.
        lines: Entity paths of upright lines, shown in every plot.
        highest_speed_m_s: What the brightest colour of the trace by speed means; None without one.
        shares_title: Title of the bars, None without them.
        has_dead_time: Whether the first run's dead times are drawn.
        legend_names: Names of the runs where they need a view of their own, else none.
        with_phases: How many runs have samples.
        has_events: Whether a run has events.
        documents: Titles.
        plane: What the plane shows.
        goal: What the close-up of the goal shows, None without one.
        ranges: Fixed ranges of values, by plot.
        close_ups: Plots whose range does not hold all of their curves.
        ends: Last values of the first curves of plots, where they have come to their end.
        controlled: Plots of signals that a loop of a run controls.
    """

    prefixes: tuple[str, ...]
    series: tuple[str, ...]
    references: frozenset[str]
    lines: tuple[str, ...] = ()
    highest_speed_m_s: float | None = None
    shares_title: str | None = None
    has_dead_time: bool = False
    legend_names: tuple[str, ...]
    with_phases: int
    has_events: bool
    documents: tuple[str, ...]
    plane: Bounds
    goal: CloseUp | None
    ranges: Mapping[str, tuple[float, float]]
    close_ups: frozenset[str] = frozenset()
    ends: Mapping[str, float] = field(default_factory=dict)
    controlled: frozenset[str] = frozenset()

    def list_states(self) -> list[str]:
        """Return the plots of the laws' states, in order."""
        roots = [join_path(prefix, entities.STATE) + "/" for prefix in self.prefixes]
        found = [
            path.removeprefix(root)
            for root in roots
            for path in self.series
            if path.startswith(root)
        ]
        return [f"{entities.STATE}/{name}" for name in dict.fromkeys(found)]

    def list_curves(self, plot: str) -> list[str]:
        """Return the entity paths of a plot's curves: of its own name, and below it."""
        names = [join_path(prefix, plot) for prefix in self.prefixes]
        return [
            path
            for name in names
            for path in self.series
            if path == name or path.startswith(f"{name}/")
        ]


def describe_content(
    runs: Sequence[Run],
    prefixes: Sequence[str],
    series: Sequence[Sequence[Series]],
    references: Sequence[LevelLines],
    documents: Iterable[str],
    *,
    names: Sequence[str] = (),
) -> Content:
    """Return what a recording of these runs holds, `series` being what is drawn of each."""
    close_ups = _find_close_up(runs)
    return Content(
        prefixes=tuple(prefixes),
        series=tuple(
            join_path(prefix, curves.entity)
            for prefix, listed in zip(prefixes, series, strict=True)
            for curves in listed
        ),
        references=frozenset(reference.plot for reference in references),
        legend_names=tuple(names) if len(names) > _MOST_IN_PLOT else (),
        with_phases=sum(len(run.samples) > 0 for run in runs),
        has_events=any(run.events for run in runs),
        documents=tuple(documents),
        plane=find_plane_bounds(runs),
        goal=find_close_up(runs),
        ranges={
            **_find_ranges(series, references),
            **_find_command_ranges(series, references),
            **close_ups,
        },
        close_ups=frozenset(close_ups),
        controlled=frozenset(
            entities.PLOTS[loop.signal] for run in runs for loop in run.declaration.loops
        ),
    )


def find_largest(content: Content) -> float:
    """Return the largest magnitude that any plot shows."""
    return max((abs(bound) for bounds in content.ranges.values() for bound in bounds), default=1.0)


def find_ends(series: Sequence[Series], ranges: Mapping[str, object]) -> dict[str, float]:
    """Return the last known value of the first curve of each plot that has a range."""
    ends: dict[str, float] = {}
    for curves in series:
        known = curves.values[np.isfinite(curves.values[:, 0]), 0]
        if len(known) and curves.plot in ranges:
            ends.setdefault(curves.plot, float(known[-1]))
    return ends


def _find_ranges(
    series: Sequence[Sequence[Series]], references: Sequence[LevelLines]
) -> dict[str, tuple[float, float]]:
    """Return ranges with room around what was measured: what theory expects may lie far beyond."""
    found: dict[str, list[float]] = {}
    for curves in (curves for run in series for curves in run if curves.is_measured):
        values = curves.values[np.isfinite(curves.values)]
        if len(values):
            found.setdefault(curves.plot, []).extend((float(values.min()), float(values.max())))
    for reference in references:
        if reference.plot in found:
            found[reference.plot] += reference.levels
    return {plot: _add_room(min(values), max(values)) for plot, values in found.items()}


def _add_room(low: float, high: float) -> tuple[float, float]:
    room = _ROOM * (high - low) or max(_ROOM * abs(high), _LEAST_ROOM)
    return low - room, high + room


def _find_command_ranges(
    series: Sequence[Sequence[Series]], references: Sequence[LevelLines]
) -> dict[str, tuple[float, float]]:
    """Return ranges that end a little beyond the limits; wanted commands may lie far beyond."""
    ranges = {}
    for reference in references:
        if reference.plot not in {entities.SPEED, entities.TURN_RATE}:
            continue
        kinds = {f"{reference.plot}/{kind}" for kind in (entities.COMMANDED, entities.APPLIED)}
        values = [curves.values for run in series for curves in run if curves.entity in kinds]
        least = _LEAST_SIDE * max(reference.levels)
        low = min((float(column.min()) for column in values), default=0.0)
        high = max((float(column.max()) for column in values), default=0.0)
        ranges[reference.plot] = min(low, -least) * _HEADROOM, max(high, least) * _HEADROOM
    return ranges


def _find_close_up(runs: Sequence[Run]) -> dict[str, tuple[float, float]]:
    """Return the range of heading errors that remain after turning: the turn itself hides them.

    None where a loop of the heading acts in every phase, or never.
    """
    largest_deg = 0.0
    for run in runs:
        errors = read_signal(run, "heading_error")
        if errors is None:
            continue
        end_ns = find_end_of_turn(run)
        if end_ns is None:
            return {}
        after = np.abs(errors.values[errors.time_ns >= end_ns])
        largest_deg = max(largest_deg, float(np.degrees(after.max(initial=0.0))))
    half_deg = max(_CLOSE_UP * largest_deg, _SMALLEST_CLOSE_UP_DEG)
    return {entities.HEADING_ERROR: (-half_deg, half_deg)}
