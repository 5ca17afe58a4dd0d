"""Logs with known truth: turtlesim and the paper's controller once more, from their descriptions.

This shares no code with `turtlelog/simulate` or `turtlelog/laws`, so that neither can hide a fault
of the other. It is checked against the paper's own logs, bit for bit.
"""

import json
import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from turtlelog.log.paper_log import parse_paper_json
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

PI = 3.14159265
SIZE = float(np.float32(499 / 45))
SPAWN = float(np.float32(5.5444446))
LISTS = (
    *("time", "pos_x", "pos_y", "pos_theta", "target_angle_rad", "error_angle", "error_x"),
    *("error_y", "error_distance", "vel_linear_x", "vel_angular_z", "vel_x_global"),
    *("vel_y_global", "state"),
)
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """How a log is made. The defaults are the paper's run at Kp = 4.

    Attributes:
        law: `p`; `pid` (with an integral and a derivative); `cubic` (the cube of the heading error,
            the distance instead of its projection); `bang` (full speed until the tolerance).
        start: x, y, heading of the plant in double precision; published as 32-bit floats.
        noise: Standard deviation of what the controller reads [m, rad].
        hidden_noise: Standard deviation of what the controller reads, where the log has the pose
            without it [m, rad].
        log_noise: Standard deviation that only the log has: the controller read the true pose.
        quantum: Step of what the controller reads [m, rad].
        log_quantum: Step of what the log holds.
        jitter_s: Of the wall clock, uniform on either side.
        teleports: By tick: x, y, heading.
    """

    law: str = "p"
    kp_angular: float = 4.0
    kp_linear: float = 4.0
    turn_limit: float = 1.0
    speed_limit: float = 1.0
    heading_tolerance: float = 0.001
    position_tolerance: float = 0.001
    on_heading: bool = False
    wrap: bool = False
    pause: int = 34
    timeout_s: float = 30.0
    settled_for_s: float = 5.0
    settled_within: float = 0.01
    standstill_samples: int = 100
    standstill_below: float = 0.001
    backlog: int = 6
    pose_queue: int = 10
    command_queue: int = 7
    newest: bool = False
    delay: int = 0
    period: int = 1
    start: Vector = (SPAWN, SPAWN, 0.0)
    goal: tuple[float, float] = (2.0, 10.0)
    noise: float = 0.0
    hidden_noise: float = 0.0
    log_noise: float = 0.0
    quantum: float = 0.0
    log_quantum: float = 0.0
    jitter_s: float = 0.0005
    teleports: Mapping[int, Vector] | None = None
    cut_s: float = 60.0
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Log:
    """What a controller logged, and every pose of the plant.

    Attributes:
        truth: What made it.
        rows: One per sample, in the order of `LISTS`.
        read: Tick of the pose that each sample read.
        answered: Tick at which it was answered.
        poses: Of every tick, as published.
        taken: Tick in which the plant took the command of a sample, by the sample's number.
        burst: Poses that were answered at once after the pause.
        held: Turn rate in the last tick of the pause.
        losses: Tick of each command that was pushed out of a queue, or superseded.
        reason: Why the run ended.
    """

    truth: Truth
    rows: list[tuple[Any, ...]]
    read: list[int]
    answered: list[int]
    poses: list[Vector]
    taken: dict[int, int]
    burst: int = 0
    held: float | None = None
    losses: tuple[int, ...] = ()
    reason: str = "cut"

    def to_text(self) -> str:
        """Return the log in the paper's JSON layout, with the goal and no other parameter."""
        data = dict(zip(LISTS, map(list, zip(*self.rows, strict=True)), strict=True))
        goal = dict(zip("xy", self.truth.goal, strict=True))
        return json.dumps({"metadata": {"target_position": goal}, "data": data})

    def to_run(self) -> Run:
        """Return the log as it is imported."""
        return parse_paper_json(self.to_text(), Path("truth.json"), sort=False)

    def to_recording(self) -> Run:
        """Return it with a pose per tick and simulated time, as a recording without a scenario."""
        run, ticks = self.to_run(), np.arange(len(self.poses)) * 16_000_000
        poses = np.array(self.poses)
        samples = {name: getattr(run.samples, name).copy() for name in SampleColumns.__slots__
                   if getattr(run.samples, name) is not None}  # fmt: skip
        time_ns = np.array(self.answered) * 16_000_000
        held = time_ns.copy()
        ended = np.flatnonzero(np.diff(run.samples.phase) == 2)
        held[ended] += self.truth.pause * 16_000_000
        samples |= {"time_ns": time_ns, "pose_sequence": np.array(self.read)}
        return replace(
            run,
            poses=PoseColumns(time_ns=ticks, xy_m=poses[:, :2].copy(), heading_rad=poses[:, 2]),
            commands=CommandColumns(
                time_ns=held,
                speed_m_s=run.commands.speed_m_s.copy(),
                lateral_speed_m_s=np.zeros(len(time_ns)),
                turn_rate_rad_s=run.commands.turn_rate_rad_s.copy(),
            ),
            samples=SampleColumns(**samples),
        )

    def drop(self, rows: Sequence[int] | range) -> "Log":
        """Return the log without some of its rows."""
        gone = {*rows}
        kept = [row for row in range(len(self.rows)) if row not in gone]
        pick: dict[str, Any] = {name: [getattr(self, name)[row] for row in kept]
                for name in ("rows", "read", "answered")}  # fmt: skip
        pick["taken"] = {row: self.taken[old] for row, old in enumerate(kept) if old in self.taken}
        return replace(self, **pick)


def make_log(truth: Truth) -> Log:
    """Drive one run."""
    rng, blurring, hiding = np.random.default_rng(truth.seed).spawn(3)
    plant, law = _Plant(truth), _Law(truth)
    waiting: deque[tuple[int, Vector]] = deque(maxlen=truth.pose_queue)
    log = Log(truth=truth, rows=[], read=[], answered=[], poses=[], taken=plant.taken)
    held: list[tuple[int, float, float]] = []
    free_at, clock, poses = -1, -1.0, 0
    for tick in count():
        pose = plant.step(tick, rng)
        log.poses.append(pose)
        if tick % truth.period == 0:
            waiting.append((tick, pose))
            poses += 1
        if tick == free_at:
            log = replace(log, burst=len(waiting), held=plant.turn)
            plant.send(tick, held.pop())
        while poses >= truth.backlog and tick >= free_at and waiting and not law.reason:
            number, pose = waiting.popleft()
            clock = max(
                tick * 0.016 + rng.uniform(-truth.jitter_s, truth.jitter_s),
                clock + rng.uniform(0.0011, 0.0015),
            )
            row, pauses = law.answer(clock, _misread(pose, truth, hiding))
            log.rows.append((clock, *_blur(pose, truth, blurring), *row))
            log.read.append(number)
            log.answered.append(tick)
            if pauses and truth.pause:
                free_at = tick + truth.pause
                held.append((len(log.rows) - 1, row[5], row[6]))
            else:
                plant.send(tick, (len(log.rows) - 1, row[5], row[6]))
        if law.reason or (tick + 1) * 0.016 > truth.cut_s:
            return replace(log, reason=law.reason or "cut", losses=tuple(plant.losses))
    raise AssertionError


class _Plant:
    """Turtlesim, with the queue before it and what blurs its poses behind it."""

    def __init__(self, truth: Truth) -> None:
        self.truth = truth
        self.x, y, self.heading = truth.start
        self.down = SIZE - y
        self.speed = self.turn = 0.0
        self.idle = 0
        self.losses: list[int] = []
        self.queue: deque[tuple[int, tuple[int, float, float]]] = deque()
        self.taken: dict[int, int] = {}

    def send(self, tick: int, command: tuple[int, float, float]) -> None:
        self.queue.append((tick + self.truth.delay + 1, command))

    def step(self, tick: int, rng: np.random.Generator) -> Vector:
        """Return the pose that the controller gets of this tick."""
        self.take(tick)
        if self.truth.teleports and tick in self.truth.teleports:
            self.x, y, self.heading = np.array(self.truth.teleports[tick], np.float32).tolist()
            self.down = float(np.float32(SIZE - y))
        self.heading += self.turn * 0.016
        self.heading -= 2.0 * PI * math.floor((self.heading + PI) / (2.0 * PI))
        self.x += math.cos(self.heading) * self.speed * 0.016
        self.down -= math.sin(self.heading) * self.speed * 0.016
        self.x, self.down = min(max(self.x, 0.0), SIZE), min(max(self.down, 0.0), SIZE)
        x, y, heading = self.x, SIZE - self.down, self.heading
        if self.truth.noise:
            x, y, heading = (float(v + rng.normal(0.0, self.truth.noise)) for v in (x, y, heading))
        x, y, heading = (_round(value, self.truth.quantum) for value in (x, y, heading))
        heading = _wrap(heading)
        return float(np.float32(x)), float(np.float32(y)), float(np.float32(heading))

    def take(self, tick: int) -> None:
        arrived = sum(due <= tick for due, _ in self.queue)
        while arrived > (1 if self.truth.newest else self.truth.command_queue):
            self.queue.popleft()
            arrived -= 1
            self.losses.append(tick)
        self.idle += 1
        if arrived:
            _, (sample, self.speed, self.turn) = self.queue.popleft()
            self.taken[sample] = tick
            self.idle = 0
        if self.idle >= 63:
            self.speed = self.turn = 0.0


def _misread(pose: Vector, truth: Truth, rng: np.random.Generator) -> Vector:
    if not truth.hidden_noise:
        return pose
    x, y, heading = (value + rng.normal(0.0, truth.hidden_noise) for value in pose)
    return float(np.float32(x)), float(np.float32(y)), float(np.float32(_wrap(heading)))


def _blur(pose: Vector, truth: Truth, rng: np.random.Generator) -> Vector:
    if truth.log_noise:
        pose = tuple(value + rng.normal(0.0, truth.log_noise) for value in pose)  # type: ignore[assignment]
    x, y, heading = (_round(value, truth.log_quantum) for value in pose)
    return x, y, _wrap(heading)


def _wrap(heading: float) -> float:
    """Return a heading that noise has moved, between -PI and PI again."""
    return heading - 2.0 * PI * round(heading / (2.0 * PI)) if abs(heading) > PI else heading


def _round(value: float, quantum: float) -> float:
    return round(value / quantum) * quantum if quantum else value


class _Law:
    """The controller: one row of the log per pose, and whether it pauses before publishing."""

    def __init__(self, truth: Truth) -> None:
        self.truth = truth
        self.state = ""
        self.bearing = self.error = self.sum = self.last = 0.0
        self.world = (0.0, 0.0)
        self.first_s = 0.0
        self.close_since: float | None = None
        self.still = 0
        self.reason = ""

    def answer(self, clock: float, pose: Vector) -> tuple[tuple[Any, ...], bool]:
        truth, (x, y, heading) = self.truth, pose
        ex, ey = truth.goal[0] - x, truth.goal[1] - y
        speed = turn = 0.0
        pauses = False
        if not self.state:
            self.state, self.first_s = "ROTACIONAR", clock
            self.bearing = math.atan2(ey, ex)
        elif self.state == "ROTACIONAR":
            self.error = self.bearing - heading
            if truth.wrap and not -math.pi <= self.error < math.pi:
                self.error -= math.copysign(2.0 * math.pi, self.error)
            if abs(self.error) > truth.heading_tolerance:
                turn = _clip(self.shape(self.error, truth.kp_angular), truth.turn_limit)
            else:
                self.state, pauses, self.sum = "TRANSLADAR", True, 0.0
        else:
            speed = self.translate(clock, ex, ey, heading)
        row = (self.bearing, self.error, ex, ey, math.hypot(ex, ey), speed, turn, *self.world)
        return (*row, self.state), pauses

    def translate(self, clock: float, ex: float, ey: float, heading: float) -> float:
        truth = self.truth
        if abs(ex) <= truth.position_tolerance and abs(ey) <= truth.position_tolerance:
            self.state, self.reason = "FINALIZADO", "within_tolerance"
            return 0.0
        along = heading if truth.on_heading else self.bearing
        self.world = (truth.kp_linear * ex, truth.kp_linear * ey)
        wanted = self.world[0] * math.cos(along) + self.world[1] * math.sin(along)
        if truth.law == "cubic":
            wanted = truth.kp_linear * math.hypot(ex, ey)
        elif truth.law != "p":
            wanted = self.shape(wanted / truth.kp_linear, truth.kp_linear)
        self.still = self.still + 1 if abs(wanted) < truth.standstill_below else 0
        if max(abs(ex), abs(ey)) >= truth.settled_within:
            self.close_since = None
        elif self.close_since is None:
            self.close_since = clock
        close_s = 0.0 if self.close_since is None else clock - self.close_since
        ended = {
            "standstill": self.still > truth.standstill_samples,
            "settled": close_s > truth.settled_for_s,
            "timeout": clock - self.first_s > truth.timeout_s,
        }
        if any(ended.values()):
            self.state, self.reason = "FINALIZADO", max(ended, key=lambda name: ended[name])
        return _clip(wanted, truth.speed_limit)

    def shape(self, error: float, gain: float) -> float:
        if self.truth.law == "pid":
            self.sum += error * 0.016
            slope, self.last = (error - self.last) / 0.016, error
            return gain * error + 0.3 * self.sum + 0.05 * slope
        if self.truth.law == "cubic":
            return gain * error**3 + 0.2 * math.copysign(1.0, error)
        if self.truth.law == "bang":
            return math.copysign(0.4, error)
        return gain * error


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
