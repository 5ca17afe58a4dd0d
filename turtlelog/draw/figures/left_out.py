"""Data of runs that figures and tables do not show, with reasons."""

import sys
from collections.abc import Iterable, Sequence
from typing import Final

from turtlelog.charts.characteristics import Characteristic, list_characteristics
from turtlelog.charts.close_up import ARRIVED_M, format_length
from turtlelog.charts.robot_curves import lack_samples
from turtlelog.charts.tracked_path import ON_PATH_M, list_paths
from turtlelog.compare import order_by_gain, tabulate_table1
from turtlelog.draw.figures.figure_kinds import (
    FIGURES,
    MOST_STATES,
    list_state_panels,
    list_usual_figures,
)
from turtlelog.draw.figures.marked_panels import has_marks
from turtlelog.draw.figures.needs import GOAL, POSES, SAMPLES, find_lacks
from turtlelog.draw.figures.page import label_runs
from turtlelog.draw.figures.plane_panels import has_one_plane
from turtlelog.measure import measure_run
from turtlelog.run import Run

_MOST_NAMED: Final = 3
"""Largest number of runs that are named as missing from a figure; more runs are only counted."""

_ARRIVAL: Final = f"one goal, and a run that ends within {format_length(ARRIVED_M)} of it"

_OF_MOTION: Final = frozenset({POSES, GOAL, "speed commands", "turn rate commands"})
"""Data that a recording without samples may contain."""

_DEPARTURE: Final = f"one path, and a run that is more than {format_length(ON_PATH_M)} off it"


def list_left_out(runs: Sequence[Run], names: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return what figures leave out of some runs and why, one line for each reason.

    Args:
        runs: Runs to draw, with the names of legends in these lines.
        names: Names of the requested figures. Default: all figures, and the tables.
    """
    runs = order_by_gain(runs)
    left_out: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    shown = list_usual_figures() if names is None else tuple(dict.fromkeys(names))
    for name in shown:
        for part, lacks in _list_parts(name, runs):
            for words in dict.fromkeys(filter(None, lacks)):
                lacking = tuple(number for number, lack in enumerate(lacks) if lack == words)
                left_out.setdefault((words, lacking), []).append(part)
    if lack_samples(runs):
        left_out = _join_controller(left_out, has_tables=names is None)
    lines = [_describe(words, lacking, parts, runs) for (words, lacking), parts in left_out.items()]
    if names is None and not has_table1(runs) and not lack_samples(runs):
        needed = GOAL if any(len(run.samples) for run in runs) else SAMPLES
        lines.append(f"left out table1.tex: needs a gain or {needed}")
    return (*lines, *_tell_states(runs, shown), *_tell_close_up(runs, shown))


def list_unmarked(runs: Sequence[Run], names: Iterable[str]) -> tuple[str, ...]:
    """Return one line on the figures whose curves have no characteristics, if any.

    Args:
        runs: Runs to draw.
        names: Names of the figures.
    """
    found = [list_characteristics(run, measure_run(run)) for run in runs]
    lacking = [name for name in names if not _is_marked(name, runs, found)]
    expected = "a curve with characteristics"
    return (f"left marks out of {', '.join(lacking)}: needs {expected}",) if lacking else ()


def _is_marked(name: str, runs: Sequence[Run], found: Sequence[Sequence[Characteristic]]) -> bool:
    signals = _list_signals(name, runs)
    return any(has_marks(signal, marks) for signal in signals for marks in found)


def _list_signals(name: str, runs: Sequence[Run]) -> list[str]:
    """Return the signals of the panels over time in a figure."""
    kind = FIGURES[name]
    panels = kind.choose_panels(runs) if kind.draw is None else ()
    return [panel.plot for panel in panels if panel.plot]


def _tell_states(runs: Sequence[Run], shown: Sequence[str]) -> list[str]:
    states = list_state_panels(runs, most=sys.maxsize)
    if "states" not in shown or len(states) <= MOST_STATES:
        return []
    return [
        f"left out states (from {states[MOST_STATES].name} on):"
        f" expected at most {MOST_STATES} panels, found {len(states)}"
    ]


def _tell_close_up(runs: Sequence[Run], shown: Sequence[str]) -> list[str]:
    """Return why there is no close-up; empty for runs without samples and goal."""
    if "plane" not in shown or not has_one_plane(runs):
        return []
    if lack_samples(runs) and not any(run.goal_xy_m for run in runs):
        return []
    part, expected = ("how each run ends", _ARRIVAL)
    if list_paths(runs):
        part, expected = ("furthest off the path", _DEPARTURE)
    return [f"left out plane ({part}): needs {expected}"]


_Left = dict[tuple[str, tuple[int, ...]], list[str]]
"""Omitted figures and panels, by missing data and by the runs without these data."""


def _join_controller(left_out: _Left, *, has_tables: bool) -> _Left:
    """Return missing controller data as one line: a recording without samples has none."""
    of_motion: _Left = {}
    of_controller: list[str] = []
    for (words, lacking), parts in left_out.items():
        if words in _OF_MOTION:
            of_motion[words, lacking] = parts
        else:
            of_controller += [part for part in parts if not part.startswith("panel (")]
            everyone = lacking
    if not of_controller:
        return of_motion
    tables = ["table1.tex"] if has_tables else []
    return {(SAMPLES, everyone): [*of_controller, *tables], **of_motion}


def has_table1(runs: Sequence[Run]) -> bool:
    """Return whether Table 1 of these runs contains anything but their names."""
    return any(value is not None for row in tabulate_table1(runs).rows for value in row[1:])


def _list_parts(name: str, runs: Sequence[Run]) -> list[tuple[str, tuple[str, ...]]]:
    """Return a figure, or its panels if their needs differ, with the data that each run lacks."""
    kind = FIGURES[name]
    if kind.draw is not None:
        return [(name, find_lacks(runs, kind.needs))]
    chosen = kind.choose_panels(runs)
    if not kind.is_usual and not chosen:
        return []
    if not kind.panels:
        return [(name, find_lacks(runs, kind.needs))]
    parts = [panel for panel in kind.panels if panel.is_usual or panel in chosen]
    if not chosen or len({(panel.needs, panel.loop) for panel in parts}) == 1:
        return [(name, parts[0].find_lacks(runs))]
    return [(f"{name} ({panel.name})", panel.find_lacks(runs)) for panel in parts]


def _describe(words: str, lacking: Sequence[int], parts: Sequence[str], runs: Sequence[Run]) -> str:
    listed = ", ".join(parts)
    if len(lacking) == len(runs):
        return f"left out {listed}: needs {words}"
    labels = label_runs(runs)
    named = ", ".join(labels[number] for number in lacking[:_MOST_NAMED])
    more = f" and {len(lacking) - _MOST_NAMED} more" if len(lacking) > _MOST_NAMED else ""
    return f"left {named}{more} out of {listed}: needs {words}"
