"""The metrics of the phases `rotate` and `translate`: the same table, once for each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees
from types import MappingProxyType
from typing import Final, Literal

from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import Found, Missing, Result, Status
from turtlelog.measure.phases import CommandStretch, Response
from turtlelog.measure.table.commands import (
    compute_effort,
    compute_largest_jump,
    compute_largest_slew_rate,
    compute_largest_wanted,
    compute_longest_saturation,
    compute_reversals,
    compute_saturated_share,
    compute_saturated_time_share,
    compute_total_variation,
)
from turtlelog.measure.table.errors import (
    compute_final_error,
    compute_iae,
    compute_ise,
    compute_itae,
    compute_largest_error,
    compute_rms_error,
    compute_steady_state_error,
)
from turtlelog.measure.table.kinds import MetricKind
from turtlelog.measure.table.steps import (
    compute_crossings,
    compute_decay_ratio,
    compute_delay_time,
    compute_duration,
    compute_overshoot,
    compute_peak,
    compute_peak_time,
    compute_rise_time,
    compute_settling_time,
    compute_undershoot,
)
from turtlelog.measure.table.theories import THEORIES, compute_dead_time, deviate
from turtlelog.measure.table.whole import compute_rms_cross_track, find_largest_cross_track
from turtlelog.run import Phase

Compute = Callable[[Response], Result]

_WORDS: Final = {
    Phase.ROTATE: {"signal": "heading", "goal": "goal bearing", "command": "turn rate"},
    Phase.TRANSLATE: {"signal": "along-track", "goal": "goal", "command": "speed"},
}

_VALUE: Final = ("deg", "m")
_COMMAND: Final = ("rad/s", "m/s")


@dataclass(frozen=True, slots=True, kw_only=True)
class _PhaseKind:
    """A metric before it is known of which phase: `units` are those of rotate and translate."""

    units: tuple[str, str]
    compute: Callable[[RunContext, Response], Result]
    meaning: str
    better: Literal["lower", "higher"] | None = "lower"
    floor: float | None = None

    def bind(self, phase: Phase) -> MetricKind:
        """Return the metric of one phase."""
        unit = self.units[phase is Phase.TRANSLATE]

        def compute(context: RunContext) -> Result:
            response = context.get_response(phase)
            if isinstance(response, Missing):
                return response
            result = self.compute(context, response)
            if unit == "deg" and isinstance(result, Found):
                return Found(degrees(result.value), result.at_s)
            return result

        return MetricKind(
            unit=unit,
            better=self.better,
            meaning=self.meaning.format_map(_WORDS[phase]),
            compute=compute,
            floor=self.floor,
        )


def _plain(
    units: tuple[str, str] | str,
    compute: Compute,
    meaning: str,
    *,
    better: Literal["lower", "higher"] | None = "lower",
    floor: float | None = None,
) -> _PhaseKind:
    return _PhaseKind(
        units=(units, units) if isinstance(units, str) else units,
        compute=lambda _, response: compute(response),
        meaning=meaning,
        better=better,
        floor=floor,
    )


def _whole(compute: Compute) -> Compute:
    """Refuse a phase that was cut: a sum over half of it, or the largest so far, is not its own."""
    return lambda response: _CUT if response.was_cut else compute(response)


def _of_commands(compute: Callable[[CommandStretch], Result]) -> Compute:
    return lambda response: compute(response.commands)


_CUT: Final = Missing(status=Status.TOO_SHORT, reason="the run was cut in this phase")

_STEP_KINDS: Final[Mapping[str, _PhaseKind]] = {
    "duration": _plain("s", _whole(compute_duration), "Length of the phase."),
    "delay_time": _plain(
        "s", compute_delay_time, "Time until the {signal} has come half of the step."
    ),
    "rise_time": _plain(
        "s", compute_rise_time, "Time from 10 % to 90 % of the step, each first reached."
    ),
    "peak": _plain(
        _VALUE,
        _whole(compute_peak),
        "The {signal} where it is furthest in the direction of the step.",
        better=None,
    ),
    "peak_time": _plain(
        "s", _whole(compute_peak_time), "Time until the {signal} is at its peak.", better=None
    ),
    "overshoot": _plain(
        "%",
        _whole(compute_overshoot),
        "Furthest {signal} beyond the {goal}, of the step; negative where it stays short.",
        floor=0.0,
    ),
    "undershoot": _plain(
        "%",
        _whole(compute_undershoot),
        "Furthest {signal} back behind the initial value, of the step; negative where it is never.",
        floor=0.0,
    ),
    "settling_time": _plain(
        "s",
        compute_settling_time,
        "Last time the {signal} enters the band around the {goal}: 2 % of the step, or as asked.",
    ),
    "crossings": _plain(
        "1", _whole(compute_crossings), "How often the {signal} passes the {goal}."
    ),
    "decay_ratio": _plain(
        "1", compute_decay_ratio, "Second overshoot of the {goal} as a share of the first."
    ),
}

_ERROR_KINDS: Final[Mapping[str, _PhaseKind]] = {
    "final_error": _plain(
        _VALUE, _whole(compute_final_error), "Magnitude of the error of the {signal} at the end."
    ),
    "steady_state_error": _plain(
        _VALUE,
        _whole(compute_steady_state_error),
        "What the {signal} lacks of the {goal} at the end, in the direction of the step; negative"
        " beyond.",
        better=None,
    ),
    "largest_error": _plain(
        _VALUE, _whole(compute_largest_error), "Largest magnitude of {goal} minus {signal}."
    ),
    "rms_error": _plain(
        _VALUE, _whole(compute_rms_error), "Root of the mean square over time of that error."
    ),
    "iae": _plain(("rad s", "m s"), _whole(compute_iae), "Integral of the magnitude of the error."),
    "ise": _plain(
        ("rad^2 s", "m^2 s"), _whole(compute_ise), "Integral of the square of the error."
    ),
    "itae": _plain(
        ("rad s^2", "m s^2"),
        _whole(compute_itae),
        "Integral of time in the phase times the magnitude of the error.",
    ),
}

_COMMAND_KINDS: Final[Mapping[str, _PhaseKind]] = {
    "effort": _plain(
        ("rad^2/s", "m^2/s"),
        _whole(_of_commands(compute_effort)),
        "Integral of the square of the {command} as it holds.",
    ),
    "total_variation": _plain(
        _COMMAND,
        _whole(_of_commands(compute_total_variation)),
        "Sum of the magnitudes of all changes of the {command}.",
    ),
    "largest_jump": _plain(
        _COMMAND,
        _whole(_of_commands(compute_largest_jump)),
        "Largest change of the {command} from one sample to the next.",
    ),
    "largest_slew_rate": _plain(
        ("rad/s^2", "m/s^2"),
        _whole(_of_commands(compute_largest_slew_rate)),
        "Largest such change over the time that it took, bursts as one.",
    ),
    "reversals": _plain(
        "1", _whole(_of_commands(compute_reversals)), "How often the {command} changes its sign."
    ),
    "largest_wanted": _plain(
        _COMMAND,
        _whole(_of_commands(compute_largest_wanted)),
        "Largest {command} that the law asked for.",
    ),
    "saturated_share": _plain(
        "1",
        _of_commands(compute_saturated_share),
        "Share of the samples whose {command} stands at its limit.",
    ),
    "saturated_time_share": _plain(
        "1",
        _of_commands(compute_saturated_time_share),
        "Share of the time during which the {command} stands at its limit.",
    ),
    "longest_saturation": _plain(
        "s",
        _whole(_of_commands(compute_longest_saturation)),
        "Longest time for which the {command} stands at its limit without a break.",
    ),
}

_THEORY_KINDS: Final[Mapping[str, _PhaseKind]] = {
    "dead_time": _PhaseKind(
        units=("s", "s"),
        compute=compute_dead_time,
        meaning="Time from reading a pose until its {command} moves the turtle, least of the plant"
        " aside.",
    ),
    **{
        f"{theory}_deviation_{figure}": _PhaseKind(
            units=_VALUE,
            compute=deviate(theory, figure),
            meaning=f"{start} of the {{signal}} from {described} of the same gain.",
        )
        for theory, described in THEORIES.items()
        for figure, start in (("max", "Largest deviation"), ("rms", "RMS deviation"))
    },
}

_KINDS: Final = {**_STEP_KINDS, **_ERROR_KINDS, **_COMMAND_KINDS, **_THEORY_KINDS}

_TRACK_KINDS: Final[Mapping[str, _PhaseKind]] = {
    "cross_track_max": _PhaseKind(
        units=("m", "m"),
        compute=lambda context, response: (
            _CUT if response.was_cut else find_largest_cross_track(context, response.rows)
        ),
        meaning="Largest distance from the line from start to goal, or from the path given.",
    ),
    "cross_track_rms": _PhaseKind(
        units=("m", "m"),
        compute=lambda context, response: (
            _CUT if response.was_cut else compute_rms_cross_track(context, response.rows)
        ),
        meaning="Root of the mean square of that distance over time.",
    ),
}
"""Only of translation: a turtle that turns stays where it is."""

PHASE_METRICS: Final[Mapping[str, MetricKind]] = MappingProxyType(
    {
        f"{phase.label}.{name}": kind.bind(phase)
        for phase, kinds in (
            (Phase.ROTATE, _KINDS),
            (Phase.TRANSLATE, {**_KINDS, **_TRACK_KINDS}),
        )
        for name, kind in kinds.items()
    }
)
"""The metrics of both phases by id."""
