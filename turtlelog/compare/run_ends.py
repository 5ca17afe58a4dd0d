"""How runs ended, in sentences: the distance to the goal, or what was driven without a goal."""

from collections.abc import Sequence

from turtlelog.compare.run_names import name_runs
from turtlelog.compare.run_summary import RunSummary, summarise_run
from turtlelog.display import describe_count, describe_range, format_short
from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.run.ending import find_goal_end


def describe_runs(runs: Sequence[Run]) -> str:
    """Return how a run ended, or for several runs the range of their distances from the goal."""
    names = name_runs(runs)
    if len(runs) == 1:
        measured = measure_run(runs[0], only=_list_needed(runs[0]))
        return f"{names[0]}: {describe_end(summarise_run(runs[0], metrics=measured))}."
    ends = [(find_goal_end(run), name) for run, name in zip(runs, names, strict=True)]
    errors = [(end.error_m, name) for end, name in ends if end is not None]
    if len(errors) == len(runs):
        return f"{len(runs)} runs end {describe_range(errors, 'm')} from the goal."
    lengths = [(run.duration_s, name) for run, name in zip(runs, names, strict=True)]
    return f"{describe_count(len(runs), 'run')} last {describe_range(lengths, 's')}."


def describe_end(summary: RunSummary) -> str:
    """Return place and time of a run's end; without a goal, the length of its path."""

    def show(name: str) -> str | None:
        metric = summary.metrics.get(name)
        if metric is None or metric.value is None:
            return None
        return format_short(metric.value, metric.unit)

    length, off, duration = show(_LENGTH), show(_FURTHEST), show(_DURATION)
    if "poses" in summary.lacks:
        return f"commands for {duration}, no poses"
    if summary.goal_end is not None:
        return summary.goal_end.describe()
    if off is not None and not summary.is_lawless:
        rms = next(map(show, _list_rms(summary)), None)
        sizes = f"{off} at most" if rms is None else f"{rms} RMS, {off} at most"
        return f"cross-track error {sizes}, in {duration}"
    if length is None:
        return f"lasts {duration}"
    return f"the path is {length} long and takes {duration}"


_LENGTH, _FURTHEST, _DURATION = "run.path_length", "run.cross_track_max", "run.duration"


def _list_needed(run: Run) -> list[str]:
    """Return the metrics that the sentence on a run without a goal reads."""
    furthest = [_FURTHEST] if run.path is not None else []
    return [_LENGTH, *furthest, _DURATION, *_list_rms(run)]


def _list_rms(run: Run | RunSummary) -> list[str]:
    """Return the RMS of the first loop that controls the cross-track error, if there is one."""
    loops = [one.name for one in run.declaration.loops if one.signal == "cross_track"]
    return [f"{name}.rms_error" for name in loops[:1]]
