"""Ids of metrics, names of states and alignments: what may be written before a run is known."""

import re
from collections.abc import Iterable, Sequence
from typing import Final

from turtlelog.errors import MeasureError
from turtlelog.loops import NAME_PATTERN, RESERVED, STATE_PATTERN, Declaration, is_loop_name
from turtlelog.measure import (
    ANY_LOOP,
    METRICS,
    SIGNALS,
    Metric,
    choose_metrics,
    list_signals,
)

ALIGNMENTS: Final = ("first_sample", "phase:NAME", "recorded", "sample")
"""How runs can be brought together; NAME stands for a phase of their law."""


def could_be_signal(name: str) -> bool:
    """Return whether a name is that of a signal, or could be that of some law's state."""
    return name in SIGNALS or re.fullmatch(STATE_PATTERN, name) is not None


def could_be_alignment(text: str) -> bool:
    """Return whether a text is an alignment, of whatever law the phase is."""
    phase = text.removeprefix("phase:")
    return text in ALIGNMENTS or (phase != text and re.fullmatch(NAME_PATTERN, phase) is not None)


def is_metric_pattern(pattern: str) -> bool:
    """Return whether a name or pattern (`*.overshoot`) stands for metrics of some law."""
    try:
        choose_metrics([pattern], Declaration())
    except MeasureError:
        return False
    return True


def list_ids_like(name: str) -> list[str]:
    """Return the ids that a misspelled one may stand for: those of the loop that it names."""
    loop = name.rpartition(".")[0]
    if loop in RESERVED:
        return [known for known in METRICS if not known.startswith(ANY_LOOP)]
    if not is_loop_name(loop):
        return list(METRICS)
    return [known.replace(ANY_LOOP, loop) for known in METRICS]


def list_names(declarations: Iterable[Declaration]) -> dict[str, str]:
    """Return the units of the signals and states of some laws by name, signals first."""
    return {
        name: kind.unit
        for declaration in declarations
        for name, kind in list_signals(declaration).items()
    }


def order_ids(ids: Iterable[str]) -> tuple[str, ...]:
    """Return ids of several laws, each once: loop by loop, then those of the end and the run."""
    distinct = list(dict.fromkeys(ids))
    loops = list(dict.fromkeys(name.rpartition(".")[0] for name in distinct))
    ranks = {loop: (loop in RESERVED, rank) for rank, loop in enumerate(loops)}
    return tuple(sorted(distinct, key=lambda name: ranks[name.rpartition(".")[0]]))


def list_units(metrics: Sequence[Metric]) -> list[str]:
    """Return the units in which a metric has values; several where loops of one name differ."""
    valued = [metric.unit for metric in metrics if metric.value is not None]
    return list(dict.fromkeys(valued or [metric.unit for metric in metrics][:1]))
