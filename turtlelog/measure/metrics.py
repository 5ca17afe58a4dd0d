"""The metrics of a run by id: the one table that measuring, comparison and checks share."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import wrap_angle
from turtlelog.measure.metric import Metric, Missing, Status
from turtlelog.measure.phases import Response, find_response
from turtlelog.measure.signals import read_signal
from turtlelog.measure.step import find_overshoot, find_settling_time
from turtlelog.run import Phase, Run

SETTLING_BAND: Final = 0.02
"""Half-width of the settling band, as a share of the step."""

PAPER_WINDOW_S: Final = 15.0
"""The paper's Table 1 reads its errors at this time after the first sample [s]."""

Values = NDArray[np.float64]
Result = float | Missing


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricKind:
    """What a metric is.

    Attributes:
        unit: Of its value.
        better: `lower`, `higher`, or None where neither is better.
        meaning: One sentence.
        compute: From a run to the value, or the reason why there is none.
    """

    unit: str
    better: Literal["lower", "higher"] | None
    meaning: str
    compute: Callable[[Run], Result]


def measure_run(run: Run) -> Mapping[str, Metric]:
    """Return every metric of a run by id, in the order of `METRICS`."""
    return {name: _measure(run, name, kind) for name, kind in METRICS.items()}


def _measure(run: Run, name: str, kind: MetricKind) -> Metric:
    result = kind.compute(run)
    if isinstance(result, Missing):
        return Metric(
            id=name, value=None, unit=kind.unit, status=result.status, reason=result.reason
        )
    return Metric(id=name, value=result, unit=kind.unit)


def _compute_duration(response: Response) -> Result:
    return _CUT if response.was_cut else float(response.time_s[-1])


def _compute_overshoot(response: Response) -> Result:
    if response.was_cut or response.reference == response.initial:
        return _CUT if response.was_cut else _NO_STEP
    return 100.0 * find_overshoot(
        response.values, initial=response.initial, reference=response.reference
    )


def _compute_settling_time(response: Response) -> Result:
    if response.reference == response.initial:
        return _NO_STEP
    settled_s = find_settling_time(
        response.time_s,
        response.values,
        initial=response.initial,
        reference=response.reference,
        band=SETTLING_BAND,
    )
    if settled_s is None:
        return Missing(status=Status.NOT_REACHED, reason="the phase ends outside the 2 % band")
    return settled_s


def _compute_final_error(response: Response) -> Result:
    return _CUT if response.was_cut else abs(float(response.values[-1]) - response.reference)


def _compute_final_error_deg(response: Response) -> Result:
    return (
        _CUT if response.was_cut else degrees(abs(float(response.values[-1]) - response.reference))
    )


def _compute_saturated_share(response: Response) -> Result:
    if response.limit is None:
        return Missing(status=Status.ABSENT, reason="the recording does not hold the limit")
    return float(np.mean(np.abs(response.commands) >= response.limit))


def _compute_run_duration(run: Run) -> Result:
    return (run.end_ns - run.start_ns) / 1e9


def _compute_heading_error(run: Run, at_s: float | None) -> Result:
    signal = read_signal(run, "heading")
    if signal is None or not len(run.samples):
        return Missing(status=Status.ABSENT, reason="the recording does not hold the goal bearing")
    time_s = (signal.time_ns - run.start_ns) / 1e9
    return _find_cut(run, at_s) or degrees(
        abs(wrap_angle(float(run.samples.bearing_rad[0] - _read_at(time_s, signal.values, at_s))))
    )


def _compute_position_error(run: Run, at_s: float | None) -> Result:
    if run.goal_xy_m is None:
        return Missing(status=Status.ABSENT, reason="the recording does not hold the goal")
    time_s = (run.poses.time_ns - run.start_ns) / 1e9
    x_m, y_m = (_read_at(time_s, column, at_s) for column in run.poses.xy_m.T)
    return _find_cut(run, at_s) or float(np.hypot(run.goal_xy_m[0] - x_m, run.goal_xy_m[1] - y_m))


def _read_at(time_s: Values, values: Values, at_s: float | None) -> float:
    """Return a value by line between rows, the last row's after the end or where at_s is None."""
    return float(values[-1]) if at_s is None else float(np.interp(at_s, time_s, values))


def _find_cut(run: Run, at_s: float | None) -> Missing | None:
    """A run that has come to its own end holds its last value; one that was cut does not."""
    length_s = (run.end_ns - run.start_ns) / 1e9
    if at_s is None or run.is_complete or length_s >= at_s:
        return None
    return Missing(status=Status.TOO_SHORT, reason=f"the run was cut at {length_s:.2f} s")


def _of_phase(
    phase: Phase, unit: str, compute: Callable[[Response], Result], meaning: str
) -> MetricKind:
    def compute_on_phase(run: Run) -> Result:
        response = find_response(run, phase)
        return response if isinstance(response, Missing) else compute(response)

    return MetricKind(unit=unit, better="lower", meaning=meaning, compute=compute_on_phase)


def _of_run(unit: str, compute: Callable[[Run], Result], meaning: str) -> MetricKind:
    return MetricKind(unit=unit, better="lower", meaning=meaning, compute=compute)


_CUT: Final = Missing(status=Status.TOO_SHORT, reason="the run was cut in this phase")
_NO_STEP: Final = Missing(status=Status.NO_STEP, reason="the phase begins at its reference")

_ROTATE: Final = Phase.ROTATE
_TRANSLATE: Final = Phase.TRANSLATE

METRICS: Final[Mapping[str, MetricKind]] = MappingProxyType(
    {
        "rotate.duration": _of_phase(
            _ROTATE, "s", _compute_duration, "Length of the rotation and the pause after it."
        ),
        "rotate.overshoot": _of_phase(
            _ROTATE,
            "%",
            _compute_overshoot,
            "Furthest heading beyond the goal bearing, of the step; negative where it stays short.",
        ),
        "rotate.settling_time": _of_phase(
            _ROTATE,
            "s",
            _compute_settling_time,
            "Last time the heading enters 2 % of the step around the goal bearing.",
        ),
        "rotate.final_error": _of_phase(
            _ROTATE,
            "deg",
            _compute_final_error_deg,
            "Magnitude of the heading error when translation begins.",
        ),
        "rotate.saturated_share": _of_phase(
            _ROTATE,
            "1",
            _compute_saturated_share,
            "Share of the samples whose turn rate stands at its limit.",
        ),
        "translate.duration": _of_phase(
            _TRANSLATE, "s", _compute_duration, "Length of the translation."
        ),
        "translate.overshoot": _of_phase(
            _TRANSLATE,
            "%",
            _compute_overshoot,
            "Furthest along-track beyond the goal, of the step; negative where it stays short.",
        ),
        "translate.settling_time": _of_phase(
            _TRANSLATE,
            "s",
            _compute_settling_time,
            "Last time along-track enters 2 % of the step around the goal.",
        ),
        "translate.final_error": _of_phase(
            _TRANSLATE,
            "m",
            _compute_final_error,
            "Magnitude of the along-track error at the end.",
        ),
        "translate.saturated_share": _of_phase(
            _TRANSLATE,
            "1",
            _compute_saturated_share,
            "Share of the samples whose speed stands at its limit.",
        ),
        "final.heading_error": _of_run(
            "deg",
            lambda run: _compute_heading_error(run, None),
            "Magnitude of goal bearing minus heading at the end.",
        ),
        "final.position_error": _of_run(
            "m", lambda run: _compute_position_error(run, None), "Distance to the goal at the end."
        ),
        "final.heading_error_at_15s": _of_run(
            "deg",
            lambda run: _compute_heading_error(run, PAPER_WINDOW_S),
            "Heading error 15 s after the first sample, or at the end: the paper's definition.",
        ),
        "final.position_error_at_15s": _of_run(
            "m",
            lambda run: _compute_position_error(run, PAPER_WINDOW_S),
            "Distance to the goal 15 s after the first sample, or at the end: the paper's.",
        ),
        "run.duration": _of_run("s", _compute_run_duration, "From the first sample to the end."),
    }
)
"""Every metric by id."""
