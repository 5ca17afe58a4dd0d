"""The answer of `turtlelog explain` for a recording without samples of a controller."""

import textwrap
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from turtlelog.cli.replay_plant import describe_plant, judge_rounding, list_breaks
from turtlelog.display import describe_count, join_words
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.explain import Delays, Largest, MotionFacts, Periods

_WIDTH: Final = 80
"""Of lines [characters]."""

_NEEDS: Final = (
    "An explanation needs the samples of the controller (turtlelog_msgs/msg/ControlSample): the"
    " pose that it read, and the command that it gave."
)

_SILENCE: Final = 1.5
"""Of the usual period: what is no longer is no silence, as half a row is missing at most."""


def describe_motion(run: "Run", found: "MotionFacts") -> dict[str, Any]:
    """Return the facts as the JSON answer has them; times count as in a replay."""

    def tell_s(time_ns: float) -> float:
        return time_ns / 1e9

    def tell_rate(rows: int, periods: "Periods | None") -> dict[str, Any]:
        keys = ("period_s", "low_s", "high_s", "longest_silence_s", "silence_at_s")
        if periods is None:
            return {"rows": rows, **dict.fromkeys(keys)}
        times_ns = (periods.usual_ns, periods.low_ns, periods.high_ns, periods.longest_ns)
        values = [*map(tell_s, times_ns), tell_s(periods.longest_at_ns - run.start_ns)]
        return {"rows": rows, **dict(zip(keys, values, strict=True))}

    delays, replay = found.delays, found.replay
    return {
        "kind": found.kind,
        "run_duration_s": run.duration_s,
        "poses": tell_rate(len(run.poses), found.poses),
        "commands": tell_rate(len(run.commands), found.commands),
        "largest_commands": [
            {
                "signal": largest.signal,
                "unit": largest.unit,
                "value": largest.value,
                "at_s": tell_s(largest.time_ns - run.start_ns),
            }
            for largest in found.largest
        ],
        "outliers": [
            {
                "signal": outlier.signal,
                "unit": outlier.unit,
                "value": outlier.value,
                "at_s": tell_s(outlier.time_ns - run.start_ns),
            }
            for outlier in found.outliers
        ],
        "jumps": [
            {
                "at_s": tell_s(jump.time_ns - run.start_ns),
                "moved": jump.moved_m,
                "aside": jump.aside_m,
                "turned": jump.turned_rad,
            }
            for jump in found.jumps
        ],
        "gaps": [
            {
                "start_s": tell_s(gap.start_ns - run.start_ns),
                "end_s": tell_s(gap.end_ns - run.start_ns),
            }
            for gap in found.gaps
        ],
        "command_delays": None
        if delays is None
        else {
            "ticks": [{"ticks": ticks, "commands": n} for ticks, n in delays.counts.items()],
            "low_s": tell_s(delays.low_ns),
            "median_s": tell_s(delays.median_ns),
            "high_s": tell_s(delays.high_ns),
        },
        "replay": None if replay is None else describe_plant(run, replay),
        "needs": _NEEDS,
    }


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
    # A name of a million letters would be broken in a time that grows with its square.
    lines = [
        textwrap.fill(line, _WIDTH, break_on_hyphens=False, break_long_words=False)
        for line in sentences
        if line
    ]
    return "\n".join([*lines, "", textwrap.fill(_NEEDS, _WIDTH, break_on_hyphens=False)])


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
        at_s = (periods.longest_at_ns - run.start_ns) / 1e9
        text += f"; the longest silence {periods.longest_ns / 1e9:.4g} s, from {at_s:.3f} s"
    return f"{text}."


def _tell_largest(run: "Run", found: "tuple[Largest, ...]") -> str:
    parts = [
        f"{largest.signal.replace('_', ' ')} {largest.value:.4g} {largest.unit}"
        f" at {round((largest.time_ns - run.start_ns) / 1e9, 3) + 0.0:.3f} s"
        for largest in found
    ]
    return f"Largest commands: {', '.join(parts)}." if parts else ""


def _tell_outliers(run: "Run", found: "MotionFacts") -> list[str]:
    from turtlelog.measure import describe_outliers

    if not found.outliers:
        return []
    return [
        f"The {signal.replace('_', ' ')} holds {text}."
        for signal, text in describe_outliers(run).items()
    ]


def _tell_breaks(run: "Run", found: "MotionFacts") -> list[str]:
    """Return what no robot can have driven, and where poses are missing, in words."""
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
