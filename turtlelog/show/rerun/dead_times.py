"""The dead time at the start of each phase, during which its commands do not act yet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import rerun as rr

from turtlelog.measure import Metric
from turtlelog.run import Phase, Run
from turtlelog.show.rerun import entities, palette
from turtlelog.show.rerun.run_stream import RunStream


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadSpan:
    """From a phase's first sample until its command acts, in the run's own time [ns]."""

    start_ns: int
    end_ns: int


def list_dead_times(run: Run, metrics: Mapping[str, Metric]) -> tuple[DeadSpan, ...]:
    """Return the dead time at the start of rotation and of translation, where it is known."""
    starts_ns: dict[Phase, int] = {}
    for span in run.find_phase_spans():
        starts_ns.setdefault(span.phase, span.start_ns)
    found = []
    for phase in (Phase.ROTATE, Phase.TRANSLATE):
        metric = metrics.get(f"{phase.label}.dead_time")
        if phase in starts_ns and metric is not None and metric.value:
            end_ns = starts_ns[phase] + round(metric.value * 1e9)
            found.append(DeadSpan(start_ns=starts_ns[phase], end_ns=end_ns))
    return tuple(found)


def draw_dead_times(run_stream: RunStream, spans: Sequence[DeadSpan]) -> None:
    """Draw them as a bar of their own."""
    if not spans:
        return
    style = rr.StateConfiguration(
        values=["dead time"], labels=[" "], colors=palette.pack_colors([palette.SAMPLED])
    )
    run_stream.log(entities.DEAD_TIME, style)
    times_ns = [time_ns for span in spans for time_ns in (span.start_ns, span.end_ns)]
    columns = rr.StateChange.columns(state=["dead time", ""] * len(spans))
    run_stream.send_few(entities.DEAD_TIME, times_ns, columns)
