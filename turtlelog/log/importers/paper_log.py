"""What the layouts of the paper's logs share: the same lists, checked and put into columns."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.laws.sequential_p import DECLARATION
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.run.loops import DONE

_PHASES: Final = {name: number for number, name in enumerate(DECLARATION.phase_names)}

STATES: Final = MappingProxyType(
    {
        "ROTACIONAR": _PHASES["rotate"],
        "TRANSLADAR": _PHASES["translate"],
        "FINALIZADO": _PHASES[DONE],
    }
)
"""The number of the phase that a state names: that AFTER the callback."""

NUMBERS: Final = (
    *("time", "pos_x", "pos_y", "pos_theta", "target_angle_rad", "error_angle", "error_x"),
    *("error_y", "error_distance", "vel_linear_x", "vel_angular_z", "vel_x_global"),
    "vel_y_global",
)
"""The lists of numbers, by the names of the JSON layout."""

_LONGEST_S: Final = 4e9  # beyond any clock, and well within 64 bits of nanoseconds

_POSE_TIMES: Final = "of the callbacks that read them: in a burst they are later than the poses"

_NEVER_LOGGED: Final = (
    *("poses.speed_m_s", "poses.turn_rate_rad_s"),
    *("samples.wanted_speed_m_s", "samples.wanted_turn_rate_rad_s", "stop_reason", "events"),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PaperLog:
    """A log as its file holds it, every value checked by itself.

    Attributes:
        name: Of the run.
        source: Layout and name of the file.
        columns: The lists of `NUMBERS`, all of one length.
        states: Phase after each callback, as long.
        parameters: What is known of the scenario, by dotted key.
        absent: What this layout could hold and the file does not.
        notes: As in `Run`.
    """

    name: str
    source: str
    columns: Mapping[str, NDArray[np.float64]]
    states: NDArray[np.int64]
    parameters: Mapping[str, float] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)


def require_number(place: str, value: object) -> float:
    """Return a finite number.

    Raises:
        LogError: Where it is something else.
    """
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise LogError(f"{place}: expected a number, found {_shorten(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise LogError(f"{place}: expected a finite number, found {_shorten(value)}")
    return number


def require_state(place: str, value: object) -> int:
    """Return the number of the phase that a state names.

    Raises:
        LogError: Where there is no such state.
    """
    if not isinstance(value, str) or value not in STATES:
        raise LogError(f"{place}: expected one of {', '.join(STATES)}, found {_shorten(value)}")
    return STATES[value]


def build_columns(
    lists: Mapping[str, Sequence[object]], places: Mapping[str, str]
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.int64]]:
    """Return the columns of numbers, and the states; `places` says what a list is called.

    Raises:
        LogError: Where there is no row, or a value is wrong.
    """
    if not lists["time"]:
        raise LogError(f"{places['time']}: no rows")
    columns = {}
    for name in NUMBERS:
        place = places[name]
        values = [require_number(f"{place}[{i}]", value) for i, value in enumerate(lists[name])]
        columns[name] = np.array(values, dtype=np.float64)
    place = places["state"]
    states = [require_state(f"{place}[{i}]", value) for i, value in enumerate(lists["state"])]
    return columns, np.array(states, dtype=np.int64)


def build_paper_run(log: PaperLog, *, sort: bool) -> Run:
    """Return the run in a log.

    The log does not say why it ended: a run that came to its end has the stop reason `finished`.

    Raises:
        LogError: Where the times do not increase.
    """
    columns, states = dict(log.columns), log.states
    notes = {**log.notes, "pose_times": _POSE_TIMES}
    if sort:
        columns, states, counts = _sort_rows(columns, states)
        notes |= counts
    _require_rising(columns["time"], is_sorted=sort)
    time_ns = np.rint((columns["time"] - columns["time"][0]) * 1e9).astype(np.int64)
    goal_xy_m = _find_goal(log.parameters, columns)
    is_finished = states[-1] == _PHASES[DONE]
    return Run(
        name=log.name,
        source=log.source,
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=np.column_stack([columns["pos_x"], columns["pos_y"]]),
            heading_rad=columns["pos_theta"],
        ),
        commands=CommandColumns(
            time_ns=time_ns,
            speed_m_s=columns["vel_linear_x"],
            lateral_speed_m_s=np.zeros(len(time_ns)),
            turn_rate_rad_s=columns["vel_angular_z"],
        ),
        samples=_build_samples(time_ns, columns, states),
        goal_xy_m=goal_xy_m,
        declaration=DECLARATION,
        parameters=log.parameters,
        stop_reason="finished" if is_finished else None,
        absent=(*_NEVER_LOGGED, *log.absent, *(() if goal_xy_m else ("goal_xy_m",))),
        notes=notes,
    )


def _build_samples(
    time_ns: NDArray[np.int64],
    columns: Mapping[str, NDArray[np.float64]],
    states: NDArray[np.int64],
) -> SampleColumns:
    rows = np.arange(len(time_ns))
    return SampleColumns(
        time_ns=time_ns,
        sequence=rows,
        pose_sequence=rows,
        # A command was computed in the state that the callback before it left.
        phase=np.array([_PHASES["rotate"], *states[:-1]], dtype=np.int64),
        bearing_rad=columns["target_angle_rad"],
        heading_error_rad=columns["error_angle"],
        error_xy_m=np.column_stack([columns["error_x"], columns["error_y"]]),
        distance_m=columns["error_distance"],
        speed_m_s=columns["vel_linear_x"],
        turn_rate_rad_s=columns["vel_angular_z"],
        world_velocity_m_s=np.column_stack([columns["vel_x_global"], columns["vel_y_global"]]),
    )


def _find_goal(
    parameters: Mapping[str, float], columns: Mapping[str, NDArray[np.float64]]
) -> tuple[float, float] | None:
    """Return the goal as given, or position plus error where every row gives the same."""
    if "goal.x_m" in parameters and "goal.y_m" in parameters:
        return parameters["goal.x_m"], parameters["goal.y_m"]
    goal = np.column_stack(
        [columns["pos_x"] + columns["error_x"], columns["pos_y"] + columns["error_y"]]
    )
    return (float(goal[0, 0]), float(goal[0, 1])) if (goal == goal[0]).all() else None


def _sort_rows(
    columns: dict[str, NDArray[np.float64]], states: NDArray[np.int64]
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.int64], dict[str, str]]:
    """Drop rows that are there twice, then sort by time; count both."""
    rows = zip(*(columns[name].tolist() for name in NUMBERS), states.tolist(), strict=True)
    firsts = np.array(sorted({row: i for i, row in reversed(list(enumerate(rows)))}.values()))
    time = columns["time"][firsts]
    late = int((time < np.maximum.accumulate(time)).sum())
    order = firsts[np.argsort(time, kind="stable")]
    counts = {"sorted_rows": str(late), "dropped_duplicates": str(len(states) - len(firsts))}
    return {name: values[order] for name, values in columns.items()}, states[order], counts


def _require_rising(time: NDArray[np.float64], *, is_sorted: bool) -> None:
    if abs(time).max() > _LONGEST_S:
        row = int(abs(time).argmax())
        raise LogError(f"time[{row}]: expected up to {_LONGEST_S:g} s, found {time[row]}")
    wrong = np.diff(time) <= 0
    if wrong.any():
        row = int(wrong.argmax()) + 1
        advice = "importing with --sort puts rows in order"
        advice = "two rows of one time differ" if is_sorted else advice
        raise LogError(
            f"time[{row}]: expected more than {time[row - 1]}, found {time[row]}: {advice}"
        )


def _shorten(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."
