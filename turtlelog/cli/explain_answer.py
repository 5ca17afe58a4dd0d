"""Text of `turtlelog explain`: causes, settings with evidence, and facts about motion."""

import textwrap
from collections.abc import Iterator
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.console import build_table, fill_lines, fit_table
from turtlelog.cli.replay_answer import judge_rounding, list_breaks, tell_time
from turtlelog.display import capitalise, describe_count, join_words
from turtlelog.escapes import escape_controls
from turtlelog.run.stop_reasons import MAX_DURATION

if TYPE_CHECKING:
    from turtlelog.cli.explain import ExplainAnswer
    from turtlelog.explain import Attribution, Finding, Identification, MotionFacts, Periods


_ROWS: Final = (
    ("initial queue", "loop.start_backlog", "poses"),
    ("pause", "law.pause_ticks", "ticks"),
    ("  by the clock", "pause.seconds", "s"),
    ("  command held in it", "pause.held_turn_rate_rad_s", "rad/s"),
    ("  turned by the end", "pause.turned_rad", "rad"),
    ("  answered at once", "pause.burst", "poses"),
    ("lost commands", "lost_commands", ""),
    ("queue policy", "loop.queue_policy", ""),
    ("command queue", "loop.command_queue", ""),
    ("pose queue", "loop.pose_queue", ""),
    ("transport delay", "loop.transport_delay_ticks", "ticks"),
    ("answers every", "loop.period_ticks", "ticks"),
    ("Kp angular", "law.kp_angular", "1/s"),
    ("Kp linear", "law.kp_linear", "1/s"),
    ("turn rate limit", "limits.turn_rate_rad_s", "rad/s"),
    ("speed limit", "limits.speed_m_s", "m/s"),
    ("heading tolerance", "law.heading_tolerance_rad", "rad"),
    ("position tolerance", "law.position_tolerance_m", "m"),
    ("projection", "law.projection", ""),
    ("wrapped error", "law.wrap_error", ""),
    ("poses", "loop.pose_precision", ""),
    ("stop reason", "stop_reason", ""),
)
"""Rows of the table: name, key of the finding, and unit."""

_DEAD_TIME: Final = "dead_time."
"""Prefix of the key of a loop's dead time."""

_DRIVEN: Final = "No scenario fits this log. The plant was driven with its commands."

_NOTED: Final = "the recorded scenario"
"""Evidence of values known from the re-simulated recorded scenario."""

_EVIDENCE_WIDTH: Final = 26
_MEANING_WIDTH: Final = 30
"""Width of the last columns of tables [characters]; other columns need the rest of a line."""


def describe_causes(
    found: "Identification", attribution: "Attribution"
) -> Iterator[tuple[str, str]]:
    """Yield each contributing cause with its settings in this run, or words for them."""
    scenario = found.build_scenario()
    values = tl.scenario.flatten_scenario(scenario)
    table = tl.explain.find_causes(scenario)
    for one in attribution.contributions:
        neutral = table[one.cause].neutral
        settings = [
            f"{key} = {values[key]}"
            for key in neutral
            if values.get(key, neutral[key]) != neutral[key]
        ]
        yield one.cause, _describe_settings(found, (*neutral,)) or ", ".join(settings)


def _describe_settings(found: "Identification", keys: tuple[str, ...]) -> str:
    """Return words for the settings that remove a cause; empty if there are none for this run."""
    if keys == ("loop.queue_policy", "loop.start_backlog"):
        parts: list[str] = []
        for key, finding in found.findings.items():
            if key.startswith(_DEAD_TIME) and finding.value is not None:
                loop = tl.explain.describe_loop_name(found.law, key.removeprefix(_DEAD_TIME))
                parts.append(f"{finding.value}{'' if parts else ' ticks'} {loop}")
        return f"commands wait: dead time {', '.join(parts)}" if parts else ""
    seconds = getattr(found.findings.get("pause.seconds"), "value", None)
    if keys == ("law.pause_ticks",) and found.tells_law and seconds is not None:
        return f"the controller is silent for {seconds:.4g} s after the rotation"
    if keys == ("law.wrap_error",) and found.tells_law:
        return "the heading error is not wrapped to half a turn"
    return ""


def format_explain_answer(answer: "ExplainAnswer", found: "Identification") -> str:
    """Return the value, its causes, what they depend on, and the confidence."""
    name = escape_controls(Path(answer.file).name)
    attribution = answer.attribution
    if attribution is None:
        metric = answer.metric
        text = f"has no value: {metric['reason']}"
        if metric["value"] is not None:
            size = f"{metric['value']:.4g} {metric['unit']}".removesuffix(" 1")
            text = f"is {size}; its causes are unknown"
        known = [
            f"{name.strip()} {_format_value(finding.value, unit)}"
            for name, key, unit in _list_rows(found)
            if (finding := found.findings.get(key)) is not None and finding.value is not None
        ]
        facts = [f"The log shows: {', '.join(known)}."] if known else []
        return _fill([f"{name}: {metric['id']} {text}", *map(_capitalise, answer.notes), *facts])
    named = tl.explain.choose_named(attribution)
    lines = [f"{name}: {tl.explain.write_headline(attribution)}"]
    lines += tl.explain.write_leading(attribution)
    if named:
        lines += ["", f"{tl.explain.write_cause_head(attribution)}:"]
    sizes = [tl.explain.format_contribution(attribution, one) for one in named]
    widths = [max(map(len, column), default=0) for column in ([one.cause for one in named], sizes)]
    for one, size in zip(named, sizes, strict=True):
        head = f"  {one.cause:<{widths[0]}}  {size:<{widths[1]}}  "
        words = answer.in_words[one.cause]
        lines.append(fill_lines([f"{head}{words}".rstrip()], indent=len(head)))
    lines += tl.explain.write_reasons(attribution)
    return _fill([*lines, _write_confidence(found, attribution)])


def describe_cut(run: "tl.Run", metric: str) -> str:
    """Return that a run was cut, for a metric of its end; else an empty text."""
    if run.stop_reason != MAX_DURATION or not metric.startswith("final."):
        return ""
    spans = run.find_phase_spans()
    begun = {span.phase for span in spans}
    missing = [
        loop.name
        for loop in run.declaration.loops
        if loop.name in run.phase_names and loop.name not in begun
    ]
    where = f", in the phase {spans[-1].phase}" if spans else ""
    never = f" {capitalise(join_words(missing))} never began." if missing else ""
    return fill_lines(
        [
            f"The run was cut after {run.duration_s:.3g} s (max_duration){where}.{never}"
            f" {metric} is what was left at that time."
        ]
    )


def _fill(lines: list[str]) -> str:
    return "\n".join(line if line.startswith("  ") else fill_lines([line]) for line in lines)


def _write_confidence(found: "Identification", attribution: "Attribution") -> str:
    again = found.resimulation
    if again is None:
        return ""
    rows = f"all {again.samples} samples"
    if found.is_recorded:
        return f"Confidence: as recorded. The recorded scenario reproduces {rows}."
    if again.is_exact:
        label = "Confidence: exact. " if attribution.acting and not attribution.doubts else ""
        return f"{label}The re-simulation reproduces {rows} bit for bit."
    # Loop settings that do not reproduce every sample.
    settings = [one for key, one in found.findings.items() if key in found.tried]
    is_known = all(one.certainty is not tl.explain.Certainty.UNKNOWN for one in settings)
    confidence = "fitted" if settings and is_known else "unknown in part"
    return f"Confidence: {confidence}. {_write_differences(again)}"


def _write_differences(again: "tl.explain.Resimulation") -> str:
    error = again.max_abs_error
    return (
        f"Largest differences of the re-simulation, in {again.samples} samples: x {error.x_m:.3g}"
        f" m, y {error.y_m:.3g} m, heading {degrees(error.heading_rad):.3g} deg, commands"
        f" {again.max_command_error:.3g}."
    )


def format_explain_details(answer: "ExplainAnswer", found: "Identification") -> str:
    """Return every cause, the identified settings with evidence, and the tried values."""
    parts = [] if answer.attribution is None else [format_causes(answer.attribution)]
    parts += [format_identification(found), _format_resimulation(found)]
    return "\n".join(filter(None, parts))


def format_identification(found: "Identification") -> str:
    """Return the identified settings with their evidence."""
    rows: list[tuple[str, ...]] = []
    hidden: dict[str, list[str]] = {note: [] for note in found.notes}
    for name, key, unit in _list_rows(found):
        finding = found.findings.get(key)
        if finding is None:
            continue
        if finding.evidence not in hidden:
            rows += _format_finding(name, finding, unit)
        elif finding.value is None:
            hidden[finding.evidence].append(name.strip())
        else:
            # Its evidence is the note below the table, printed once.
            rows += _format_finding(name, replace(finding, evidence=_NOTED), unit)
    notes = [
        _capitalise(note) + (f" Therefore unknown: {', '.join(names)}." if names else "")
        for note, names in hidden.items()
    ]
    heads = ("", "value", "confidence", "evidence")
    table = build_table(f"Identified from the log of {found.name}", heads, rows)
    return "\n".join([fit_table(table), *([_fill(notes), ""] if notes else [])])


def format_causes(found: "Attribution") -> str:
    """Return a table of the causes that change the value; empty if there are none."""
    from turtlelog.explain.answers import THIS_SEED, THIS_SEED_MEANS

    unit, parts = f" [{found.unit}]" if found.unit else "", found.changing
    if all(one.contribution is None and one.alone is None for one in parts):
        return ""
    heads = ["cause", f"contribution{unit}", f"without it{unit}", "without it means"]
    rows = [[one.cause, one.contribution, one.alone, one.meaning] for one in parts]
    if any(one.standard_error for one in parts):
        heads.insert(2, f"s.e.{unit}")
        for row, one in zip(rows, parts, strict=True):
            row.insert(2, one.standard_error)
        if found.contributions and found.seeds is not None and found.seeds.varies:
            row = [THIS_SEED, found.this_seed, None, None, THIS_SEED_MEANS]
            rows.insert(sum(one.contribution is not None for one in parts), row)
    lines: list[tuple[Any, ...]] = []
    for *cells, meaning in rows:  # the last cell continues on further lines
        first, *rest = textwrap.wrap(str(meaning), _MEANING_WIDTH, break_on_hyphens=False)
        lines += [(*cells, first), *((*[""] * len(cells), line) for line in rest)]
    return fit_table(build_table(f"Causes of {found.metric}", heads, lines))


def _list_rows(found: "Identification") -> list[tuple[str, str, str]]:
    """Return the rows, with one row for each loop's dead time, and none for an unknown law."""
    keys = [key for key in found.findings if key.startswith(_DEAD_TIME)]
    names = [tl.explain.describe_loop_name(found.law, key.removeprefix(_DEAD_TIME)) for key in keys]
    rows = [(f"dead time {name}", key, "ticks") for name, key in zip(names, keys, strict=True)]
    after = [key for _, key, _ in _ROWS].index("lost_commands")
    rows = [*_ROWS[:after], *rows, *_ROWS[after:]]
    return [row for row in rows if found.tells_law or not row[1].startswith("law.")]


def _format_finding(name: str, finding: "Finding", unit: str) -> list[tuple[str, ...]]:
    value = "-" if finding.value is None else _format_value(finding.value, unit)
    evidence = finding.evidence
    if finding.candidates:
        evidence += ": " + ", ".join(map(str, finding.candidates))
    if finding.value is not None and finding.interval is not None:
        low, high = (_format_value(bound, unit, digits=4) for bound in finding.interval)
        evidence += f": {low} to {high}"
    first, *rest = textwrap.wrap(evidence, _EVIDENCE_WIDTH, break_on_hyphens=False)
    return [(name, value, finding.certainty.value, first), *(("", "", "", line) for line in rest)]


def _format_value(value: Any, unit: str, digits: int = 6) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value.replace("_", " ")
    if unit == "rad":
        value, unit = degrees(value), "deg"
    return f"{value:.{digits}g} {unit}".rstrip()


def _format_resimulation(found: "Identification") -> str:
    again, tried = found.resimulation, []
    for name, key, unit in _ROWS:
        values = found.tried.get(key, ())
        if len(values) < 2:
            continue
        text = ", ".join(map(str, values))
        if len(values) > 2 and [*values] == [*range(values[0], values[0] + len(values))]:
            text = f"{values[0]} to {values[-1]}"
        tried.append(f"{name} {text} {unit}".rstrip())
    settings = "; ".join(tried) or "one, the clock and the dead times leave no other"
    if not found.tried:
        settings = "those recorded, and no others"
    if again is None and not found.tried:
        return "Nothing was simulated again."
    head = _DRIVEN if again is None else _write_differences(again)
    return _fill([head, f"Settings tried: {settings}."])


def _capitalise(note: str) -> str:
    return f"{capitalise(note).removesuffix('.')}."


NEEDS: Final = (
    "An explanation needs the samples of the controller (turtlelog_msgs/msg/ControlSample): the"
    " pose that it read, and the command that it gave."
)


_SILENCE: Final = 1.5
"""Silence, in usual periods, from which a silence is shown; one period may vary by half."""


def format_motion(file: Path, run: "tl.Run", found: "MotionFacts") -> str:
    """Return that no cause is known, and the facts as sentences."""
    topics = [topic for topic in (run.origin.poses, run.origin.commands) if topic is not None]
    where = join_words([escape_controls(topic.describe()) for topic in topics])
    kind = "Turtlesim" if found.kind == "turtlesim" else "A robot, not turtlesim"
    if found.kind == "robot" and run.poses.speed_m_s is not None and not run.parameters:
        kind = "A robot that publishes poses as turtlesim does, not turtlesim"
    largest = [
        f"{one.signal.replace('_', ' ')} {one.value:.4g} {one.unit}"
        f" at {round(tell_time(run, one.time_ns), 3) + 0.0:.3f} s"
        for one in found.largest
    ]
    outliers = tl.measure.describe_outliers(run) if found.outliers else {}
    breaks = {} if found.replay is not None else tl.measure.describe_breaks(run)
    sentences = [
        f"{escape_controls(file.name)}: not explained, because there are no samples of a"
        " controller.",
        f"{kind}, run.duration {run.duration_s:.3f} s{f', of {where}' if where else ''}.",
        _tell_rate(run, "pose", len(run.poses), found.poses),
        _tell_rate(run, "command", len(run.commands), found.commands),
        *([f"Largest commands: {', '.join(largest)}."] if largest else []),
        *(f"The {signal.replace('_', ' ')} has {text}." for signal, text in outliers.items()),
        *map(_capitalise, breaks.values()),
        *_tell_plant(run, found),
    ]
    if found.replay is not None:
        sentences += [f"At {line}." for line in list_breaks(run, found.replay)]
    return fill_lines([*sentences, "", NEEDS])


def _tell_rate(run: "tl.Run", noun: str, rows: int, periods: "Periods | None") -> str:
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


def _tell_plant(run: "tl.Run", found: "MotionFacts") -> list[str]:
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
        counts = [
            f"{count} in the next tick"
            if ticks == 0
            else f"{count} {describe_count(ticks, 'tick')} later"
            for ticks, count in delays.counts.items()
        ]
        low, median, high = (
            f"{value / 1e6:.4g}" for value in (delays.low_ns, delays.median_ns, delays.high_ns)
        )
        total = describe_count(sum(delays.counts.values()), "command")
        sentences.append(
            f"Dead time of the {total} that a pose shows: {join_words(counts)}. The pose comes"
            f" {low} to {high} ms after the command, usually {median} ms, by the recording's clock."
        )
    return sentences
