"""The dead time at the start of each loop, during which its commands do not act yet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import rerun as rr

from turtlelog.measure import Metric, find_first_stretch
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.run_stream import RunStream


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadSpan:
    """From a loop's first sample until its command acts, in the run's own time [ns]."""

    start_ns: int
    end_ns: int


def list_dead_times(run: Run, metrics: Mapping[str, Metric]) -> tuple[DeadSpan, ...]:
    """Return the dead time at the start of each loop, where it is known, in order of time.

    Of loops that begin together it is the longest.
    """
    ends_ns: dict[int, int] = {}
    for loop in run.declaration.loops:
        metric, stretch = metrics.get(f"{loop.name}.dead_time"), find_first_stretch(run, loop)
        if stretch and metric is not None and metric.value:
            start_ns = stretch[0].start_ns
            end_ns = start_ns + round(metric.value * 1e9)
            ends_ns[start_ns] = max(end_ns, ends_ns.get(start_ns, end_ns))
    return tuple(DeadSpan(start_ns=start, end_ns=end) for start, end in sorted(ends_ns.items()))


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
