"""Adapter that answers pose by pose: a law that is a part, used like a law that is a class."""

import math
from dataclasses import dataclass
from functools import cache
from inspect import signature
from typing import Any, ClassVar, Final

from turtlelog.errors import LawError
from turtlelog.laws.base import Decision, Goal, LawPart, Pose
from turtlelog.run.path_pieces import PathNumbers
from turtlelog.run.paths import Path


@dataclass(slots=True)
class _Goal:
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = math.nan


@dataclass(slots=True)
class _Limits:
    speed_m_s: float = math.inf
    turn_rate_rad_s: float = math.inf


@dataclass(slots=True)
class _Settings:
    law: Any
    goal: _Goal
    limits: _Limits
    path: PathNumbers


@dataclass(slots=True)
class _Row:
    """Values that the step of a law writes for one sample."""

    phase: int = 0
    blocks_ticks: int = 0
    stop: int = 0
    ends_phase: bool = False
    bearing_rad: float = math.nan
    heading_error_rad: float = math.nan
    error_x_m: float = math.nan
    error_y_m: float = math.nan
    distance_m: float = math.nan
    world_v_x_m_s: float = math.nan
    world_v_y_m_s: float = math.nan
    reference_x_m: float = math.nan
    reference_y_m: float = math.nan
    reference_heading_rad: float = math.nan


_NO_PATH: Final = PathNumbers()


class AskedLaw:
    """A law with its parameters. Each part has a subclass of its own.

    Attributes:
        parameters: Parameters of the law.
    """

    Parameters: ClassVar[type[Any]]
    _part: ClassVar[LawPart]

    def __init__(self, parameters: Any) -> None:
        """Store the parameters. Commands are not clipped before `take_limits` is called."""
        part, self.parameters = self._part, parameters
        numbers = parameters if part.prepare is None else part.prepare(parameters)
        self._settings = _Settings(numbers, _Goal(), _Limits(), _NO_PATH)
        self._table = () if part.build_table is None else part.build_table(parameters)
        self._names = [*signature(part.step).parameters]

    def take_limits(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the limits at which the loop clips the commands."""
        self._settings.limits = _Limits(speed_m_s, turn_rate_rad_s)

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Begin a run.

        Raises:
            LawError: If the law needs a goal or a path that is missing.
        """
        del start
        declaration = self._part.declare(self.parameters, goal, path)
        if declaration.uses_goal and goal is None:
            raise LawError("the law needs a goal: set goal.x_m and goal.y_m")
        if goal is not None:
            heading_rad = math.nan if goal.heading_rad is None else goal.heading_rad
            self._settings.goal = _Goal(goal.x_m, goal.y_m, heading_rad)
        self._settings.path = _NO_PATH if path is None else path.numbers
        self._pieces = () if path is None else path.ways
        self._phases, self._states = declaration.phase_names, declaration.states
        self._state = self._part.State()

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose."""
        row, state = _Row(), self._state
        given = {
            "settings": self._settings,
            "state": state,
            "table": self._table,
            "pieces": self._pieces,
            "row": row,
            "time_ns": time_ns,
            "pose": (pose.x_m, pose.y_m, pose.heading_rad),
        }
        speed, turn_rate = self._part.step(*(given[name] for name in self._names))
        has_reference = not math.isnan(row.reference_x_m)
        reference = Pose(row.reference_x_m, row.reference_y_m, row.reference_heading_rad)
        return Decision(
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
            phase=self._phases[row.phase],
            bearing_rad=_read_error(row.bearing_rad),
            heading_error_rad=_read_error(row.heading_error_rad),
            error_x_m=_read_error(row.error_x_m),
            error_y_m=_read_error(row.error_y_m),
            world_v_x_m_s=row.world_v_x_m_s,
            world_v_y_m_s=row.world_v_y_m_s,
            states=tuple(getattr(state, name) for name in self._states),
            reference=reference if has_reference else None,
            blocks_ticks=row.blocks_ticks,
            ends_phase=row.ends_phase,
            stop_reason=self._part.stops[row.stop - 1] if row.stop else None,
        )


def _read_error(value: float) -> float | None:
    """Return a value that a step wrote, or None if the step did not write it."""
    return None if math.isnan(value) else value


@cache
def build_class(part: LawPart) -> type[AskedLaw]:
    """Return a class for a part, with the same declarations as a law that is a class."""
    members = {
        "__doc__": part.meaning,
        "__module__": part.step.__module__,
        "_part": part,
        "Parameters": part.Parameters,
        "declare": staticmethod(part.declare),
        "causes": part.causes,
        "counts_samples": part.counts_samples,
        "list_unused": staticmethod(part.list_unused),
    }
    return type(part.name, (AskedLaw,), members)
