"""Text of `turtlelog metrics`: the end of a run first, then its loops side by side."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Final

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.display import describe_count, describe_range, format_short, join_words

MOST_SAID: Final = 3
"""Largest number of metrics with values in the first line, and of runs whose jumps are listed."""

_PATH: Final = "run.path_length"
_TURNING: Final = "run.total_turning"

_SILENT: Final = 1.5
"""Silence as a multiple of the usual time between samples."""

_OF_WORDS: Final = ("stable", "sample_period_p50")
"""Metrics that are used only in sentences."""

_ORDER: Final = (
    *("settling_time", "overshoot", "rise_time", "rms_error", "largest_error", "final_error"),
    *("lag", "corner_overshoot", "dead_time", "saturated_share", "iae", "duration"),
)
_IDLE: Final = ("dead_time", "saturated_share")
"""Rows that are left out if all values are 0."""

_WORDS: Final = {
    "iae": "IAE",
    "rms_error": "RMS error",
    "final_error": "final loop error",
    "saturated_share": "saturated samples",
    "cross_track_max": "largest cross-track error",
    "cross_track_rms": "RMS cross-track error",
    "measured_speed_max": "largest measured speed",
    "measured_turn_rate_max": "largest measured turn rate",
    "speed_tracking_rms": "RMS error of the speed",
    "turn_rate_tracking_rms": "RMS error of the turn rate",
    "rest_share": "share of the time at rest",
    "largest_gap": "longest time without a sample",
    "largest_pose_gap": "longest time without a pose",
    "tilt_max": "largest tilt",
    "lag": "time lag",
}


def list_summary_metrics(run: "tl.Run", *, has_path: bool) -> tuple[str, ...]:
    """Return the ids of the metrics in the short answer for a run."""
    essential = tl.measure.list_essential_metrics(run)
    path = ["run.cross_track_max"] if has_path else []
    return tuple(dict.fromkeys([*essential, *path, *_list_of_words(run.declaration)]))


@lru_cache(maxsize=16)
def _list_of_words(declaration: "tl.Declaration") -> tuple[str, ...]:
    """Return the metrics of the sentences of an answer, for one law."""
    known = tl.measure.list_metrics(declaration)
    return tuple(name for name in known if name.rpartition(".")[2] in _OF_WORDS)


def drop_words(summary: "tl.compare.RunSummary") -> "tl.compare.RunSummary":
    """Return a summary without the metrics that are used only in sentences."""
    found = summary.metrics
    kept = {name: found[name] for name in found if name.rpartition(".")[2] not in _OF_WORDS}
    return replace(summary, metrics=kept)


def tell_range(summaries: "Sequence[tl.compare.RunSummary]", name: str) -> str:
    """Return the value of one run; for several, the smallest and largest values with their runs."""
    found = {one.name: one.metrics[name] for one in summaries if name in one.metrics}
    values = [(metric.value, who) for who, metric in found.items() if metric.value is not None]
    if not values:
        reasons = dict.fromkeys(one.status.words for one in found.values())
        return f"has no value ({', '.join(reasons)})"
    units = tl.compare.list_metric_units([*found.values()])
    if len(units) > 1:
        return f"is in {join_words(units)}"
    text, lacking = describe_range(values, units[0]), len(found) - len(values)
    return f"{text.removesuffix(' (all)')} ({lacking} without a value)" if lacking else text


def find_value(summary: "tl.compare.RunSummary", name: str) -> float | None:
    """Return the value of a metric; None without a value."""
    metric = summary.metrics.get(name)
    return None if metric is None else metric.value


def format_run(
    summary: "tl.compare.RunSummary",
    who: str,
    *,
    facts: Sequence[str] = (),
    reading: Sequence[str] = (),
) -> str:
    """Return the end of a run, remarks, and its loops side by side.

    The summary needs the metrics of `list_summary_metrics`; its file is empty if there is none.
    """
    essential = drop_words(summary).metrics
    head = [f"{who}: {tl.compare.describe_end(summary)}.", *facts, *_list_place(summary)]
    loops = [loop.name for loop in summary.declaration.loops]
    known = {name for name, one in summary.metrics.items() if one.value is not None}
    shown = [loop for loop in loops if any(f"{loop}.{word}" in known for word in _ORDER)]
    remarks = _list_remarks(summary, loops, shown)
    count = len(tl.measure.list_metrics(summary.declaration))
    if shown:
        table, said = _tabulate_loops(summary, shown), _describe_rest(summary)
    else:
        names = tl.compare.drop_absent([summary], [*filter(_is_of_run, essential)])
        found = {name: essential[name] for name in names}
        # Without samples, there are commands.
        noun = "command" if summary.is_lawless else "sample"
        rows = ((_name_metric(name).replace("sample", noun), _show(found[name])) for name in found)
        table = console.build_table("", ("metric", "value"), rows, tl.compare.list_reasons([found]))
        said = []
    notes = [
        *(*said, *_list_since(summary), *list_jumps([summary], summary.metrics)),
        *(*_list_rates([summary]), *_list_travel(summary), *tl.compare.list_unlocks([summary])),
    ]
    return "\n".join(
        [
            console.fill_lines([*head, *remarks, *_list_why(summary, reading)]),
            console.fit_body(table),
            "",
            *([console.fill_lines(notes, indent=2)] if notes else []),
            *_list_next(summary, count, reading),
        ]
    )


def _list_place(summary: "tl.compare.RunSummary") -> Iterator[str]:
    """Yield the place of a missed end, and the final heading error."""
    end = summary.goal_end
    if end is not None and end.is_away and (place := end.describe_place()):
        yield place
    heading = summary.metrics.get("final.heading_error")
    if heading is not None and heading.value is not None and end is not None:
        yield f"Final heading error: {_show(heading)}."
    if "wall" in summary.notes:
        yield summary.notes["wall"]


def _list_why(summary: "tl.compare.RunSummary", reading: Sequence[str]) -> Iterator[str]:
    if summary.goal_end is not None and summary.goal_end.is_away:
        command = console.name_explain(summary.file or "FILE.mcap", summary.law, reading)
        yield f"Why? {'' if summary.file else 'Record the run with -o FILE.mcap, then: '}{command}"


def _list_remarks(
    summary: "tl.compare.RunSummary", loops: Sequence[str], shown: Sequence[str]
) -> Iterator[str]:
    """Yield which loops oscillate, do not settle, or have no values, and motion to the side."""
    if "sideways" in summary.notes:
        yield f"The robot is {summary.notes['sideways']}. Speeds are those ahead or back."
    restless = [loop for loop in shown if find_value(summary, f"{loop}.stable") == 0.0]
    if restless:
        yield f"The oscillation does not die out: {join_words(restless)}."
    stable = {loop: summary.metrics.get(f"{loop}.stable") for loop in shown}
    reason = tl.measure.step_response.IRREGULAR_SWINGS
    kicked = [loop for loop, one in stable.items() if one is not None and one.reason == reason]
    if kicked:
        words = "Irregular swings, which hide whether the loop is stable"
        yield f"{words}: {join_words(kicked)}."
    for loop in shown:
        yield from _list_unsettled(summary, loop)
    for loop in (loop for loop in loops if loop not in shown):
        of_loop = [one for name, one in summary.metrics.items() if name.startswith(f"{loop}.")]
        if of_loop:
            yield f"{loop} has no values: {of_loop[0].reason}."


def _list_unsettled(summary: "tl.compare.RunSummary", loop: str) -> Iterator[str]:
    """Yield that a loop does not settle, and that its error is another one than the heading's."""
    metric = summary.metrics.get(f"{loop}.settling_time")
    if metric is None or metric.status is not tl.measure.Status.NOT_REACHED:
        return
    yield f"{loop} does not settle: {metric.reason}."
    if any(
        one.name == loop and one.reference == "bearing_now" for one in summary.declaration.loops
    ):
        yield (
            f"{loop} follows a bearing that moves with the robot: its final loop error is not the"
            " final heading error."
        )


def _name_metric(name: str) -> str:
    word = name.rpartition(".")[2]
    return _WORDS.get(word, word.replace("_", " "))


def _show(metric: "tl.Metric | None") -> str:
    if metric is None:
        return "-"
    if metric.value is None:
        return metric.status.words
    kind = tl.measure.find_metric_kind(metric.id)
    if kind is not None and kind.nature == "share":
        return f"{100.0 * metric.value:.0f} %"
    return format_short(metric.value, metric.unit)


def _tabulate_loops(summary: "tl.compare.RunSummary", loops: Sequence[str]) -> "tl.compare.Table":
    found = {word: [summary.metrics.get(f"{loop}.{word}") for loop in loops] for word in _ORDER}
    rows = {
        word: metrics
        for word, metrics in found.items()
        if any(one is not None for one in metrics)
        and not (word in _IDLE and all(one is None or one.value == 0.0 for one in metrics))
    }
    cells = ((_name_metric(word), *map(_show, metrics)) for word, metrics in rows.items())
    shown = {one.id: one for metrics in rows.values() for one in metrics if one is not None}
    return console.build_table("", ("", *loops), cells, tl.compare.list_reasons([shown]))


def _describe_rest(summary: "tl.compare.RunSummary") -> list[str]:
    names = (_PATH, "run.cross_track_max", "run.speed_effort", "run.turn_rate_effort")
    said = [
        f"{_name_metric(name)} {_show(summary.metrics[name])}"
        for name in names
        if find_value(summary, name) is not None
    ]
    gap, usual = (find_value(summary, f"run.{one}") for one in ("largest_gap", _OF_WORDS[1]))
    if gap is not None and usual and gap > _SILENT * usual and not summary.is_lawless:
        said.append(f"longest silence of the controller {format_short(gap, 's')}")
    return [f"{', '.join(said).capitalize()}."] if said else []


def _is_of_run(name: str) -> bool:
    return name.partition(".")[0] in {"final", "run"}


def _list_next(summary: "tl.compare.RunSummary", count: int, reading: Sequence[str]) -> list[str]:
    is_told = any(_list_why(summary, reading))
    if not summary.file:
        return [] if is_told else ["To explain, plot or compare this run, record it: -o FILE.mcap"]
    file = console.quote_file(summary.file, *reading)
    more = f"All {count} metrics with their ids: turtlelog metrics {file} --all"
    goalless = (word for word in reading if not word.startswith("--goal="))
    robot = console.quote_file(summary.file, *goalless)  # these commands take no goal
    if is_told:
        return [more]
    if not summary.is_lawless:
        return [f"Why? {console.name_explain(summary.file, summary.law, reading)}", more]
    if "poses" in summary.lacks:
        return [f"Where they lead: turtlelog replay {robot}", more]
    if "commands" not in summary.lacks:
        return [f"Dead time and time constants: turtlelog identify {robot}", more]
    return [more]


def _list_since(summary: "tl.compare.RunSummary") -> Iterator[str]:
    """Yield from when on the goal and the path of a bag count."""
    if "counts_since" in summary.notes:
        yield (
            "The time to the goal and the cross-track errors count from then on:"
            f" {summary.notes['counts_since']}."
        )


def _list_rates(summaries: "Sequence[tl.compare.RunSummary]") -> Iterator[str]:
    """Yield the sources of measured rates in bags, and their resolution."""
    lawless = [found for found in summaries if found.is_lawless and "poses" not in found.lacks]
    reporting = sum(one.reports_rate for one in lawless)
    if reporting and reporting == len(lawless):
        doubted = any(_RATE_DOUBTS & {*one.notes} and not _is_still(one) for one in lawless)
        doubt = ", and the poses contradict them" if doubted else ""
        other = "".join(dict.fromkeys(one.notes.get("differenced", "") for one in lawless))
        yield f"Measured rates are those that the robot reports{doubt}{other}."
    elif lawless:
        which = "" if not reporting else " where the robot reports none"
        sizes = [one.notes["rate_noise"] for one in lawless if "rate_noise" in one.notes]
        noise = ", and contain their noise" if sizes else ""
        size = f": about {sizes[0]}" if sizes and len(lawless) == 1 else ""
        yield f"Measured rates are differences of poses{which}{noise}{size}."
    yield from list_resolutions(summaries)


def list_resolutions(summaries: "Sequence[tl.compare.RunSummary]") -> list[str]:
    """Return the sentence on the steps of measured rates, if they are known."""
    steps = dict.fromkeys(one.notes["rate_step"] for one in summaries if "rate_step" in one.notes)
    if not steps:
        return []
    apart = f"Measured rates are {join_words([*steps])} apart"
    if any("silences" in one.notes for one in summaries):
        return [f"{apart}."]
    if any("short_rises" in one.notes for one in summaries):
        return [f"{apart}: lags are known to half of it."]
    return [f"{apart}: lags are known to half of it, rise times to twice it."]


def _is_still(summary: "tl.compare.RunSummary") -> bool:
    """Return whether neither the poses nor the reported speed show motion."""
    return all(find_value(summary, name) == 0.0 for name in (_PATH, "run.measured_speed_max"))


_RATE_DOUBTS: Final = frozenset({"path_by_speed", "turning_by_rate"})
"""Notes on reported rates that the poses contradict."""


def _list_travel(summary: "tl.compare.RunSummary") -> Iterator[str]:
    """Yield the sentence on a robot whose speeds are measured at an angle to its way."""
    if "travel" in summary.notes:
        told = summary.notes["travel"]
        own = "" if "rates" in summary.lacks else " (the reported speed is the robot's own)"
        yield f"{told[0].upper()}{told[1:]}{own}."


def list_jumps(summaries: "Sequence[tl.compare.RunSummary]", shown: Collection[str]) -> list[str]:
    """Return sentences on gaps, and on path lengths that contain jumps or scatter of the poses."""
    if _PATH not in shown:
        return []
    told: list[list[str]] = []
    for one in summaries:
        which = "" if len(summaries) == 1 else f" of {one.name}"
        # The remarks on a single run say that it moves to the side.
        names = (name for name in _OF_MOTION if which or name != "sideways")
        said = [*list_motion(one, which, names), *list_scatter(one, which, shown)]
        told.extend([said] if said else [])
    first = [sentence for said in told[:MOST_SAID] for sentence in said]
    if len(told) > MOST_SAID:
        more = describe_count(len(told) - MOST_SAID, "more run")
        first.append(f"Gaps, jumps or steps are in {more}, too.")
    return first


_OF_MOTION: Final = {
    "jumps": "The path length{which} counts as driven: {note}.",
    "sideways": "Speeds{which} leave out motion to the side: {note}.",
    "unsigned": "Reported speeds{which} have no sign: {note}.",
    "changes": "Most positions{which} repeat the one before: they change at {note}.",
    "resolution": "Poses{which} have a resolution of {note}: smaller jumps are hidden, and lags are"
    " less certain.",
    "leads": "The motion{which} leads the commands by {note}: they were recorded late, or their"
    " clock differs from that of the poses.",
    "silences": "Lags and rise times{which} leave out {note}, in which the robot stops by itself:"
    " they may be too small.",
    "short_rises": "Rise times{which} are too small, {note}: steps end before the robot has"
    " settled, or noise passes 90 % early.",
    "crept": "Rest{which}, judged over half a second, includes {note} of slow or brief motion.",
    "gaps": "Rates and rest{which} leave out {note} without poses; the path length counts a"
    " straight line there.",
}
"""Sentences by the notes of a run that they repeat."""


def list_motion(
    summary: "tl.compare.RunSummary", which: str, names: Iterable[str]
) -> Iterator[str]:
    """Yield the sentences of some notes on the motion of a run, if it has them."""
    for name in names:
        if name in summary.notes:
            yield _OF_MOTION[name].format(which=which, note=summary.notes[name])


def list_scatter(
    summary: "tl.compare.RunSummary", which: str, shown: Collection[str]
) -> Iterator[str]:
    """Yield the sentence on steps back and forth, and what is left without them."""
    path = summary.notes.get("path_without_scatter")
    turning = summary.notes.get("turning_without_scatter") if _TURNING in shown else None
    found = {"path length": path, "total turning": turning}
    left = {name: length for name, length in found.items() if length is not None}
    if left:
        yield (
            f"The {join_words([*left])}{which} {'counts' if len(left) == 1 else 'count'} steps"
            " back and forth between poses, as from noise; through the median pose of each second:"
            f" {join_words([*left.values()])}."
        )


def format_runs(summaries: "Sequence[tl.compare.RunSummary]") -> str:
    """Return the range of the runs' ends, and a row for each run."""
    summaries, notes = tl.compare.shorten_names(tl.compare.order_by_gain(summaries))
    table, shown = _tabulate_runs(summaries)
    reasons = tl.compare.list_reasons(
        {name: one.metrics[name] for name in shown if name in one.metrics} for one in summaries
    )
    jumps, rates = list_jumps(summaries, shown), _list_rates(summaries)
    told = (*reasons, *notes, *jumps, *rates, *tl.compare.list_unlocks(summaries))
    table = replace(table, notes=told)
    count = len(tl.measure.list_metrics(*(found.declaration for found in summaries)))
    head = f"{describe_count(len(summaries), 'run')}: {_describe_ends(summaries)}."
    following = f"Which is best? turtlelog compare      All {count} metrics: --all, or --metric IDS"
    return "\n".join([console.fill_lines([head]), console.fit_body(table), "", following])


_OF_ROW: Final = ("settling_time", "overshoot", "rms_error")


def _tabulate_runs(
    summaries: "Sequence[tl.compare.RunSummary]",
) -> "tuple[tl.compare.Table, list[str]]":
    """Return a row for each run, with the metrics that fit a line, and the ids of these metrics."""
    chosen = _choose_columns(summaries)
    table = tl.tabulate_runs(summaries, only=chosen)
    table = replace(table, rows=tuple(tuple(map(_round, row)) for row in table.rows), marks={})
    order = sorted(chosen, key=lambda name: _rank(name, summaries))
    titles = [column.title for column in table.columns]
    ranks = [order.index(title) if title in order else None for title in titles]
    narrow = tl.compare.narrow_table(table, console.find_width(), ranks)
    kept = {column.title for column in narrow.columns}
    return narrow, [name for name in chosen if name in kept]


def _round(cell: "tl.compare.Cell") -> "tl.compare.Cell":
    return float(f"{cell:.3g}") if isinstance(cell, float) else cell


def _rank(name: str, summaries: "Sequence[tl.compare.RunSummary]") -> tuple[bool, int, bool]:
    """Return a sort key for choosing metrics: the end first, then metrics of most runs."""
    lacking = sum(find_value(one, name) is None for one in summaries)
    is_end = name in {"final.position_error", "run.duration"}
    kind = tl.measure.find_metric_kind(name)
    return not is_end, lacking, kind is None or not kind.is_awaited


def _choose_columns(summaries: "Sequence[tl.compare.RunSummary]") -> tuple[str, ...]:
    """Return the metrics that a row may show: responses of loops, end and duration."""
    names = dict.fromkeys(name for found in summaries for name in found.metrics)
    of_loops = [
        name for name in names if name.rpartition(".")[2] in _OF_ROW and not _is_of_run(name)
    ]
    of_run = [name for one in summaries for name in tl.compare.list_usual_of_run(one)]
    kept = [name for name in of_run if _is_of_run(name) and name in names]
    declarations = [found.declaration for found in summaries]
    return tl.compare.drop_absent(summaries, tl.compare.order_ids([*of_loops, *kept], declarations))


def _describe_ends(summaries: "Sequence[tl.compare.RunSummary]") -> str:
    ends = [one.goal_end for one in summaries if one.goal_end is not None]
    lasting = f"after {tell_range(summaries, 'run.duration')}"
    errors = [find_value(one, "final.position_error") for one in summaries]
    if len(ends) == len(summaries) and None not in errors:
        far = tell_range(summaries, "final.position_error")
        told = [tl.compare.describe_reached(summaries), f"the ends are {far} from the goal"]
        return f"{'; '.join(filter(None, told))}, {lasting}"
    return f"they last {tell_range(summaries, 'run.duration')}"
