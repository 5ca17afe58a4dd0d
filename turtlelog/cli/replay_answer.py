"""Answers of replays that compare signals: through a law, and in closed loop."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.check_answers import ResultAnswer
from turtlelog.cli.output import build_table, copy_fields, fill_lines, fit_table
from turtlelog.display import describe_count, format_pair, format_short, show_angle
from turtlelog.escapes import escape_controls
from turtlelog.run.stop_reasons import find_goal_end

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.compare import Table
    from turtlelog.replay import Difference, LawReplay, LoopReplay, PoseError, SignalDifference
    from turtlelog.run import SoftwareChange


_ALWAYS: Final = ("x", "y", "heading", "speed", "turn_rate")
"""Signals that are printed even if they are equal."""


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
        verdict: Verdict of --expect-equal; None without this option.
        results: Results of --expect-equal; None without this option.
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
    results: list[ResultAnswer] | None = None


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
    software: "tuple[SoftwareChange, ...]"


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
    software: "tuple[SoftwareChange, ...]"


def build_difference(run: "Run", found: "Difference | None") -> DifferenceAnswer | None:
    """Return a difference for an answer, with its time from the first sample."""
    if found is None:
        return None
    return copy_fields(DifferenceAnswer, found, time_s=tell_time(run, found.time_ns))


def build_pose_error(error: "PoseError") -> PoseAnswer:
    """Return the largest differences of a pose for an answer."""
    return PoseAnswer(x=error.x_m, y=error.y_m, heading=error.heading_rad)


def answer_law_replay(file: Path, run: "Run", found: "LawReplay") -> LawReplayAnswer:
    """Return the answer of a replay through a law."""
    return LawReplayAnswer(
        file=str(file),
        name=found.name,
        mode="law",
        samples=found.samples,
        max_abs_error=PoseAnswer(),  # the law was given the poses
        first_difference=build_difference(run, found.first_difference),
        law=found.scenario.law.kind,
        first_command_difference=build_difference(run, found.first_command_difference),
        signals=_build_signals(run, found.signals),
        commands=build_difference(run, found.commands),
        stop=build_difference(run, found.stop),
        declaration=build_difference(run, found.declaration),
        missing_samples=found.missing_samples,
        not_compared=tuple(found.absent),
        software=_compare_software(run, found),
    )


def build_loop(
    file: Path, run: "Run", found: "LoopReplay", output: Path | None
) -> LoopReplayAnswer:
    """Return the answer of a replay in closed loop."""
    return LoopReplayAnswer(
        file=str(file),
        name=found.name,
        mode="loop",
        samples=found.samples,
        max_abs_error=build_pose_error(found.max_abs_error),
        first_difference=build_difference(run, found.first_difference),
        replay=found.run.name,
        by="tick" if found.by_tick else "sample",
        signals=_build_signals(run, found.signals),
        counts={name: copy_fields(CountAnswer, count) for name, count in found.counts.items()},
        stop_reason=CountAnswer(recorded=run.stop_reason, replayed=found.run.stop_reason),
        declaration=build_difference(run, found.declaration),
        not_compared=tuple(found.absent),
        output=None if output is None else str(output),
        metrics=_build_changes(run, found.run),
        software=_compare_software(run, found),
    )


def _compare_software(run: "Run", found: "LawReplay | LoopReplay") -> "tuple[SoftwareChange, ...]":
    if isinstance(found, tl.replay.LoopReplay):
        replayed = found.run.simulated_by
    else:
        replayed = tl.simulate.find_software(found.scenario.law.kind)
    return tl.run.list_software_changes(run.simulated_by, replayed)


def _describe_software(run: "Run", found: "LawReplay | LoopReplay") -> list[str]:
    """Return whether a run and its replay come from the same software, if the file shows this."""
    changes = _compare_software(run, found)
    if not run.simulated_by:
        return []
    if [one.name for one in changes] == [tl.run.LAW]:
        return ["The code of the law is not the recorded one."]
    if changes:
        return [f"Recorded and replayed by different software: {tl.run.describe_changes(changes)}."]
    return [f"Recorded and replayed by {tl.run.describe_software(run.simulated_by)}."]


def format_law(file: Path, run: "Run", found: "LawReplay", *, details: bool) -> str:
    """Return whether a law commands as recorded, and its first difference."""
    law, first = escape_controls(found.scenario.law.kind), found.first_difference
    if first is None:
        head = f"{law} commands what was recorded{_describe_slack(found.signals)}"
    else:
        head = f"{law} departs in {_format_difference(run, first, found.signals)}"
    lines = [f"{escape_controls(file.name)}: {head}."]
    command = found.first_command_difference
    if command is not None and command != first:
        lines.append(f"First command: {_format_difference(run, command, found.signals)}.")
    if first is not None:
        lines.append(_describe_published(found))
        others = {"Published command": found.commands, "The end": found.stop}
        lines += [
            f"{name}: {_format_difference(run, one, found.signals)}."
            for name, one in others.items()
            if one is not None and one != first
        ]
    lines += _format_declaration(found)
    is_law_kept = run.parameters.get("law.kind") == found.scenario.law.kind
    if first is not None and is_law_kept and _compare_software(run, found):
        lines += _describe_software(run, found)
    if found.missing_samples:
        lines.append(f"{found.missing_samples} samples are lost: the law did not see their poses.")
    title = f"{law} on the {found.samples} poses that {run.name} read"
    return f"{fill_lines(lines)}\n{_format_signals(run, found, title, details=details)}"


def _format_declaration(found: "LawReplay | LoopReplay") -> list[str]:
    """Return the declaration of the replayed law if another declaration was recorded."""
    told = found.declaration
    if told is None:
        return []
    recorded, replayed = (escape_controls(str(text)) for text in (told.recorded, told.replayed))
    return [f"The law declares itself otherwise. Recorded: {recorded}. Replayed: {replayed}."]


def _describe_published(found: "LawReplay") -> str:
    differing = [
        signal.signal
        for signal in found.signals
        if signal.signal.startswith("command_") and signal.differing
    ]
    if differing:
        return f"The commands as published differ from the law's in {', '.join(differing)}."
    if found.commands is not None or "command_speed" in found.absent:
        return "The commands as published are not one per sample, and are not compared."
    return "The commands as published are the law's."


def format_loop(file: Path, run: "Run", found: "LoopReplay", *, details: bool) -> str:
    """Return whether the replay equals the recording, and its first difference."""
    first, changes = found.first_difference, found.run.name.removeprefix(run.name).strip()
    name = escape_controls(file.name)
    if first is None:
        goes_on = any(count.recorded != count.replayed for count in found.counts.values())
        end = ", as far as that goes" if goes_on else ""
        end += _describe_slack(found.signals)
        columns = "every column that it holds" if found.absent else "every column"
        lines = [f"{name}: the replay equals the recording in {columns}{end}."]
    else:
        departs = f"departs in {_format_difference(run, first, found.signals)}."
        lines = [f"{name}: the replay {departs}"]
        if changes:
            # For a changed scenario, a difference is expected: its result is the answer.
            given = "with" if found.run.name.startswith(run.name) else "called"
            change = escape_controls(f"{given} {changes}")
            result = _describe_result(run, found.run)
            lines = [f"{name}: {change}, the replay {departs}"]
            if result:
                lines = [f"{name}: {change}, {result}", f"The replay {departs}"]
    lines += _format_declaration(found)
    lines += [] if first is None or changes else _describe_software(run, found)
    counts = [*_list_counts(run, found)]
    rows = "tick by tick" if found.by_tick else "sample by sample"
    title = f"{found.run.name} simulated again, against {run.name}, {rows}"
    parts = [fill_lines(lines if changes else [*lines, *counts])]
    parts += [] if first is None else [f"\n{_format_changes(run, found.run)}"]
    parts += [fill_lines(counts)] if changes and counts else []
    return "\n".join([*parts, _format_signals(run, found, title, details=details)])


def _describe_result(run: "Run", replayed: "Run") -> str:
    """Return how a replay ended beside the recording, or its most important metric."""
    first, second = find_goal_end(run), find_goal_end(replayed)
    if first is not None and second is not None:
        if (first.error_m, first.duration_s) == (second.error_m, second.duration_s):
            return f"it {second.describe()}, as recorded."
        was, now = (format_short(one.error_m, "m") for one in (first, second))
        if was == now and first.error_m != second.error_m:
            was, _ = format_pair(first.error_m, second.error_m, "m")
        after = f"after {first.duration_s:.3g} s"
        return f"it {second.describe()}, not {was} {after} as recorded."
    both = [one for one in _build_changes(run, replayed) if one.difference is not None]
    if not both:
        return ""
    was, now = format_pair(both[0].recorded, both[0].replayed, both[0].unit)
    beside = "as recorded" if both[0].difference == 0.0 else f"recorded {was}"
    return f"{both[0].id} is {now}, {beside}."


_OF_LOOP: Final = frozenset({"overshoot", "settling_time", "rms_error"})
_OF_RUN: Final = (
    *("final.heading_error", "final.position_error", "run.duration"),
    *("run.speed_effort", "run.turn_rate_effort"),  # essential without a goal
)
_RANKS: Final = {"final": 0, "run": 2}
"""Order of metrics: the end, then each loop, then the whole run."""


def _build_changes(recorded: "Run", replayed: "Run") -> list[MetricChange]:
    """Return the essential metrics of both runs. Missing metrics have a status."""
    essential = tl.measure.list_essential_metrics(recorded.declaration, replayed.declaration)
    names = [name for name in essential if name in _OF_RUN]
    names += [name for name in essential if name.rpartition(".")[2] in _OF_LOOP]
    was, now = (tl.measure_run(run, only=names) for run in (recorded, replayed))
    changes = []
    for name in sorted({**was, **now}, key=lambda name: _RANKS.get(name.partition(".")[0], 1)):
        first, second = was[name], now[name]
        change = MetricChange(
            id=name,
            unit=first.unit,
            recorded=first.value,
            recorded_status=first.status.value,
            replayed=second.value,
            replayed_status=second.status.value,
            difference=None
            if first.value is None or second.value is None
            else second.value - first.value,
        )
        changes.append(change)
    return changes


def _format_changes(recorded: "Run", replayed: "Run") -> str:
    rows = []
    for one in _build_changes(recorded, replayed):
        was = one.recorded_status if one.recorded is None else one.recorded
        now = one.replayed_status if one.replayed is None else one.replayed
        rows.append((one.id, one.unit, was, now, one.difference))
    heads = ("metric", "unit", "recorded", "replayed", "difference")
    return fit_table(build_table("Metrics of the recording and of the replay", heads, rows))


def _format_signals(
    run: "Run", found: "LawReplay | LoopReplay", title: str, *, details: bool
) -> str:
    """Return the table of signals, or the number of differing signals and how to show them."""
    if details:
        rest = fill_lines(_describe_rest(found.signals, found.absent))
        return f"\n{fit_table(_tabulate(run, found.signals, title))}\n{rest}".rstrip()
    differing = sum(signal.largest > 0.0 or signal.differing > 0 for signal in found.signals)
    return f"{differing} of {describe_count(len(found.signals), 'signal')} differ: --details"


def _build_signals(run: "Run", signals: "Iterable[SignalDifference]") -> list[SignalAnswer]:
    return [
        copy_fields(
            SignalAnswer,
            found,
            at_s=None if found.at_ns is None else tell_time(run, found.at_ns),
            first_difference=build_difference(run, found.first_difference),
        )
        for found in signals
    ]


def _tabulate(run: "Run", signals: "Sequence[SignalDifference]", title: str) -> "Table":
    rows = []
    for found in filter(_is_printed, signals):
        largest, unit = show_angle(found.largest, found.unit)
        at_s = None if found.at_ns is None else tell_time(run, found.at_ns)
        rows.append((found.signal, unit.strip("1"), largest, at_s, found.differing, found.rows))
    at = tl.compare.Column(title="at", unit="s", digits=3)
    heads = ("signal", "unit", "largest difference", at, "rows that differ", "of")
    return build_table(title, heads, rows)


def _describe_rest(signals: "Iterable[SignalDifference]", absent: Sequence[str]) -> tuple[str, ...]:
    """Return sentences on equal signals, and on missing ones."""
    equal = [found.signal for found in signals if not _is_printed(found)]
    sentences = [("Equal in every row as well", equal), ("Not in the recording", absent)]
    return tuple(f"{head}: {', '.join(names)}." for head, names in sentences if names)


def _describe_slack(signals: "Iterable[SignalDifference]") -> str:
    return ", within the tolerance" if any(found.largest > 0.0 for found in signals) else ""


def _is_printed(found: "SignalDifference") -> bool:
    return found.largest > 0.0 or found.differing > 0 or found.signal in _ALWAYS


def _list_counts(run: "Run", found: "LoopReplay") -> list[str]:
    """Return the numbers of rows, and the stop reasons, of recording and replay."""
    counts = [
        f"{count.recorded} {name}"
        if count.recorded == count.replayed
        else f"{count.recorded} {name}, replayed {count.replayed}"
        for name, count in found.counts.items()
    ]
    ends = run.stop_reason or "not recorded why", found.run.stop_reason or ""
    was, now = (end.replace("_", " ") for end in ends)
    end = f"Both ended: {was}" if was == now else f"It ended: {was}; the replay: {now}"
    return [f"Recorded: {'; '.join(counts)}.", f"{escape_controls(end)}."]


def _format_difference(
    run: "Run", found: "Difference", signals: "Sequence[SignalDifference]"
) -> str:
    unit = next((signal.unit for signal in signals if signal.signal == found.signal), "1")
    was, now = format_pair(found.recorded, found.replayed, unit)
    place = f"{found.signal.replace('_', ' ')} at {tell_time(run, found.time_ns):.3f} s"
    return f"{place}: recorded {was}, replayed {now}"


def tell_time(run: "Run", time_ns: int) -> float:
    """Return a time of a run from its first sample [s]."""
    return (time_ns - run.start_ns) / 1e9
