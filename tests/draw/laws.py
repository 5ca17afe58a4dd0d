"""Runs of laws of every kind: no goal, no loop, one phase or eight, references that move."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import turtlelog as tl
from tests.strange_law import KIND as STRANGE
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path as Track

EXAMPLE: Final = f"{Path(__file__).parents[2] / 'examples' / 'turn_and_drive.py'}:TurnAndDrive"


@dataclass(frozen=True, kw_only=True)
class Gains:
    gain: float = 2.0


class _Plain:
    Parameters = Gains

    def __init__(self, parameters: Gains) -> None:
        self.gain = parameters.gain
        self.count = 0

    def reset(self, start: Pose, goal: Goal | None, path: Track | None) -> None:
        self.start, self.goal, self.count = start, goal, 0


class OpenLoop(_Plain):
    """Drives a curve without a goal or a loop."""

    @classmethod
    def declare(cls, parameters: Gains, goal: Goal | None, path: Track | None) -> Declaration:
        return Declaration(uses_goal=False)

    def step(self, time_ns: int, pose: Pose) -> Decision:
        self.count += 1
        stop = "end" if self.count > 100 else None
        return Decision(speed_m_s=0.5, turn_rate_rad_s=0.3, stop_reason=stop)


class EightPhases(_Plain):
    """Creeps ahead in eight phases, the last two of them in turns; nothing controls the heading."""

    names = ("sim", "wall", "c", "d", "e", "f", "g", "h")

    @classmethod
    def declare(cls, parameters: Gains, goal: Goal | None, path: Track | None) -> Declaration:
        loop = ControlLoop(name="creep", signal="distance", command="speed", reference="zero")
        phases = dict.fromkeys(cls.names, ("creep",))
        return Declaration(loops=(loop,), phases=phases, states=("left", "seen", "worn", "old"))

    def step(self, time_ns: int, pose: Pose) -> Decision:
        phase = min(self.count // 10, 7)
        self.count += 1
        stop = "end" if self.count > 100 else None
        states = (float(self.count), 1.0, 2.0, -1.0)
        return Decision(
            speed_m_s=0.2,
            turn_rate_rad_s=0.0,
            phase=self.names[phase],
            states=states,
            stop_reason=stop,
        )


class Follower(_Plain):
    """Follows a pose that goes ahead of it along the axes, by two loops of one command."""

    @classmethod
    def declare(cls, parameters: Gains, goal: Goal | None, path: Track | None) -> Declaration:
        loops = (
            ControlLoop(name="near", signal="distance", command="speed", reference="recorded"),
            ControlLoop(
                name="along",
                signal="along_track",
                command="speed",
                reference="recorded",
                gain="law.gain",
            ),
            ControlLoop(
                name="straight",
                signal="heading",
                command="turn_rate",
                reference="zero",
                gain="law.gain",
            ),
        )
        phases = {"free": (), "follow": ("near", "along", "straight")}
        return Declaration(loops=loops, phases=phases)

    def step(self, time_ns: int, pose: Pose) -> Decision:
        self.count += 1
        if self.count <= 20:
            return Decision(speed_m_s=0.0, turn_rate_rad_s=0.2, phase="free")
        wanted = Pose(self.start.x_m + 0.005 * self.count, self.start.y_m, 0.0)
        return Decision(
            speed_m_s=self.gain * (wanted.x_m - pose.x_m),
            turn_rate_rad_s=-self.gain * pose.heading_rad,
            phase="follow",
            reference=wanted,
            stop_reason="end" if self.count > 200 else None,
        )


def add_terms(run: tl.Run) -> tl.Run:
    """Return a run as one of a law whose commands are more than gain times error."""
    loops = tuple(replace(loop, is_proportional=False) for loop in run.declaration.loops)
    return replace(run, declaration=replace(run.declaration, loops=loops))


LAWS: Final = {name: f"{Path(__file__)}:{name}" for name in ("OpenLoop", "EightPhases", "Follower")}


SQUARE: Final = ((3.0, 3.0), (6.0, 3.0), (6.0, 6.0), (3.0, 6.0))
TRACKERS: Final = ("kanayama", "pure-pursuit")


@cache
def simulate_tracker(kind: str, **changes: Any) -> tl.Run:
    """Return a run of a law that tracks a square at 0.5 m/s, named after the law."""
    return tl.simulate_run(build_tracker(kind, **changes))


def build_tracker(kind: str, **changes: Any) -> tl.Scenario:
    path = {"path.kind": "polygon", "path.points": [list(point) for point in SQUARE]}
    start = {"start.x_m": 3.0, "start.y_m": 3.0}
    values = {"law.kind": kind, "name": kind, **path, "path.speed_m_s": 0.5, **start, **changes}
    return tl.override_scenario(tl.load_scenario("textbook"), values)


@cache
def simulate_untimed() -> tl.Run:
    """Return a run along a square to which no time belongs."""
    scenario = build_tracker("pure-pursuit", name="untimed")
    assert scenario.path is not None
    return tl.simulate_run(replace(scenario, path=replace(scenario.path, speed_m_s=None)))


@cache
def simulate_pid() -> tl.Run:
    """Return a run whose loops have an integral and a derivative each."""
    gains = {"law.ki_angular": 0.5, "law.kd_angular": 0.1, "law.ki_linear": 0.2}
    values = {"law.kind": "sequential-pid", **gains, "law.kd_linear": 0.05, "name": "pid"}
    return tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), values))


@cache
def simulate_law(kind: str, **changes: Any) -> tl.Run:
    """Return a run of one of these laws, of the example or of the strange one, named after it."""
    return tl.simulate_run(build_scenario(kind, **changes))


def build_scenario(kind: str, **changes: Any) -> tl.Scenario:
    known = {**LAWS, "example": EXAMPLE, "strange": STRANGE}
    values = {"law.kind": known[kind], "name": kind, **changes}
    if kind == "strange":
        values.setdefault("law.gain_a", 4.0)
    return tl.override_scenario(tl.load_scenario("textbook"), values)


KINDS: Final = ("strange", "example", *LAWS)


def forget_loops(run: tl.Run) -> tl.Run:
    """Return a run as a recording of format 1 holds one of another law: phases without loops."""
    declared = run.declaration
    phases = dict.fromkeys(declared.phases, ())
    samples = replace(run.samples, states=None)
    return replace(run, declaration=Declaration(phases=phases), samples=samples)
