"""The answer of `turtlelog explain` for a run without samples: facts about its motion."""

from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Final

from turtlelog.cli.output import fill_lines
from turtlelog.cli.replay_answer import tell_time
from turtlelog.cli.replay_plant import PlantReplayAnswer, build_plant, judge_rounding, list_breaks
from turtlelog.display import describe_count, join_words
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.explain import Delays, Largest, MotionFacts, Periods

_NEEDS: Final = (
    "An explanation needs the samples of the controller (turtlelog_msgs/msg/ControlSample): the"
    " pose that it read, and the command that it gave."
)

_SILENCE: Final = 1.5
"""Silence, in usual periods, from which a silence is shown; one period may vary by half."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RateAnswer:
    """Rate of rows, the range of the central 90 % of the periods, and the longest silence."""

    rows: int
    period_s: float | None = None
    low_s: float | None = None
    high_s: float | None = None
    longest_silence_s: float | None = None
    silence_at_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueAnswer:
    """A value of a signal with its time."""

    signal: str
    unit: str
    value: float
    at_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LeapAnswer:
    """A jump of the poses [m, rad]."""

    at_s: float
    moved: float
    aside: float
    turned: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SilenceAnswer:
    """A gap in the poses."""

    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TicksAnswer:
    """Number of commands that act after a number of ticks."""

    ticks: int
    commands: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DelaysAnswer:
    """Delays with which commands act."""

    ticks: list[TicksAnswer]
    low_s: float
    median_s: float
    high_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionAnswer:
    """Facts about poses and commands without samples. Times count as in a replay.

    Attributes:
        kind: Kind of the recorded robot.
        run_duration_s: Duration of the run [s].
        poses: Rate of the poses.
        commands: Rate of the commands.
        largest_commands: Largest command of each axis.
        outliers: Values that do not belong to the motion.
        jumps: Jumps of the poses.
        gaps: Gaps in the poses.
        command_delays: Delays with which commands act; None if unknown.
        replay: The commands driven through the plant; None without a model.
        needs: Data that an explanation would need.
    """

    kind: str
    run_duration_s: float
    poses: RateAnswer
    commands: RateAnswer
    largest_commands: list[ValueAnswer]
    outliers: list[ValueAnswer]
    jumps: list[LeapAnswer]
    gaps: list[SilenceAnswer]
    command_delays: DelaysAnswer | None
    replay: PlantReplayAnswer | None
    needs: str


def build_motion(file: Path, run: "Run", found: "MotionFacts") -> MotionAnswer:
    """Return the facts as an answer."""

    def build_rate(rows: int, periods: "Periods | None") -> RateAnswer:
        if periods is None:
            return RateAnswer(rows=rows)
        return RateAnswer(
            rows=rows,
            period_s=periods.usual_ns / 1e9,
            low_s=periods.low_ns / 1e9,
            high_s=periods.high_ns / 1e9,
            longest_silence_s=periods.longest_ns / 1e9,
            silence_at_s=tell_time(run, periods.longest_at_ns),
        )

    delays, replay = found.delays, found.replay
    largest, outliers = (
        [
            ValueAnswer(
                signal=one.signal, unit=one.unit, value=one.value, at_s=tell_time(run, one.time_ns)
            )
            for one in values
        ]
        for values in (found.largest, found.outliers)
    )
    return MotionAnswer(
        kind=found.kind,
        run_duration_s=run.duration_s,
        poses=build_rate(len(run.poses), found.poses),
        commands=build_rate(len(run.commands), found.commands),
        largest_commands=largest,
        outliers=outliers,
        jumps=[
            LeapAnswer(
                at_s=tell_time(run, jump.time_ns),
                moved=jump.moved_m,
                aside=jump.aside_m,
                turned=jump.turned_rad,
            )
            for jump in found.jumps
        ],
        gaps=[
            SilenceAnswer(start_s=tell_time(run, gap.start_ns), end_s=tell_time(run, gap.end_ns))
            for gap in found.gaps
        ],
        command_delays=None
        if delays is None
        else DelaysAnswer(
            ticks=[TicksAnswer(ticks=ticks, commands=n) for ticks, n in delays.counts.items()],
            low_s=delays.low_ns / 1e9,
            median_s=delays.median_ns / 1e9,
            high_s=delays.high_ns / 1e9,
        ),
        replay=None if replay is None else build_plant(file, run, replay),
        needs=_NEEDS,
    )


def format_motion(file: Path, run: "Run", found: "MotionFacts") -> str:
    """Return that no cause is known, and the facts as sentences."""
    name = escape_controls(file.name)
    sentences = [
        f"{name}: not explained, because there are no samples of a controller.",
        _tell_kind(run, found),
        _tell_rate(run, "pose", len(run.poses), found.poses),
        _tell_rate(run, "command", len(run.commands), found.commands),
        _tell_largest(run, found.largest),
        *_tell_outliers(run, found),
        *_tell_breaks(run, found),
        *_tell_plant(run, found),
    ]
    if found.replay is not None:
        sentences += [f"At {line}." for line in list_breaks(run, found.replay)]
    return fill_lines([*filter(None, sentences), "", _NEEDS])


def _tell_kind(run: "Run", found: "MotionFacts") -> str:
    topics = [run.notes.get(f"{kind}_topic", "") for kind in ("pose", "command")]
    where = join_words([escape_controls(topic) for topic in topics if topic])
    kind = "turtlesim" if found.kind == "turtlesim" else "a robot, not turtlesim"
    if found.kind == "robot" and run.poses.speed_m_s is not None and not run.parameters:
        kind = "a robot that publishes poses as turtlesim does, not turtlesim"
    length = f"run.duration {run.duration_s:.3f} s"
    return f"{kind[0].upper()}{kind[1:]}, {length}{f', of {where}' if where else ''}."


def _tell_rate(run: "Run", noun: str, rows: int, periods: "Periods | None") -> str:
    if periods is None:
        return f"{describe_count(rows, noun)}." if rows else f"No {noun}s."
    usual, low, high = (
        f"{period_ns / 1e6:.4g}"
        for period_ns in (periods.usual_ns, periods.low_ns, periods.high_ns)
    )
    text = f"{describe_count(rows, noun)}, usually one every {usual} ms"
    if low != high:
        text += f"; nine of ten within {low} to {high} ms"
    if periods.longest_ns > _SILENCE * periods.usual_ns:
        at_s = tell_time(run, periods.longest_at_ns)
        text += f"; the longest silence {periods.longest_ns / 1e9:.4g} s, from {at_s:.3f} s"
    return f"{text}."


def _tell_largest(run: "Run", found: "tuple[Largest, ...]") -> str:
    parts = [
        f"{largest.signal.replace('_', ' ')} {largest.value:.4g} {largest.unit}"
        f" at {round(tell_time(run, largest.time_ns), 3) + 0.0:.3f} s"
        for largest in found
    ]
    return f"Largest commands: {', '.join(parts)}." if parts else ""


def _tell_outliers(run: "Run", found: "MotionFacts") -> list[str]:
    from turtlelog.measure import describe_outliers

    if not found.outliers:
        return []
    return [
        f"The {signal.replace('_', ' ')} has {text}."
        for signal, text in describe_outliers(run).items()
    ]


def _tell_breaks(run: "Run", found: "MotionFacts") -> list[str]:
    """Return sentences on impossible steps and on missing poses."""
    from turtlelog.measure.breaks import describe_breaks

    if found.replay is not None:
        return []
    return [f"{text[0].upper()}{text[1:]}." for text in describe_breaks(run).values()]


def _tell_plant(run: "Run", found: "MotionFacts") -> list[str]:
    replay, delays = found.replay, found.delays
    if found.refused:
        return [f"Turtlesim's plant was not driven. {found.refused}."]
    if replay is None or not len(run.commands):
        return []
    use, error = replay.commands, replay.max_abs_error
    off = f"x {error.x_m:.3g} m, y {error.y_m:.3g} m, heading {degrees(error.heading_rad):.3g} deg"
    sentences = [
        f"Its commands through turtlesim's plant: {use.taken} taken, {use.unseen} that no pose"
        f" shows; it stopped by itself {use.stops} times. Largest differences {off}.",
        " ".join(judge_rounding(replay)),
    ]
    if use.unexplained_ticks:
        count = describe_count(use.unexplained_ticks, "tick")
        sentences.append(f"No recorded command explains the velocity of {count}.")
    if delays is not None:
        sentences.append(_tell_delays(delays))
    return sentences


def _tell_delays(found: "Delays") -> str:
    counts = [
        f"{count} in the next tick"
        if ticks == 0
        else f"{count} {describe_count(ticks, 'tick')} later"
        for ticks, count in found.counts.items()
    ]
    times = [f"{value / 1e6:.4g}" for value in (found.low_ns, found.median_ns, found.high_ns)]
    total = describe_count(sum(found.counts.values()), "command")
    low, median, high = times
    return (
        f"Dead time of the {total} that a pose shows: {join_words(counts)}. The pose comes {low} to"
        f" {high} ms after the command, usually {median} ms, by the recording's clock."
    )
