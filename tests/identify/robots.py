"""Robots of known truth, that share no code with the fit: a sum of responses to single steps."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.log.ros2.bags import START_NS, Said, make_vector, write_mcap
from tests.log.ros2.robots import say_odometry, turn
from turtlelog.log.ros2.bag_rows import time_rows
from turtlelog.log.ros2.stamps import Stamps
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

Values = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """One axis: rate = gain exp(-dead_time s) / (lag s + 1) of the commands; or with two lags."""

    gain: float = 1.0
    dead_time_s: float = 0.1
    lag_s: float = 0.1
    second_lag_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Log:
    """How a robot is driven and recorded.

    Attributes:
        speed: Along the heading.
        turn_rate: Counter-clockwise.
        duration_s: Of the recording.
        poses_hz: How often it publishes a pose.
        commands_hz: How often commands are repeated.
        noise_m: Of each position.
        noise_rad: Of each heading.
        jitter_s: By how much the time of a pose is off; of stamped ones, how irregular they are.
        lost: Share of the poses that are lost.
        jumps: How often the odometry is set to another place.
        wrap_faults: Whether a heading beside the wrap is the plain mean of those on either side.
        spins: Whether it turns one way only, round and round.
        quantum: Of commands.
        command_bits: Of commands over their range; 0 for none.
        quantum_m: Of positions.
        quantum_rad: Of headings.
        hold_s: How long a command holds.
        later_s: When its clocks begin.
        is_stamped: Whether poses carry stamps and are received some time later.
        offset_s: Of the stamps' clock.
        drift: Of the same, seconds per second.
        transport_s: The least between measuring and receiving a stamped pose, and what it takes
            more on average.
    """

    speed: Truth = field(default_factory=Truth)
    turn_rate: Truth = field(default_factory=Truth)
    duration_s: float = 60.0
    poses_hz: float = 30.0
    commands_hz: float = 20.0
    noise_m: float = 2e-4
    noise_rad: float = 5e-4
    jitter_s: float = 2e-3
    lost: float = 0.0
    jumps: int = 0
    wrap_faults: bool = False
    spins: bool = False
    quantum: float = 0.0
    command_bits: int = 0
    quantum_m: float = 0.0
    quantum_rad: float = 0.0
    hold_s: tuple[float, float] = (0.5, 3.0)
    later_s: float = 0.0
    is_stamped: bool = False
    offset_s: float = 0.0
    drift: float = 0.0
    transport_s: tuple[float, float] = (1e-3, 2e-3)

    @property
    def least_transport_s(self) -> float:
        """What no log tells, and dead times hold."""
        return self.transport_s[0] if self.is_stamped else 0.0


def draw_steps(rng: np.random.Generator, log: Log, largest: float) -> tuple[Values, Values]:
    """Return times and values of commands, repeated at their rate; the robot stands first."""
    time_s = np.arange(0.5, log.duration_s - 0.5, 1.0 / log.commands_hz)
    time_s = time_s + rng.uniform(0.0, 0.3 / log.commands_hz, len(time_s))
    value, changes_s = np.zeros(len(time_s)), 1.0
    while changes_s < log.duration_s:
        value[time_s >= changes_s] = rng.uniform(-largest, largest)
        changes_s += rng.uniform(*log.hold_s)
    quantum = 2.0 * largest / (2**log.command_bits - 1) if log.command_bits else log.quantum
    return time_s, quantise(value, quantum)


def quantise(values: Values, quantum: float) -> Values:
    return np.rint(values / quantum) * quantum if quantum else values


def respond(truth: Truth, time_s: Values, changes: tuple[Values, Values]) -> tuple[Values, Values]:
    """Return rate and way at some times: of each change of the command the response to a step.

    What is left of earlier changes, which are in order, fades by one factor for all of them.
    """
    acts_s, by = changes[0] + truth.dead_time_s, changes[1]
    if not len(by):
        return np.zeros(len(time_s)), np.zeros(len(time_s))
    count = np.searchsorted(acts_s, time_s)
    since_s = np.maximum(time_s - acts_s[np.maximum(count - 1, 0)], 0.0)
    asked = np.append(0.0, np.cumsum(by))[count]
    moment = np.append(0.0, np.cumsum(by * (acts_s - acts_s[0])))[count]
    rate, way = asked, asked * (time_s - acts_s[0]) - moment
    one, other = truth.lag_s, truth.second_lag_s
    for lag_s, less_s in ((one, other), (other, one)):
        if lag_s > 0.0:
            part = lag_s / (lag_s - less_s)
            faded = sum_faded(lag_s, acts_s, by)[count] * np.exp(-since_s / lag_s)
            rate = rate - part * faded
            way = way - lag_s * (asked - part * faded)
    return truth.gain * rate, truth.gain * way


def sum_faded(lag_s: float, at_s: Values, by: Values) -> Values:
    """Return the sum of all changes before the first, and at each one of those so far, faded."""
    fading = np.exp(-np.diff(at_s, prepend=at_s[0]) / lag_s).tolist()
    left = [0.0]
    for factor, change in zip(fading, by.tolist(), strict=True):
        left.append(left[-1] * factor + change)
    return np.array(left)


def find_changes(time_s: Values, value: Values) -> tuple[Values, Values]:
    by = np.diff(value, prepend=0.0)
    rows = np.flatnonzero(by)
    return time_s[rows], by[rows]


def drive(
    log: Log, time_s: Values, speed: tuple[Values, Values], turn: tuple[Values, Values]
) -> tuple[Values, Values]:
    """Return positions and headings at some times, from the origin on."""
    speeds, turns = find_changes(*speed), find_changes(*turn)
    breaks = np.concatenate(
        [speeds[0] + log.speed.dead_time_s, turns[0] + log.turn_rate.dead_time_s]
    )
    inside = breaks[(breaks > 0.0) & (breaks < time_s[-1])]
    bounds = np.unique(np.concatenate([[0.0], time_s, inside]))
    length = np.diff(bounds)
    nodes = bounds[:-1, None] + length[:, None] * (0.5 + 0.5 * _NODES)
    rate = respond(log.speed, nodes.ravel(), speeds)[0].reshape(nodes.shape)
    heading = respond(log.turn_rate, nodes.ravel(), turns)[1].reshape(nodes.shape)
    weights = 0.5 * length[:, None] * _WEIGHTS
    steps = [(weights * rate * way(heading)).sum(axis=1) for way in (np.cos, np.sin)]
    xy_m = np.vstack([[0.0, 0.0], np.cumsum(np.column_stack(steps), axis=0)])
    rows = np.searchsorted(bounds, time_s)
    return xy_m[rows], respond(log.turn_rate, time_s, turns)[1]


def turn_with_limit(truth: Truth, log: Log, most_rad_s2: float, seed: int) -> Run:
    """Return the run of a robot on the spot whose turn rate changes no faster than a limit."""
    rng = np.random.default_rng(seed)
    time_s, turns = draw_steps(rng, log, 1.5)
    at_s, bends = find_bends(*find_changes(time_s, truth.gain * turns), most_rad_s2)
    true_s = np.arange(0.0, log.duration_s, 1.0 / log.poses_hz)
    # A ramp is the integral of a step, so is the response to it.
    since_s = np.maximum(true_s[:, None] - (at_s + truth.dead_time_s), 0.0)
    lag_s = truth.lag_s
    risen = since_s + lag_s * np.expm1(-since_s / lag_s)
    heading = (0.5 * since_s**2 - lag_s * risen) @ bends
    seen = wrap(heading + rng.normal(0.0, log.noise_rad, len(true_s)))
    xy_m = rng.normal(0.0, log.noise_m, (len(true_s), 2))
    seen_s = jitter(log, rng, true_s)
    order = np.argsort(seen_s, kind="stable")
    return build_run(seen_s[order], xy_m[order], seen[order], (time_s, 0.0 * turns, turns))


def find_bends(at_s: Values, by: Values, most: float) -> tuple[Values, Values]:
    """Return when the slope of what is commanded changes under a limit, and by how much."""
    times_s, bends, reached, wanted = [], [], 0.0, 0.0
    ends_s = np.append(at_s[1:], np.inf)
    for begin_s, end_s, change in zip(at_s.tolist(), ends_s.tolist(), by.tolist(), strict=True):
        wanted += change
        slope = float(np.sign(wanted - reached)) * most
        stop_s = min(begin_s + abs(wanted - reached) / most, end_s)
        times_s += [begin_s, stop_s]
        bends += [slope, -slope]
        reached += slope * (stop_s - begin_s)
    return np.array(times_s), np.array(bends)


def make_run(
    log: Log,
    seed: int,
    speed: tuple[Values, Values] | None = None,
    turn: tuple[Values, Values] | None = None,
    name: str = "robot",
) -> Run:
    """Return the run of a robot; commands are random steps where none are given."""
    rng = np.random.default_rng(seed)
    drawn = draw_steps(rng, log, 0.5), draw_steps(rng, log, 1.5)
    time_s, speeds = drawn[0] if speed is None else speed
    # Both axes are commanded by one message.
    turns = drawn[1][1] if turn is None else turn[1]
    turns = np.abs(turns) if log.spins else turns
    true_s = np.arange(0.0, log.duration_s, 1.0 / log.poses_hz)
    if log.is_stamped:
        true_s = np.sort(np.maximum(true_s + rng.normal(0.0, log.jitter_s, len(true_s)), 0.0))
    xy_m, heading_rad = drive(log, true_s, (time_s, speeds), (time_s, turns))
    xy_m = xy_m + rng.normal(0.0, log.noise_m, xy_m.shape)
    heading_rad = heading_rad + rng.normal(0.0, log.noise_rad, len(true_s))
    for row in rng.integers(20, len(true_s) - 20, log.jumps):
        # Odometry goes on from where it believes to be.
        turn_rad = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.7)
        turned = np.array(
            [[np.cos(turn_rad), np.sin(turn_rad)], [-np.sin(turn_rad), np.cos(turn_rad)]]
        )
        xy_m[row:] = xy_m[row] + rng.normal(0.0, 0.1, 2) + (xy_m[row:] - xy_m[row]) @ turned
        heading_rad[row:] += turn_rad
    xy_m = quantise(xy_m, log.quantum_m)
    heading_rad = wrap(quantise(heading_rad, log.quantum_rad))
    if log.wrap_faults:
        wraps = np.flatnonzero(np.abs(np.diff(heading_rad)) > np.pi)
        heading_rad[wraps] = 0.5 * (heading_rad[wraps] + heading_rad[wraps + 1])
    kept = np.flatnonzero(rng.uniform(size=len(true_s)) >= log.lost)
    seen_s = map_stamps(log, rng, true_s) if log.is_stamped else jitter(log, rng, true_s)
    order = kept[np.argsort(seen_s[kept], kind="stable")]
    commands = time_s + log.later_s, speeds, turns
    return build_run(
        seen_s[order] + log.later_s, xy_m[order], heading_rad[order], commands, name=name
    )


def jitter(log: Log, rng: np.random.Generator, true_s: Values) -> Values:
    """Return when poses were received that have no stamps."""
    return np.maximum(true_s + rng.normal(0.0, log.jitter_s, len(true_s)), 0.0)


def map_stamps(log: Log, rng: np.random.Generator, true_s: Values) -> Values:
    """Return the times that a bag's reader gives to stamped poses, on the recorder's clock."""
    least_s, more_s = log.transport_s
    # Messages of one publisher arrive in order.
    received_s = true_s + least_s + rng.exponential(more_s, len(true_s))
    received_s = np.maximum.accumulate(received_s)
    stamp_s = log.offset_s + true_s * (1.0 + log.drift)
    received_ns, stamp_ns = (
        START_NS + np.rint(times_s * 1e9).astype(np.int64) for times_s in (received_s, stamp_s)
    )
    found = time_rows(Stamps(log_ns=received_ns, stamp_ns=stamp_ns), None, "stamp").poses
    seen_s = received_s.copy()
    seen_s[found.rows] = (found.time_ns - START_NS) / 1e9
    return np.maximum(seen_s, 0.0)


def wrap(heading_rad: Values) -> Values:
    return np.mod(heading_rad + np.pi, 2.0 * np.pi) - np.pi


def draw_log(seed: int, duration_s: float = 40.0, *, at_edge: bool = False) -> Log:
    """Return a robot of the range that is claimed; at its edge without dead time or lag."""
    rng = np.random.default_rng([seed, 20])
    noise = 10.0 ** rng.uniform(-1.0, 1.0)

    def draw_axis() -> Truth:
        gain, dead_time_s, lag_s = (
            float(rng.uniform(*ends)) for ends in ((0.5, 1.2), (0.02, 0.5), (0.02, 1.0))
        )
        if at_edge:
            dead_time_s, lag_s = (0.0, lag_s) if rng.uniform() < 0.5 else (dead_time_s, 0.0)
        return Truth(gain=gain, dead_time_s=dead_time_s, lag_s=lag_s)

    return Log(
        speed=draw_axis(),
        turn_rate=draw_axis(),
        duration_s=duration_s,
        poses_hz=float(rng.uniform(10.0, 100.0)),
        noise_m=2e-4 * noise,
        noise_rad=5e-4 * noise,
        jitter_s=float(rng.uniform(0.0, 2e-3)),
        lost=float(rng.choice([0.0, 0.05])),
        jumps=int(rng.choice([0, 3])),
        wrap_faults=bool(rng.uniform() < 0.25),
        spins=bool(rng.uniform() < 0.25),
        command_bits=int(rng.choice([0, 8])),
        quantum_m=float(rng.choice([0.0, 0.0, 1e-3])),
        quantum_rad=float(rng.choice([0.0, 0.0, 1e-3])),
        is_stamped=bool(rng.uniform() < 0.5),
        offset_s=float(rng.choice([0.0, -0.78, 3.0e4])),
        drift=float(rng.uniform(-2e-4, 2e-4)),
        later_s=float(rng.choice([0.0, 1e4])),
    )


def draw_limited(seed: int) -> tuple[Log, float]:
    """Return a robot on the spot, and the largest change of its turn rate [rad/s^2]."""
    rng = np.random.default_rng([seed, 77])
    drawn = ((0.5, 1.2), (0.02, 0.5), (0.02, 0.4))
    gain, dead_time_s, lag_s = (float(rng.uniform(*ends)) for ends in drawn)
    limit, noise = float(rng.uniform(1.0, 4.0)), 10.0 ** rng.uniform(-1.0, 1.0)
    log = Log(
        turn_rate=Truth(gain=gain, dead_time_s=dead_time_s, lag_s=lag_s),
        duration_s=30.0,
        noise_rad=5e-4 * noise,
        poses_hz=float(rng.uniform(10.0, 100.0)),
        jitter_s=float(rng.uniform(0.0, 2e-3)),
    )
    return log, limit


def draw_second_order(seed: int) -> Log:
    """Return a robot with two lags, of which neither is next to nothing."""
    rng = np.random.default_rng([seed, 78])
    log = draw_log(seed, 30.0)
    axes = []
    for axis in (log.speed, log.turn_rate):
        second_lag_s = float(axis.lag_s * rng.uniform(0.2, 0.9))
        axes.append(replace(axis, second_lag_s=second_lag_s))
    return replace(log, speed=axes[0], turn_rate=axes[1])


def build_run(
    time_s: Values,
    xy_m: Values,
    heading_rad: Values,
    commands: tuple[Values, Values, Values],
    name: str = "robot",
) -> Run:
    pose_ns = np.rint(time_s * 1e9).astype(np.int64)
    fresh = np.concatenate([[True], np.diff(pose_ns) > 0])
    whole = np.zeros(0, dtype=np.int64)
    none = np.zeros(0)
    return Run(
        name=name,
        source="test",
        poses=PoseColumns(
            time_ns=pose_ns[fresh],
            xy_m=xy_m[fresh],
            heading_rad=wrap(heading_rad[fresh]),
        ),
        commands=CommandColumns(
            time_ns=np.rint(commands[0] * 1e9).astype(np.int64),
            speed_m_s=np.asarray(commands[1], dtype=float),
            lateral_speed_m_s=np.zeros(len(commands[0])),
            turn_rate_rad_s=np.asarray(commands[2], dtype=float),
        ),
        samples=SampleColumns(
            time_ns=whole,
            sequence=whole,
            pose_sequence=whole,
            phase=whole,
            speed_m_s=none,
            turn_rate_rad_s=none,
        ),
    )


def write_bag(run: Run, path: Path) -> Path:
    """Write a run as a robot's bag: odometry without stamps, and commands."""
    said = []
    rows = zip(run.poses.time_ns.tolist(), run.poses.xy_m, run.poses.heading_rad, strict=True)
    for time_ns, (x_m, y_m), yaw_rad in rows:
        (pose,) = say_odometry(count=1, x_m=float(x_m), by=turn(float(yaw_rad)))
        pose.values["pose"]["pose"]["position"]["y"] = float(y_m)
        said.append(replace(pose, time_ns=START_NS + time_ns))
    columns = run.commands.time_ns, run.commands.speed_m_s, run.commands.turn_rate_rad_s
    for time_ns, speed, turn_rate in zip(*(column.tolist() for column in columns), strict=True):
        values = {"linear": make_vector(speed), "angular": make_vector(z=turn_rate)}
        said.append(
            Said(
                topic="/cmd_vel",
                type="geometry_msgs/msg/Twist",
                values=values,
                time_ns=START_NS + time_ns,
            )
        )
    return write_mcap(path, sorted(said, key=lambda message: message.time_ns))
