"""Answers of replays as data, and the text of replays through the plant."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from math import degrees
from pathlib import Path
from typing import Any, Final

import turtlelog as tl
from turtlelog.cli.console import build_table, copy_fields, fill_lines, fit_table
from turtlelog.escapes import escape_controls


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferenceAnswer:
    """First difference of a replay; the time counts from the first sample [s]."""

    signal: str
    time_s: float
    recorded: Any
    replayed: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseAnswer:
    """A pose, or its largest differences [m, rad]; null if poses were given, not computed."""

    x: float | None = None
    y: float | None = None
    heading: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalAnswer:
    """Difference of a signal: number of different rows, largest and first difference."""

    signal: str
    unit: str
    rows: int
    differing: int
    largest: float
    at_s: float | None
    first_difference: DifferenceAnswer | None


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


@dataclass(frozen=True, slots=True, kw_only=True)
class CountAnswer:
    """Numbers of rows, or stop reasons, in the recording and in the replay."""

    recorded: Any
    replayed: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayAnswer:
    """Common part of the answers of replays.

    Attributes:
        file: Name of the file as given.
        name: Name of the run.
        mode: Kind of the replay: loop, law or plant.
        samples: Number of compared samples.
        max_abs_error: Largest differences of the pose.
        first_difference: First difference of the replay; None if nothing differs.
        stretches: Segments of a replay through the plant.
        jumps: Jumps of the robot to another place.
        gaps: Gaps in the poses.
        verdict: Verdict of --expect-equal.
        results: Results of --expect-equal.
    """

    file: str
    name: str
    mode: str
    samples: int
    max_abs_error: PoseAnswer
    first_difference: DifferenceAnswer | None
    stretches: "tuple[SegmentAnswer, ...]" = ()
    jumps: "tuple[JumpAnswer, ...]" = ()
    gaps: "tuple[GapAnswer, ...]" = ()
    verdict: str | None = None
    results: "Sequence[tl.check.CheckResult] | None" = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentAnswer:
    """A segment of poses through which the plant was driven [s, ticks, m, rad]."""

    start_s: float
    end_s: float
    ticks: int
    max_abs_error: PoseAnswer
    rounding: "RoundingAnswer"
    within_rounding: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundingAnswer:
    """Largest error from the 32-bit rounding of poses [m, rad]."""

    position: float
    heading: float


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpAnswer:
    """A jump of the robot to another place."""

    at_s: float
    kind: str
    from_pose: PoseAnswer
    to_pose: PoseAnswer


@dataclass(frozen=True, slots=True, kw_only=True)
class GapAnswer:
    """A gap in the poses."""

    start_s: float
    end_s: float
    missing_ticks: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LawReplayAnswer(ReplayAnswer):
    """Response of a law to the recorded poses."""

    law: str
    first_command_difference: DifferenceAnswer | None
    signals: list[SignalAnswer]
    commands: DifferenceAnswer | None
    stop: DifferenceAnswer | None
    declaration: DifferenceAnswer | None
    missing_samples: int
    not_compared: tuple[str, ...]
    software: "tuple[tl.run.SoftwareChange, ...]"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopReplayAnswer(ReplayAnswer):
    """Replay of a scenario that was simulated again."""

    replay: str
    by: str
    signals: list[SignalAnswer]
    counts: Mapping[str, CountAnswer]
    stop_reason: CountAnswer
    declaration: DifferenceAnswer | None
    not_compared: tuple[str, ...]
    output: str | None
    metrics: list[MetricChange]
    software: "tuple[tl.run.SoftwareChange, ...]"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantReplayAnswer(ReplayAnswer):
    """The recorded commands driven through the plant."""

    within_rounding: bool
    heading_bits: int | None
    commands: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReplayAnswer:
    """Motion of a plant that recorded commands drive.

    Attributes:
        file: Name of the file as given.
        name: Name of the run.
        mode: commands.
        plant: Plant that was driven: turtlesim, or lagged, a robot model.
        commands: Number of recorded commands.
        taken: Number of commands that the plant took.
        duration_s: Time for which the plant was simulated [s].
        path_length_m: Length of the plant's path [m].
        end: Last pose of the plant [m, rad].
        wall_s: Time at which the plant met a wall of its world, from the first command [s]; None:
            never.
        output: Written recording.
    """

    file: str
    name: str
    mode: str = "commands"
    plant: str
    commands: int
    taken: int
    duration_s: float
    path_length_m: float
    end: PoseAnswer
    wall_s: float | None
    output: str | None


def build_difference(
    run: "tl.Run", found: "tl.replay.Difference | None"
) -> DifferenceAnswer | None:
    """Return a difference for an answer, with its time from the first sample."""
    if found is None:
        return None
    return copy_fields(DifferenceAnswer, found, time_s=tell_time(run, found.time_ns))


def build_pose_error(error: "tl.replay.PoseError") -> PoseAnswer:
    """Return the largest differences of a pose for an answer."""
    return PoseAnswer(x=error.x_m, y=error.y_m, heading=error.heading_rad)


def answer_law_replay(file: Path, run: "tl.Run", found: "tl.replay.LawReplay") -> LawReplayAnswer:
    """Return the answer of a replay through a law."""
    return LawReplayAnswer(
        **_list_shared(file, run, found),
        mode="law",
        max_abs_error=PoseAnswer(),  # the law was given the poses
        law=found.scenario.law.kind,
        first_command_difference=build_difference(run, found.first_command_difference),
        commands=build_difference(run, found.commands),
        stop=build_difference(run, found.stop),
        missing_samples=found.missing_samples,
    )


def build_loop(
    file: Path, run: "tl.Run", found: "tl.replay.LoopReplay", output: Path | None
) -> LoopReplayAnswer:
    """Return the answer of a replay in closed loop."""
    return LoopReplayAnswer(
        **_list_shared(file, run, found),
        mode="loop",
        max_abs_error=build_pose_error(found.max_abs_error),
        replay=found.run.name,
        by="tick" if found.by_tick else "sample",
        counts={name: copy_fields(CountAnswer, count) for name, count in found.counts.items()},
        stop_reason=CountAnswer(recorded=run.stop_reason, replayed=found.run.stop_reason),
        output=None if output is None else str(output),
        metrics=[*_build_changes(run, found.run)],
    )


def _list_shared(
    file: Path, run: "tl.Run", found: "tl.replay.LawReplay | tl.replay.LoopReplay"
) -> dict[str, Any]:
    """Return the fields that replays through a law and in closed loop share."""
    return {
        "file": str(file),
        "name": found.name,
        "samples": found.samples,
        "first_difference": build_difference(run, found.first_difference),
        "signals": _build_signals(run, found.signals),
        "declaration": build_difference(run, found.declaration),
        "not_compared": tuple(found.absent),
        "software": _compare_software(run, found),
    }


def _compare_software(
    run: "tl.Run", found: "tl.replay.LawReplay | tl.replay.LoopReplay"
) -> "tuple[tl.run.SoftwareChange, ...]":
    if isinstance(found, tl.replay.LoopReplay):
        replayed = found.run.simulated_by
    else:
        replayed = tl.simulate.find_software(found.scenario.law.kind)
    return tl.run.list_software_changes(run.simulated_by, replayed)


_OF_LOOP: Final = frozenset({"overshoot", "settling_time", "rms_error"})
_OF_RUN: Final = (
    *("final.heading_error", "final.position_error", "run.duration"),
    *("run.speed_effort", "run.turn_rate_effort"),  # essential without a goal
)
_RANKS: Final = {"final": 0, "run": 2}
"""Order of metrics: the end, then each loop, then the whole run."""


def _build_changes(recorded: "tl.Run", replayed: "tl.Run") -> Iterator[MetricChange]:
    """Yield the essential metrics of both runs. Missing metrics have a status."""
    essential = tl.measure.list_essential_metrics(recorded.declaration, replayed.declaration)
    names = [one for one in essential if one in _OF_RUN or one.rpartition(".")[2] in _OF_LOOP]
    was, now = (tl.measure_run(run, only=names) for run in (recorded, replayed))
    for name in sorted({**was, **now}, key=lambda name: _RANKS.get(name.partition(".")[0], 1)):
        first, second = was[name], now[name]
        was_value, is_value = first.value, second.value
        changed = None if was_value is None or is_value is None else is_value - was_value
        yield MetricChange(
            id=name,
            unit=first.unit,
            recorded=first.value,
            recorded_status=first.status,
            replayed=second.value,
            replayed_status=second.status,
            difference=changed,
        )


def _build_signals(
    run: "tl.Run", signals: "Iterable[tl.replay.SignalDifference]"
) -> list[SignalAnswer]:
    return [
        copy_fields(
            SignalAnswer,
            found,
            at_s=None if found.at_ns is None else tell_time(run, found.at_ns),
            first_difference=build_difference(run, found.first_difference),
        )
        for found in signals
    ]


def tell_time(run: "tl.Run", time_ns: int) -> float:
    """Return a time of a run from its first sample [s]."""
    return (time_ns - run.start_ns) / 1e9


def build_plant(file: Path, run: "tl.Run", found: "tl.replay.PlantReplay") -> PlantReplayAnswer:
    """Return the answer of a replay through the plant."""
    at_s = partial(tell_time, run)
    return PlantReplayAnswer(
        file=str(file),
        name=found.name,
        mode="plant",
        samples=found.samples,
        max_abs_error=build_pose_error(found.max_abs_error),
        first_difference=build_difference(run, found.first_difference),
        within_rounding=found.within_rounding,
        heading_bits=found.heading_bits,
        stretches=tuple(
            copy_fields(
                SegmentAnswer,
                one,
                start_s=at_s(one.start_ns),
                end_s=at_s(one.end_ns),
                max_abs_error=build_pose_error(one.max_abs_error),
                rounding=RoundingAnswer(position=one.rounding_m, heading=one.rounding_rad),
            )
            for one in found.stretches
        ),
        jumps=tuple(
            JumpAnswer(
                at_s=at_s(one.at_ns),
                kind=one.kind,
                from_pose=_build_pose(one.from_pose),
                to_pose=_build_pose(one.to_pose),
            )
            for one in found.jumps
        ),
        gaps=tuple(
            copy_fields(GapAnswer, one, start_s=at_s(one.start_ns), end_s=at_s(one.end_ns))
            for one in found.gaps
        ),
        commands=asdict(found.commands),
    )


def _build_pose(pose: "Sequence[float]") -> PoseAnswer:
    return PoseAnswer(x=pose[0], y=pose[1], heading=pose[2])


def format_plant(file: Path, run: "tl.Run", found: "tl.replay.PlantReplay") -> str:
    """Return whether the plant reproduces the poses, with its segments and their breaks."""
    use = found.commands
    stops = f"; the plant stopped by itself {use.stops} times" if use.stops else ""
    rounding = "one step of the 32 bits of a pose, for other platforms"
    if tl.plants.find_plant(run) == tl.plants.TURTLESIM:
        unsigned = ", and of velocities used as recorded, without a sign,"
        first_pose = "the 32 bits of a segment's first pose" + unsigned * (
            use.unexplained_ticks > 0
        )
        rounding = f"the largest error that {first_pose} can cause"
    first, *judged = judge_rounding(found)
    sentences = [
        f"{escape_controls(file.name)}: {first[0].lower()}{first[1:]}",
        *judged,
        f"Commands: {use.taken} taken, {use.unseen} that no pose shows{stops}.",
        f"Rounding: {rounding}.",
    ]
    if use.never_arrived:
        sentences.append(
            f"The transport lost {use.never_arrived} commands, as the events show: one that equals"
            " the command before it counts as taken."
        )
    if use.disturbed_ticks:
        sentences.append(
            f"In {use.disturbed_ticks} ticks a disturbance acts on the plant: its velocity shows no"
            " command there, and was used as recorded."
        )
    if unexplained := use.unexplained_ticks - use.disturbed_ticks:
        sentences.append(
            f"No recorded command explains {unexplained} ticks: the recorded velocity was used"
            " there."
        )
    table = fit_table(_tabulate_segments(run, found))
    return "\n".join([fill_lines(sentences), "", table, *list_breaks(run, found)]).rstrip()


def _tabulate_segments(run: "tl.Run", found: "tl.replay.PlantReplay") -> "tl.compare.Table":
    start, end = (tl.compare.Column(title=title, unit="s", digits=3) for title in ("from", "to"))
    ways = ("x [m]", "y [m]", "heading [deg]", "rounding [m]", "rounding [deg]")
    rows = []
    for segment in found.stretches:
        times_s = tell_time(run, segment.start_ns), tell_time(run, segment.end_ns)
        error, rounding = segment.max_abs_error, (segment.rounding_m, degrees(segment.rounding_rad))
        errors = error.x_m, error.y_m, degrees(error.heading_rad)
        rows.append((*times_s, segment.ticks, *errors, *rounding))
    heads = (start, end, "ticks", *ways)
    return build_table(f"Largest differences between the plant and {run.name}", heads, rows)


def judge_rounding(found: "tl.replay.PlantReplay") -> list[str]:
    """Return whether rounding explains the differences, and whose arithmetic was used."""
    beyond = sum(not stretch.within_rounding for stretch in found.stretches)
    if found.of_rounding == 0.0:
        sentences = ["The plant reproduces every pose."]
    elif not beyond:
        sentences = ["The largest difference is within what 32-bit poses can tell."]
    else:
        count = len(found.stretches)
        of_all = f", in {beyond} of {count} segments" if count > 1 else ""
        times = f"{found.of_rounding:.3g} times what 32-bit poses can tell"
        sentences = [f"The largest difference is {times}{of_all}."]
    if found.heading_bits == 32:
        sentences.append("This turtlesim kept its heading in 32 bits: it is older than Humble.")
    return sentences


def list_breaks(run: "tl.Run", found: "tl.replay.PlantReplay") -> list[str]:
    """Return a line for each jump and gap, in order of time."""
    lines = []
    for jump in found.jumps:
        x_m, y_m, heading_rad = jump.to_pose
        place = f"x = {x_m:.3f} m, y = {y_m:.3f} m, heading {degrees(heading_rad):.1f} deg"
        lines.append((jump.at_ns, f"jump ({jump.kind}) to {place}"))
    for gap in found.gaps:
        length_s = (gap.end_ns - gap.start_ns) / 1e9
        lines.append((gap.start_ns, f"gap of {length_s:.3f} s: {gap.missing_ticks} ticks"))
    return [f"{tell_time(run, at_ns):.3f} s: {text}" for at_ns, text in sorted(lines)]
