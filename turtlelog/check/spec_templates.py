"""Templates for authors of specifications: a first text from a run, and the JSON Schema."""

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from turtlelog.check.formula_trace import RunEnding, find_ending, find_loss
from turtlelog.check.spec import ASSOCIATIONS, FORMAT, READ_TEXTS
from turtlelog.compare import ALIGNMENTS
from turtlelog.compare.trajectory_comparison import ALIGN_IN
from turtlelog.display import describe_count, format_number
from turtlelog.log import ReadChoice
from turtlelog.log.read_choice import TimeSource
from turtlelog.measure import (
    ANY_LOOP,
    METRICS,
    SIGNALS,
    Metric,
    MetricKind,
    SignalKind,
    find_signal,
    list_essential_metrics,
    list_metrics,
    measure_run,
)
from turtlelog.measure.pose_noise import find_scatter, measure_noise
from turtlelog.measure.rates import space_poses
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.run import Run, take_rows
from turtlelog.run.loops import DONE, NAME_PATTERN, RESERVED, STATE_PATTERN
from turtlelog.run.stop_reasons import LAW_FAILED, STEP_BUDGET, find_goal_end

_OF_LOOP: Final = ("overshoot", "settling_time", "rms_error", "largest_error", "saturated_share")
_OF_RUN: Final = (
    *("final.heading_error", "final.position_error"),
    *("run.duration", "run.path_length", "run.cross_track_max", "run.largest_gap"),
)
"""Essential metrics that a specification bounds."""

_SHARE: Final = 0.1
"""Smallest margin of a bound as a share of the value, which includes the scatter of repeated runs.

The margin is a first guess, marked as observed, until a user decides on the bound."""

_MOST: Final = 0.2
"""Largest margin: two digits are readable, but round up by as much as 21 %; then three digits are
used."""

_GRAINS: Final[Mapping[str, float]] = {
    "m": 1e-4,
    "m/s": 1e-3,
    "deg": 1e-2,
    "rad/s": 1e-3,
    "%": 0.1,
    "1": 1e-6,
    "s": TURTLESIM.period_s,
}
"""Smallest margin by unit, for values near zero: less than a robot's localisation resolves, a
twentieth of the usual band of 2 %, and a tick."""

_NOISES: Final = 4.0
"""Smallest margin of a place or an angle in standard deviations of the noise of the poses: of two
noisy poses, one of 400 is further off."""


def format_first_spec(run: Run, *, reference: str, read: ReadChoice | None = None) -> str:
    """Return a specification that a run passes; each reason gives the distance to the bound.

    `reference` is the run's file as the specification names it; `read` are the settings with which
    the run was read, so that other recordings are read equally.
    """
    doubt, partial = find_doubt(run), "" if find_loss(run) is None else " --partial"
    checks = [*(_list_of_motion(run) if run.is_lawless else _list_of_law(run))]
    count = describe_count("\n".join(checks).count("[checks."), "check")
    head = (
        f"# {count} read off 1 run, {_comment(run.name)}: turtlelog check SPEC RUN...{partial}",
        "# Bounds marked observed = true were read off that run. Ask of each what it should be,",
        "# change it, and take the mark away.",
        *([] if doubt is None else [f"# Was it a good run? {_comment(doubt)}"]),
        "format = 1",
        f"reference = {_quote(reference)}",
    )
    return "\n".join([*head, *_list_read(read or ReadChoice()), *checks]) + "\n"


def find_doubt(run: Run) -> str | None:
    """Return a sentence on why bounds of a run may be those of a bad run; None without a doubt.

    A run that reached its goal is good, also if its maximum duration ended it. A third-party bag
    does not tell how it ended, which is no doubt.
    """
    ending, loss = find_ending(run), find_loss(run)
    if ending is RunEnding.LOST and loss is not None:
        return f"{loss[0].upper()}{loss[1:]}."
    end = find_goal_end(run)
    is_broken = run.stop_reason in {LAW_FAILED, STEP_BUDGET}
    if end is not None and end.verdict == "reached" and not is_broken:
        return None
    is_bad = end is not None and (end.is_away or end.turned_rad is not None)
    if not is_bad and ending is not RunEnding.CUT:
        return None
    how = f"ended after {run.duration_s:.3g} s" if end is None else end.describe()
    stop = run.stop_reason or "end not recorded"
    return f"It {how} (stop reason: {stop.replace('_', ' ')})."


def name_reference(path: Path, target: Path | None) -> str:
    """Return the name by which a specification in `target` finds the reference."""
    folder = Path.cwd() if target is None else target.resolve().parent
    try:
        return Path(os.path.relpath(path.resolve(), folder)).as_posix()
    except ValueError:  # on Windows, for two different drives
        return path.resolve().as_posix()


def _list_read(read: ReadChoice) -> Iterator[str]:
    texts = {name: getattr(read, name) for name in READ_TEXTS}
    lines = [f"{name} = {_quote(text)}" for name, text in texts.items() if text is not None]
    for name, numbers in (("goal", read.goal), ("wheels", read.wheels)):
        if numbers is not None:
            lines.append(f"{name} = [{', '.join(map(repr, numbers))}]")
    if read.wheelbase is not None:
        lines.append(f"wheelbase = {read.wheelbase!r}")
    if read.time != ReadChoice().time:
        lines.append(f"time = {_quote(read.time)}")
    if read.columns:
        columns = (f"{_quote(name)} = {_quote(text)}" for name, text in read.columns.items())
        lines.append(f"columns = {{ {', '.join(columns)} }}")
    if lines:
        yield from ("", "[read]", *lines)


_OF_POSES: Final = ("run.cross_track_max", "run.pose_jumps")
"""Metrics that are bounded although they are not essential: wrong poses may also end well."""


def _list_of_law(run: Run) -> Iterator[str]:
    kinds, essential = list_metrics(run.declaration), list_essential_metrics(run.declaration)
    asked = [name for name in essential if name in _OF_RUN or name.rpartition(".")[2] in _OF_LOOP]
    for metric in measure_run(run, only=asked).values():
        if not all(part.isidentifier() for part in metric.id.split(".")):  # a loop `my-loop`
            yield ""
            yield f"# {metric.id}: no formula can name it: - stands for minus"
        elif metric.value is None:
            yield ""
            yield f"# {metric.id}: no value here: {metric.status.value} ({_comment(metric.reason)})"
        else:
            grains = {**_GRAINS, "s": find_plant(run).period_s}
            yield from _list_check(metric, metric.value, kinds[metric.id], grains)
    if run.goal_xy_m is None or not len(run.samples):
        return
    metric = measure_run(run, only=["run.cross_track_max"])["run.cross_track_max"]
    if metric.value is not None and find_ending(run) in {RunEnding.CUT, RunEnding.LOST}:
        yield ""
        yield "# always(abs(cross_track) <= ...): not read off, as how the run went on is unknown"
    elif metric.value is not None:
        meaning = ": how far beside the line, at any time"
        yield from _list_bound("track", "cross_track", metric.value, metric.unit, meaning)


def _list_of_motion(run: Run) -> Iterator[str]:
    """Yield checks for a third-party bag, on the metrics that have a value and on its commands."""
    kinds, grains = list_metrics(run.declaration), _find_grains(run)
    scatter = find_scatter(run)
    lengths = {"run.path_length": scatter.path_m, "run.total_turning": scatter.turning_rad}
    asked = dict.fromkeys([*list_essential_metrics(run), *_OF_POSES])
    for metric in measure_run(run, only=[*asked]).values():
        kind = kinds[metric.id]
        # A count or share that is better neither way is the driving style, limited on both sides.
        is_style = kind.better is None and kind.nature is not None
        if metric.value is None or is_style:
            continue
        if metric.id == "run.pose_jumps":
            yield from _list_jumps(metric.id, metric.value)
            continue
        meaning = "" if lengths.get(metric.id) is None else ": with the noise of its poses"
        yield from _list_check(metric, metric.value, kind, grains, meaning)
    if len(run.commands):
        yield from _list_of_commands(run)


def _find_grains(run: Run) -> Mapping[str, float]:
    """Return the smallest margins of a run of any robot, by unit or metric."""
    if len(run.poses) < 2:
        return {**_GRAINS, "s": 0.0}
    spaced = space_poses(run)
    noise = measure_noise(take_rows(run.poses, spaced.rows))
    sizes = {"m": noise.position_m, "deg": math.degrees(noise.heading_rad)}
    if run.poses.measured_speed_m_s is None:  # differences of two noisy poses
        per_s = math.sqrt(2.0) / float(np.median(np.diff(spaced.time_s)))
        sizes["run.measured_speed_max"] = per_s * noise.position_m
        sizes["run.measured_turn_rate_max"] = per_s * noise.heading_rad
    least = {key: max(_GRAINS.get(key, 0.0), _NOISES * size) for key, size in sizes.items()}
    return {**_GRAINS, **least, "s": float(np.median(np.diff(run.poses.time_ns))) / 1e9}


def _list_jumps(name: str, count: float) -> Iterator[str]:
    if count:
        yield from ("", f"# {name} <= ...: not read off, as its poses jump; here {count:g}")
        return
    yield from _write_check(f'"{name}"', f'expect = "{name} <= 0"', "0", "nothing")


def _list_of_commands(run: Run) -> Iterator[str]:
    if find_ending(run) is RunEnding.LOST:
        yield ""
        yield "# always(abs(speed) <= ...): not read off, as part of the run is lost"
        return
    for name in ("speed", "turn_rate"):
        signal = find_signal(run, name)
        if signal is None:
            continue
        largest, meaning = float(np.abs(signal.values).max()), ": as it was commanded, at any time"
        yield from _list_bound(name, name, largest, signal.kind.unit, meaning)


def _list_bound(title: str, name: str, largest: float, unit: str, meaning: str) -> Iterator[str]:
    bound, spare = choose_bound(largest, unit, up=True)
    formula = f'holds = "always(abs({name}) <= {bound:.10g})"'
    yield from _write_check(title, formula, format_number(largest, unit), spare, meaning)


def _write_check(
    title: str, formula: str, here: str, spare: str, meaning: str = ""
) -> Iterator[str]:
    yield ""
    yield f"[checks.{title}]"
    yield f"{formula}  # here {here}"
    yield "observed = true"
    yield f'reason = "observed, and {spare} to spare{meaning}"'


def _list_check(
    metric: Metric, value: float, kind: MetricKind, grains: Mapping[str, float], meaning: str = ""
) -> Iterator[str]:
    is_higher = kind.better == "higher"
    base = value if kind.floor is None or is_higher else max(value, kind.floor)
    operator = ">=" if is_higher else "<="
    grain = max(grains.get(key, 0.0) for key in (metric.unit, metric.id))
    bound, spare = choose_bound(base, metric.unit, up=not is_higher, grain=grain)
    if kind.nature == "share" and not is_higher and bound >= 1.0:
        yield ""
        yield f"# {metric.id} <= ...: not read off, as no share exceeds 1; here {value:.5g}"
        return
    formula = f'expect = "{metric.id} {operator} {bound:.10g}"'
    here = format_number(value, metric.unit)
    yield from _write_check(f'"{metric.id}"', formula, here, spare, meaning)


def choose_bound(
    value: float, unit: str, *, up: bool, grain: float | None = None
) -> tuple[float, str]:
    """Return a bound beyond an observed value, and its margin in words.

    `grain` is the smallest margin; None: that of the unit.
    """
    spare, grain = abs(value) * _SHARE, _GRAINS.get(unit, 0.0) if grain is None else grain
    if spare < grain or value == 0.0:
        words = f"{grain:.3g}" if unit == "1" else f"{grain:.3g} {unit}"
        return _round(value + grain if up else value - grain, digits=3, up=up), words
    bound = value
    for digits in (2, 3):
        bound = _round(value + spare if up else value - spare, digits=digits, up=up)
        if abs(bound - value) <= _MOST * abs(value):
            break
    return bound, f"{abs(bound - value) / abs(value):.0%}".replace("%", " %")


def _round(value: float, *, digits: int, up: bool) -> float:
    """Return a value with the given number of digits, rounded away from the observed value."""
    if value == 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
    steps = value / step
    if not math.isclose(steps, round(steps), rel_tol=1e-9):  # 0.1 has no more digits
        steps = math.ceil(steps) if up else math.floor(steps)
    return float(f"{steps * step:.{digits + 1}g}")


def _quote(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'


def _comment(text: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in text)


_LOOP = f"(?!(?:{'|'.join(sorted(RESERVED))})[.]){NAME_PATTERN}"
"""Pattern of loop names. The run's law determines the loops and phases."""


def _field(description: str, **kind: Any) -> dict[str, Any]:
    return {**kind, "description": description}


def _text(description: str) -> dict[str, Any]:
    return _field(description, type="string", pattern="\\S")


def _number(description: str, **limits: float) -> dict[str, Any]:
    return _field(description, type="number", **limits)


def _table(properties: Mapping[str, Any], **head: str) -> dict[str, Any]:
    """Return the schema of a table with these keys and no others."""
    return {"type": "object", "additionalProperties": False, **head, "properties": properties}


_REASON: Final = _text("Why so much and no more.")


def build_schema() -> dict[str, Any]:
    """Return the schema, draft 2020-12. Formulas are texts that `turtlelog check` parses."""
    signals = {name: _refer("signal", kind) for name, kind in SIGNALS.items()}
    metrics = {name: _refer("metric", kind) for name, kind in METRICS.items()}
    # Ids of loops are valid for any law, and any law may have further states.
    of_loop = {name: name.partition(f"{ANY_LOOP}.")[2] for name in METRICS if ANY_LOOP in name}
    ids = {f"^{_LOOP}[.]{plain}$": metrics.pop(name) for name, plain in of_loop.items()}
    states = {f"^{STATE_PATTERN}$": {"$ref": "#/$defs/signal"}}
    alignments = "|".join(ALIGNMENTS).replace("NAME", NAME_PATTERN)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "turtlelog specification and tolerance file",
        "type": "object",
        "required": ["format"],
        "anyOf": [{"required": [key]} for key in ("checks", "signals", "metrics")],
        "additionalProperties": False,
        "properties": {
            "format": _field("Of this file.", const=FORMAT),
            "reference": _text("Recording that tolerances are taken from, relative to this file."),
            "alignment": _field(
                "How runs and reference are brought together in time.",
                type="string",
                pattern=f"^(?:{alignments})$",
            ),
            "trajectory": _build_trajectory(),
            "read": _build_read(),
            "checks": _field(
                "What is to hold, by a name of your own.",
                type="object",
                additionalProperties=_build_check(),
            ),
            "signals": {**_table(signals), "patternProperties": states},
            "metrics": {**_table(metrics), "patternProperties": ids},
        },
        "$defs": {
            "signal": _build_tolerance(time_s=_number("How far in time [s].", minimum=0)),
            "metric": _build_tolerance(),
        },
    }


def _refer(kind: str, found: SignalKind | MetricKind) -> dict[str, Any]:
    return {"$ref": f"#/$defs/{kind}", "description": f"[{found.unit}] {found.meaning}"}


def _build_trajectory() -> dict[str, Any]:
    return _table(
        {
            "align": _field("Transformation that is fitted.", enum=[*ALIGN_IN]),
            "associate": _field(
                "Poses of one moment: nearest in time, or linearly interpolated.",
                enum=[*ASSOCIATIONS],
            ),
            "max_difference_s": _number(
                "Largest difference in time between poses that belong together [s].", minimum=0
            ),
            "time_offset_s": _field(
                "Added to times of a recording [s]; start: first poses together.",
                anyOf=[{"type": "number"}, {"const": "start"}],
            ),
            "rpe": _text("Length of relative motions, as in 1m or 30deg."),
            "all_pairs": _field("A relative motion begins at every pose.", type="boolean"),
        },
        description="How ate.* and rpe.* are measured beside the reference.",
    )


def _build_read() -> dict[str, Any]:
    positive = {"type": "number", "exclusiveMinimum": 0}
    return _table(
        {
            **{name: _text(meaning) for name, meaning in READ_TEXTS.items()},
            "goal": _field(
                "x, y [m] and perhaps the heading [rad].",
                type="array",
                items={"type": "number"},
                minItems=2,
                maxItems=3,
            ),
            "wheels": _field(
                "Radius of the wheels, and the distance between them [m].",
                type="array",
                items=positive,
                minItems=2,
                maxItems=2,
            ),
            "wheelbase": _field("Distance of the axles [m], for Ackermann commands.", **positive),
            "time": _field(
                "What times poses: the recorder, their stamps, or as is best.",
                enum=[*get_args(TimeSource)],
            ),
            "columns": _field(
                "Of a plain table: the column of t, x, y, heading ...",
                type="object",
                additionalProperties={"type": "string", "pattern": "\\S"},
            ),
        },
        description="What is read of third-party files, also of the reference.",
    )


def _build_check() -> dict[str, Any]:
    table = _table(
        {
            "expect": _text("Formula over metrics and parameters."),
            "holds": _text("Formula over signals and time."),
            "phase": _field(
                "Stretch that holds looks at: a phase of the law, or pause.",
                type="string",
                pattern=f"^(?!{DONE}$){NAME_PATTERN}$",
            ),
            "when": _text("Otherwise the check is skipped."),
            "reason": _REASON,
            "observed": _field(
                "The bound was read off a run; nobody has thought about it.", type="boolean"
            ),
        }
    )
    one_of = [{"required": ["expect"]}, {"required": ["holds"]}]
    return {**table, "oneOf": one_of, "dependentRequired": {"phase": ["holds"]}}


def _build_tolerance(**more: Any) -> dict[str, Any]:
    distance = _number("How far from the reference, in the unit of the name.", minimum=0)
    share = _number("As a share of the reference.", minimum=0, maximum=1)
    properties = {"abs": distance, "rel": share, "reason": _REASON, **more}
    return {"type": "object", "required": ["reason"], **_table(properties)}
