"""Marks on curves: where a curve settles, its peak, its rise; and where a signal violated a check.

The marks of metrics come first, then the violated signal with the band that it left.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts import curves
from turtlelog.charts.curves import Curve, Values
from turtlelog.display import format_number
from turtlelog.measure import MeasureSettings, Metric, find_dead_time, find_signal
from turtlelog.measure.metric import Missing
from turtlelog.measure.response import Response, find_loop_samples, find_response
from turtlelog.run import Run
from turtlelog.run.loops import PAUSE, ControlLoop, Declaration

ALONG_ERROR: Final = "along_track_error"
TO_REFERENCE: Final = "distance_to_reference"

_ROUNDING_NS: Final = 1_000
"""Rounding of metric times [ns]: a command that begins within this time counts as begun."""

MarkShape = Literal["disc", "square", "cross"]

_SHAPES: Final[Mapping[str, MarkShape]] = {
    "settling_time": "disc",
    "final_error": "disc",
    "position_error": "disc",
    "overshoot": "square",
    "largest_error": "square",
    "cross_track_max": "square",
    "rise_time": "cross",
    "time_to_goal": "cross",
    "longest_saturation": "cross",
    "dead_time": "cross",
}
"""Mark shapes by kind of metric.

Discs mark where a curve comes to rest, squares its extremes, crosses the end or start of a time. A
peak is marked with its overshoot."""

SIGNS: Final[Mapping[MarkShape, str]] = MappingProxyType(
    {"disc": "●", "square": "■", "cross": "\N{MULTIPLICATION SIGN}"}
)
"""Letters that Rerun's viewer can draw. Others, such as the heavy multiplication sign, crash it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Characteristic:
    """A metric on its curve.

    A pause or a saturation has the time of its start. A dead time has the time of the pose that the
    loop answers by its largest change of command; the robot follows that change after the dead
    time. These have their whole interval. A rise lasts from 10 % to 90 % of its step. A settling
    time lasts from when the curve stays in its band to the end of the loop's segment. The two
    levels of a settling time are the ends of the band, those of peak and overshoot the reference
    and the peak.
    """

    signal: str  # signal of the curve for `read_marked_curve`; empty for a pause of the whole run
    metric: str  # id of the metric; `run.pause` for a pause
    word: str  # word for a label: `rise`, `settled`, `overshoot`
    value: float  # value in `unit`
    unit: str  # unit of the metric
    at_s: float  # time of the metric, from the first sample [s]
    level: float | None  # value of the curve at that time, headings in deg; None for a pause
    span_s: tuple[float, float] | None = None  # interval [s]; None if the metric has a single time
    levels: tuple[float, float] | None = None  # related levels in the unit of the curve, if any
    loop: str = ""  # name of the metric's loop; empty if the metric belongs to the whole run
    start_s: float = 0.0  # start of the loop's segment, from the first sample [s]

    @property
    def kind(self) -> str:
        """Name of the metric without its loop: `rise_time`, `settling_time`, `pause`."""
        return self.metric.rpartition(".")[2]

    @property
    def shape(self) -> MarkShape | None:
        """Shape of the mark; None if there is no mark, as for a pause."""
        return _SHAPES.get(self.kind)

    @property
    def sign(self) -> str:
        """The shape as a letter."""
        return "" if self.shape is None else SIGNS[self.shape]

    @property
    def marked_s(self) -> float:
        """Time of the mark, from the first sample [s]: for a dead time, the end of its interval."""
        return self.span_s[1] if self.kind == "dead_time" and self.span_s is not None else self.at_s

    @property
    def text(self) -> str:
        """Text for the mark, with useful precision."""
        if self.kind == "dead_time":
            return f"{self.word} {1e3 * self.value:.3g} ms"
        if self.kind == "overshoot" and self.value < 0.0:
            return f"no {self.word}"
        digits = 4 if self.kind == "peak" else 2 if self.unit == "%" else 3
        return f"{self.word} {self.value:.{digits}g} {self.unit}"


def list_mark_texts(mark: Characteristic, others: Iterable[Characteristic]) -> list[str]:
    """Return a mark's texts: for an overshoot, its peak and its part of the step, if positive."""
    if mark.kind != "overshoot":
        return [mark.text]
    peaks = [one.text for one in others if one.kind == "peak" and one.loop == mark.loop]
    return [*peaks, *([mark.text] if mark.value >= 0.0 else [])]


class _Place(NamedTuple):
    """A metric, the signal of the curve on which it is marked, and the word of its label."""

    metric: str
    signal: str
    word: str
    loop: ControlLoop | None = None


_OF_RUN: Final = (
    _Place("run.time_to_goal", "distance", "near the goal"),
    _Place("final.position_error", "distance", "at the end"),
)


def list_characteristics(
    run: Run, metrics: Mapping[str, Metric], settings: MeasureSettings | None = None
) -> tuple[Characteristic, ...]:
    """Return the metrics that have a value and can be marked on a curve, and the pauses.

    For each loop, these are the metrics of the step on the controlled signal; for a moving
    reference, the largest error. The longest saturation is marked on the command. The final error
    of a heading is also included. `settings` are those with which `measure_run` gave the metrics.
    """
    read = cache(partial(read_marked_curve, run))

    @cache
    def respond(loop: ControlLoop | None) -> Response | None:
        if loop is None:
            return None
        signal = find_signal(run, loop.signal)
        found = find_response(run, loop, signal, settings or MeasureSettings())
        return None if isinstance(found, Missing) else found

    loops = run.declaration.loops
    found = []
    for place in (
        *(one for loop in loops for one in _list_of_loop(run.declaration, loop)),
        *_OF_RUN,
    ):
        metric = metrics.get(place.metric)
        if metric is not None and metric.value is not None:
            found.append(_place(run, place, metric, read(place.signal), respond(place.loop)))
    return (*(mark for mark in found if mark is not None), *_list_pauses(run))


def read_marked_curve(run: Run, signal: str) -> Curve | None:
    """Return the curve of a characteristic, headings in deg; None if the run does not have it.

    In addition to signals there are `along_track_error` and `distance_to_reference`, for laws with
    a moving reference.
    """
    if signal in {"speed", "turn_rate"}:
        return curves.read_command(run, "speed" if signal == "speed" else "turn_rate")
    if signal == ALONG_ERROR:
        return curves.read_along_error(run)
    read_distance = curves.read_distance_to_reference
    return read_distance(run) if signal == TO_REFERENCE else curves.read_curve(run, signal)


def _place(
    run: Run, place: _Place, metric: Metric, curve: Curve | None, response: Response | None
) -> Characteristic | None:
    """Return a metric with its position; None if the metric has no position."""
    is_dead_time = place.metric.endswith(".dead_time")
    at_s = _find_dead_start(run, place.loop) if is_dead_time else metric.at_s
    if metric.value is None or at_s is None or curve is None:
        return None
    time_ns = curve.start_ns + round(at_s * 1e9)
    level = float(np.interp(time_ns, curve.time_ns, curve.values))
    if curve.holds:
        row = int(np.searchsorted(curve.time_ns, time_ns + _ROUNDING_NS, side="right")) - 1
        level = float(curve.values[max(row, 0)])
    mark = Characteristic(
        signal=place.signal,
        metric=place.metric,
        word=place.word,
        value=metric.value,
        unit=metric.unit,
        at_s=at_s,
        level=level,
        loop="" if place.loop is None else place.loop.name,
        start_s=0.0 if response is None else response.start_s,
    )
    if mark.kind in {"dead_time", "longest_saturation"}:
        return replace(mark, span_s=(at_s, at_s + metric.value))
    return mark if response is None else _add_step(mark, response)


def _find_dead_start(run: Run, loop: ControlLoop | None) -> float | None:
    """Return the time of the pose that a loop answers by its largest change of command [s].

    The dead time is most visible at this pose. The first answers, which may have waited, and
    answers before the last change of the dead time are excluded, because their dead time differs.
    """
    found = None if loop is None else find_dead_time(run, loop)
    if loop is None or found is None or isinstance(found, Missing):
        return None
    rows = find_loop_samples(run, loop)
    command = curves.read_command(run, "speed" if loop.command == "speed" else "turn_rate")
    if rows is None or command is None:
        return None
    times_ns = run.poses.time_ns[run.samples.pose_sequence[rows]]
    since_ns = found.changes[-1].time_ns if found.changes else times_ns[0]
    jumps = np.abs(np.diff(command.values[rows])) * (times_ns[1:] > since_ns)
    if not len(jumps) or not jumps.any():
        return None
    return float(times_ns[1 + int(jumps.argmax())] - run.start_ns) / 1e9


def _add_step(mark: Characteristic, response: Response) -> Characteristic:
    unit = 180.0 / np.pi if response.loop.signal == "heading" else 1.0
    initial, reference = response.initial * unit, response.reference * unit
    step = reference - initial
    end_s = response.start_s + float(response.time_s[-1])
    if mark.kind == "rise_time":
        return replace(
            mark,
            span_s=(mark.at_s - mark.value, mark.at_s),
            levels=(initial + 0.1 * step, initial + 0.9 * step),
        )
    if mark.kind == "settling_time":
        half = response.band * abs(step)
        return replace(mark, span_s=(mark.at_s, end_s), levels=(reference - half, reference + half))
    if mark.kind in {"overshoot", "peak"} and mark.level is not None:
        return replace(mark, levels=(reference, mark.level))
    return mark


def _list_pauses(run: Run) -> Iterator[Characteristic]:
    for span in run.find_phase_spans():
        if span.phase == PAUSE:
            start_s, end_s = ((ns - run.start_ns) / 1e9 for ns in (span.start_ns, span.end_ns))
            yield Characteristic(
                signal="",
                metric="run.pause",
                word="pause",
                value=end_s - start_s,
                unit="s",
                at_s=start_s,
                level=None,
                span_s=(start_s, end_s),
            )


def _list_of_loop(declaration: Declaration, loop: ControlLoop) -> Iterator[_Place]:
    def mark(metric: str, signal: str, word: str) -> _Place:
        return _Place(f"{loop.name}.{metric}", signal, word, loop)

    moving = {"distance": TO_REFERENCE, "along_track": ALONG_ERROR} if loop.moves else {}
    controlled = moving.get(loop.signal, loop.signal)  # the curve that has the loop's marks
    alike = [other for other in declaration.loops if other.signal == loop.signal]
    whose = f"{loop.name} " if len(alike) > 1 else ""
    if loop.moves:
        yield mark("largest_error", controlled, f"{whose}furthest off")
    else:
        yield mark("settling_time", controlled, f"{whose}settled")
        yield mark("overshoot", controlled, f"{whose}overshoot")
        yield mark("peak", controlled, f"{whose}peak")
        yield mark("rise_time", controlled, f"{whose}rise")
    yield mark("dead_time", controlled, f"{whose}dead time")
    if loop.signal == "heading":
        yield mark("final_error", "heading_error", _name_end(declaration, loop))
    commanding = [other for other in declaration.loops if other.command == loop.command]
    whose = f"{loop.name} " if len(commanding) > 1 else ""
    yield mark("longest_saturation", loop.command, f"{whose}saturated for")
    if loop.command == "speed" and not declaration.follows_path:
        yield mark("cross_track_max", "cross_track", "furthest")


def _name_end(declaration: Declaration, loop: ControlLoop) -> str:
    """Return the name of the final error of a heading loop."""
    phases = {name: acting for name, acting in declaration.phases.items() if name != PAUSE}
    names = list(phases)
    own = [number for number, name in enumerate(names) if loop.name in phases[name]]
    following = phases[names[own[-1] + 1]] if own and own[-1] + 1 < len(names) else ()
    drives = any(found.command == "speed" for found in declaration.loops if found.name in following)
    return "when driving off" if drives else f"at the end of {loop.name}"


_CLOSE_UP: Final = 4.0
"""Ratio of the signal's height to the violation's height, from which only the violation is shown.
Otherwise the band would take less than a quarter of the plot."""

_ROOM: Final = 0.18
"""Margin above and below the whole signal for marks and their texts, as a share of its height."""

_CLOSE_ROOM: Final = 0.8
"""Margin above and below a close-up, where the signal goes on, as a share of its height."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownRange:
    """Part of a signal's values that a plot shows."""

    low: float  # lower end of the plot, in the unit of the check
    high: float  # upper end of the plot
    note: str = ""  # how far the signal goes outside a close-up; empty if the whole is shown


@dataclass(frozen=True, slots=True, kw_only=True)
class ViolationMoment:
    """One time of a violation."""

    time_s: float  # time from the first sample [s]
    value: float  # value of the signal at this time, in the unit of the check


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViolatedSignal:
    """A signal with the band to which a check limits it, in the unit of the check.

    Angles are in degrees, as in the check's message.
    """

    name: str  # name of the measured quantity in the check: `cross_track`, `speed - measured_speed`
    unit: str  # unit of values and limits: `m`, `deg`, `m/s`, `rad/s`; empty if it is not simple
    curve: Curve  # the signal over the whole run, shape (n,)
    low: Values | None  # lower end of the band, shape (n,); NaN where none is asked; None: no end
    high: Values | None  # upper end of the band, likewise
    outside: NDArray[np.bool_]  # whether each row is outside while the band is required, shape (n,)
    first: ViolationMoment  # first violation of the check
    worst: ViolationMoment  # row furthest outside; of a value never reached, the nearest row
    worst_word: str = "worst"  # `worst` or `nearest`
    reference: Values | None = None  # values from which a tolerance counts, shape (n,); else None
    check: str = ""  # name of the check
    expected: str = ""  # requirement as written
    metric: str = ""  # limited metric, which the signal has only at the worst time; empty: a band

    @property
    def is_moving(self) -> bool:
        """Whether an end of the band changes with time."""
        ends = [end[np.isfinite(end)] for end in (self.low, self.high) if end is not None]
        return any(len(end) > 0 and bool(np.ptp(end) > 0.0) for end in ends)

    @property
    def title(self) -> str:
        """Name of the signal with its unit, for a plot."""
        return self.name if self.unit in {"", "1"} else f"{self.name} [{self.unit}]"

    def find_range(self) -> ShownRange:
        """Return the range of a plot: of signal and band, or of a much smaller violation."""
        # A value that was never reached is outside from the start: only its nearest approach
        # matters.
        values = self.curve.values
        outside = values[:0] if self.worst_word == "nearest" else values[self.outside]
        ends = [end for end in (self.low, self.high) if end is not None]
        near = np.concatenate([*ends, outside, [self.first.value, self.worst.value]])
        near = near[np.isfinite(near)]
        whole = np.concatenate([near, values[np.isfinite(values)]])
        is_close_up = bool(np.ptp(whole) > _CLOSE_UP * np.ptp(near))
        shown, share = (near, _CLOSE_ROOM) if is_close_up else (whole, _ROOM)
        low, high = float(shown.min()), float(shown.max())
        room = share * (high - low) or 0.1 * abs(low) or 1.0
        note = ""
        if is_close_up:
            far = float(whole[int(np.argmax(np.abs(whole - near.mean())))])
            note = f"close up: the signal goes to {format_number(far, self.unit)}"
        return ShownRange(low=low - room, high=high + room, note=note)

    def describe_moment(self, moment: ViolationMoment, word: str) -> str:
        """Return the time and value of a violation as text: `worst -0.083 m at 4.512 s`."""
        return f"{word} {format_number(moment.value, self.unit)} at {moment.time_s:.3f} s"

    def describe_outside(self, moment: ViolationMoment) -> str:
        """Return the distance of the signal from the band as text: `0.0577 m`; empty if inside."""
        row = int(np.argmin(np.abs(self.curve.time_s - moment.time_s)))
        below = 0.0 if self.low is None else float(self.low[row]) - moment.value
        above = 0.0 if self.high is None else moment.value - float(self.high[row])
        beyond = float(np.nanmax([below, above, 0.0]))
        return format_number(float(f"{beyond:.3g}"), self.unit) if beyond > 0.0 else ""

    def describe_limits(self) -> dict[str, str]:
        """Return the names of the band's ends: `low` and `high`, if they exist."""
        names = {}
        for side, end in (("low", self.low), ("high", self.high)):
            known = np.zeros(0) if end is None else end[np.isfinite(end)]
            if end is not None and self.reference is not None:
                names[side] = f"reference {'-' if side == 'low' else '+'} tolerance"
            elif end is not None and (not len(known) or np.ptp(known) > 0.0):
                names[side] = f"{'lower' if side == 'low' else 'upper'} limit, moving"
            elif end is not None:
                names[side] = f"limit {format_number(float(known[0]), self.unit)}"
        return names
