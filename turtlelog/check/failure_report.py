"""Report of a failed check: text, reason, Rerun view, picture, and the segment of the recording."""

import math
import re
import shlex
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Final

import numpy as np

from turtlelog import errors, explain
from turtlelog.check.formula_trace import find_loss
from turtlelog.check.reference import MetricsFile
from turtlelog.check.result import CheckResult, JudgedMetric
from turtlelog.check.spec import Check
from turtlelog.display import describe_count, format_number, format_pair, show_angle
from turtlelog.escapes import escape_controls
from turtlelog.files.text_files import parse_known_toml
from turtlelog.files.urls import make_path
from turtlelog.laws import LAWS
from turtlelog.log import write_recording
from turtlelog.measure import Metric, Signal, find_signal, list_metrics, list_signals, measure_run
from turtlelog.run import (
    Run,
    SourceKind,
    describe_changes,
    find_source_kind,
    list_software_changes,
    slice_run,
)
from turtlelog.scenario import build_scenario
from turtlelog.simulate import simulate_run

if TYPE_CHECKING:
    from turtlelog.draw.rerun.viewer import Camera

_WIDTH: Final = 92
_MOST: Final = 3


def describe_failure(run: Run, *results: CheckResult) -> list[str]:
    """Return lines: value, limit, margin, first violation with values around it, gains, scenario.

    Only the first violated results of the run are shown in full.
    """
    scenario = _list_scenario(run, results[0])
    return [*describe_results(run, *results), *map(escape_controls, scenario)]


def describe_results(run: Run, *results: CheckResult) -> list[str]:
    """Return the lines of `describe_failure` without recording, gains and scenario."""

    def read_first(result: CheckResult) -> tuple[bool, float]:  # the explained result comes first
        first_s = result.first_violation_s
        return not result.why, math.inf if first_s is None else first_s

    ordered = sorted(results, key=read_first)
    lines: list[str] = []
    for result in ordered[:_MOST]:
        lines += [*_list_figures(result), *_list_violation(run, result)]
    if len(ordered) > _MOST:
        others = ", ".join(result.check for result in ordered[_MOST:])
        lines += textwrap.wrap(f"and {len(ordered) - _MOST} more: {others}", _WIDTH)
    return [escape_controls(line) for line in lines]


def _list_figures(result: CheckResult) -> Iterator[str]:
    name = "" if result.check == result.expected else f"{result.check}: "
    yield f"{name}expected {result.expected}" if result.expected else result.check
    if result.decided_by:
        yield f"  decided by      {result.decided_by}"
    if result.value is not None:
        at = "" if result.value_s is None else f" at {result.value_s:.3f} s"
        yield f"  value           {format_number(result.value, result.unit)}{at}"
    if result.limit is not None:
        yield f"  limit           {format_number(result.limit, result.unit)}"
    if result.margin is not None:
        yield f"  margin          {format_number(result.margin, result.unit)}"
    if result.reason:
        yield f"  reason          {result.reason}"
    for number, text in enumerate(result.why):
        yield from _wrap("" if number else "why", text)


def _wrap(head: str, text: str) -> Iterator[str]:
    lines = textwrap.wrap(text, _WIDTH - 18, break_on_hyphens=False, break_long_words=False)
    yield from (f"  {name:<16}{line}" for name, line in zip_longest([head], lines, fillvalue=""))


def _list_violation(run: Run, result: CheckResult) -> Iterator[str]:
    at_s = result.first_violation_s
    if not result.is_decided:
        return
    if at_s is None:
        yield f"  first violated  no single moment ({describe_clock(run)})"
        return
    yield f"  first violated  {at_s:.3f} s ({describe_clock(run)})"
    yield from (f"    {line}" for line in tabulate_surroundings(run, result.names, at_s))


def _list_scenario(run: Run, result: CheckResult) -> Iterator[str]:
    yield f"  recording       {result.file}"
    parameters = run.parameters
    keys = dict.fromkeys(loop.gain for loop in run.declaration.loops if loop.gain is not None)
    gains = [f"{name} = {parameters[name]}" for name in keys if name in parameters]
    gains = gains or [f"{n} = {v}" for n, v in parameters.items() if n.startswith("law.")]
    if gains or not run.is_lawless:
        yield f"  gains           {', '.join(gains) or 'not recorded'}"
    others = [f"{n} = {v}" for n, v in parameters.items() if n not in (*keys, "name")]
    if run.is_lawless and not others:
        yield f"  source          {run.source}"
        return
    text = ", ".join([run.name, *others]) if others else f"{run.name}, nothing else recorded"
    yield from _wrap("scenario", text)


_ROWS: Final = 2


def describe_clock(run: Run) -> str:
    """Return the meaning of a run's times."""
    is_simulated = find_source_kind(run.source) in {SourceKind.SIMULATION, SourceKind.REPLAY}
    clock = "simulated time" if is_simulated else "the recording's clock"
    return f"{clock}, from the first {run.first_row}"


def tabulate_surroundings(run: Run, names: Sequence[str], at_s: float) -> list[str]:
    """Return lines: the signals at the poses around a time; `>` marks the pose at that time.

    A command published between two poses has a line of its own. Without poses, lines are commands.
    """
    rows = run.poses if len(run.poses) else run.commands
    time_ns, at_ns = rows.time_ns, run.start_ns + round(at_s * 1e9)
    row = max(int(np.searchsorted(time_ns, at_ns, side="right")) - 1, 0)
    times_ns = time_ns[max(row - _ROWS, 0) : row + _ROWS + 1].tolist()
    kinds = list_signals(run.declaration)
    known = [name for name in names if name in kinds]
    signals = {name: one for name in known if (one := find_signal(run, name)) is not None}
    if not signals or len(signals) < len(known):  # one of them is missing
        places = {name: find_signal(run, name) for name in ("x", "y")}
        signals = {name: one for name, one in {**places, **signals}.items() if one is not None}
    marked_ns = int(time_ns[row])
    commanded = [one.time_ns for one in signals.values() if one.kind.source == "command"]
    if at_ns != marked_ns and any(at_ns in published_ns for published_ns in commanded):
        times_ns, marked_ns = sorted({*times_ns, at_ns}), at_ns
    columns = [["", *(">" if found == marked_ns else "" for found in times_ns)]]
    columns.append(["t [s]", *(f"{(found - run.start_ns) / 1e9:.3f}" for found in times_ns)])
    for name, signal in signals.items():
        unit = kinds[name].unit
        title = name if unit == "1" else f"{name} [{show_angle(0.0, unit)[1]}]"
        cells = [_read_value(run, signal, found) for found in times_ns]
        if set(cells) != {"-"}:
            columns.append([title, *cells])
    widths = [max(map(len, column)) for column in columns]
    return [
        "  ".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True)).rstrip()
        for cells in zip(*columns, strict=True)
    ]


def _read_value(run: Run, signal: Signal, time_ns: int) -> str:
    row = int(np.searchsorted(signal.time_ns, time_ns, side="right")) - 1
    if row < 0:
        return "-"
    value = float(signal.values[row])
    if signal.kind.compared_as == "label":
        return run.phase_names[int(value)]
    return format_number(show_angle(value, signal.kind.unit)[0])


_AROUND_S: Final = 1.0
"""Length of the written recording before and after the violation [s]."""
_LONGEST: Final = 60
_SIZE: Final = (1400, 900)


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifacts:
    """Files that were written, and notes on files that could not be written, with reasons."""

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


class ArtifactWriter:
    """Writer of files for the analysis of failures; one viewer makes all pictures.

    The viewer is started for the first picture and ended by `close`, or at the end of a `with`.

    Args:
        folder: Folder of the files, which is created if necessary.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = make_path(folder)
        self._viewer = ExitStack()
        self._camera: Camera | None = None
        self._has_seen, self._lack = False, ""

    def __enter__(self) -> "ArtifactWriter":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the viewer."""
        self._camera = None
        self._viewer.close()

    def write(self, run: Run, result: CheckResult, *, prefix: str = "") -> Artifacts:
        """Write a .rrd that opens at the violation, its picture, and the recording around it.

        If a violation has no time, the files show the end of the run, and the recording is
        complete. A run without poses has nothing to show, which is noted.

        Args:
            run: Run that failed.
            result: Result of the check.
            prefix: Id of the failed test; its end is the start of the files' names.

        Raises:
            CheckError: If the folder cannot be created.
            LogError: If the recording cannot be written.
            ShowError: If the view cannot be written.
        """
        if not len(run.poses):
            note = f"{result.file}: no artifacts of {result.check}: it holds commands without poses"
            return Artifacts(files=(), notes=(note,))
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as err:
            expected = f"expected a folder to write to, found: {err.strerror}"
            raise errors.CheckError(f"{self._folder}: {expected}") from err
        base = self._folder / name_files(result, prefix)
        rrd, png, mcap = (base.with_name(base.name + end) for end in (".rrd", ".png", ".mcap"))
        at_s = result.first_violation_s
        shown_s = (run.end_ns - run.start_ns) / 1e9 if at_s is None else at_s
        part = run
        if at_s is not None:
            start_ns = run.start_ns + round((at_s - _AROUND_S) * 1e9)
            end_ns = start_ns + round(2 * _AROUND_S * 1e9)
            part = slice_run(run, start_ns=start_ns, end_ns=end_ns)
            part = replace(part, scenario_is_complete=False, stop_reason=None)
        write_recording(part, mcap)
        try:
            _write_view(run, result, rrd, at_s=shown_s)
        except errors.LibraryError as err:
            return Artifacts(files=(mcap,), notes=(f"{rrd}: no view: {err}",))
        if self._lack:
            return Artifacts(files=(rrd, mcap), notes=(f"{png}: no picture: {self._lack}",))
        from turtlelog.draw.rerun.viewer import open_camera

        try:
            if self._camera is None:
                self._camera = self._viewer.enter_context(open_camera(size=_SIZE))
            self._camera.take(rrd, png, at_s=shown_s)
        except errors.ShowError as err:
            self._lack = "" if self._has_seen else str(err)  # the same for the next failure
            self.close()
            return Artifacts(files=(rrd, mcap), notes=(f"{png}: no picture: {err}",))
        self._has_seen = True
        return Artifacts(files=(rrd, png, mcap))


def _write_view(run: Run, result: CheckResult, rrd: Path, *, at_s: float) -> None:
    from turtlelog.check.violation import find_violated_signal
    from turtlelog.draw import write_violation_rrd

    found = find_violated_signal(run, result)
    # The scenario has a tab of its own.
    lines = [*describe_results(run, result), escape_controls(f"  recording       {result.file}")]
    if found.signal is None:
        lines += textwrap.wrap(f"no band is drawn: {found.reason}", _WIDTH)
    title = textwrap.shorten(result.check, _LONGEST, placeholder="...")
    message = "\n".join(lines)
    write_violation_rrd(run, rrd, at_s=at_s, title=title, message=message, violated=found.signal)


def name_files(result: CheckResult, prefix: str) -> str:
    """Return a valid name for every file system, unique for every file and check."""
    stem, test = Path(result.file).stem, prefix.rpartition("::")[2]
    words = [test, "" if f"[{stem}]" in test else stem, result.check]
    plain = re.sub(r"[^A-Za-z0-9._]+", "-", "-".join(filter(None, words))).strip("-.")
    key = sha256("\0".join([prefix, result.file, result.check]).encode()).hexdigest()[:6]
    return f"{plain[:_LONGEST]}-{key}"


LIMIT_S: Final = 10.0
"""Longest time that a failed check waits for the reason of its failure [s]."""

_LONGEST_S: Final = 600.0
"""Longest run that is simulated again for this reason [s]; longer ones take over a second each."""

_SAME: Final = (1e-9, 1e-6)
"""Difference of a metric between two platforms, absolute and relative, which counts as 0."""

_NEAR: Final = (0.0, 0.1)
"""Difference between repeated runs of a robot, likewise, as in a first specification."""


def explain_failures(
    run: Run,
    reference: Run | MetricsFile,
    results: Sequence[CheckResult],
    *,
    place: str = "REFERENCE",
    trust_law: bool = False,
    limit_s: float = LIMIT_S,
) -> list[CheckResult]:
    """Return results; one failed result gets the reason why the run differs from its reference.

    This is the result of the most important metric, or else the first result that names a metric.
    The reference may also be a run that is known to be good; the scenario in a file of metrics is
    simulated again. `place` is the name of the reference in the command that replaces the reason
    after the time limit. `trust_law`: whether the code of recorded laws may run.
    """
    failed = [one for one in results if one.verdict == "FAIL"]
    if not failed:
        return [*results]
    if isinstance(reference, MetricsFile):
        of_reference, main = {*reference.metrics}, explain.choose_common_metric(run, run)
        place = "GOOD.mcap"
    else:
        of_reference = {*list_metrics(reference.declaration)}
        main = explain.choose_common_metric(reference, run)
    known = of_reference & list_metrics(run.declaration).keys()
    named = [(one, name) for one in failed for name in _list_names(one) if name in known]
    chosen, metric = min(named or [(failed[0], main)], key=lambda pair: pair[1] != main)
    are_lost = any(isinstance(one, Run) and find_loss(one) for one in (run, reference))
    options = ["--partial"] * are_lost + ["--trust-law"] * trust_law
    more = shlex.join(["turtlelog", "compare", place, chosen.file, "--why", metric, *options])
    if isinstance(reference, MetricsFile):
        why = _explain_metrics(run, reference, metric, limit_s, more, trust_law=trust_law)
    else:
        pair = [measure_run(one, only=[metric])[metric] for one in (run, reference)]
        if not named and run.is_lawless and _is_same(*pair, within=_NEAR):
            why = (f"Not explained: no failed check names a metric, and {metric} hardly differs.",)
        else:
            why = _explain(run, reference, metric, limit_s, trust_law=trust_law)
        why = (*why, f"More: {more}")
    return [replace(one, why=why) if one is chosen else one for one in results]


def _list_names(result: CheckResult) -> list[str]:
    """Return what a check may name: a metric as the table, a metric, or names in a formula."""
    names = [result.check.removeprefix("metrics.")]
    if isinstance(result.judged, JudgedMetric):
        names.append(result.judged.metric.id)
    if isinstance(result.judged, Check):
        names += result.judged.formula.names
    return names


def _explain(
    run: Run,
    reference: Run,
    metric: str,
    limit_s: float,
    *,
    trust_law: bool,
    are_recorded: bool = True,
) -> tuple[str, ...]:
    for who, one in (("the reference", reference), ("this run", run)):
        if not len(one.poses):
            return (f"Not explained: {who} has no poses.",)
    length_s = max(one.end_ns - int(one.poses.time_ns[0]) for one in (reference, run)) / 1e9
    if length_s > _LONGEST_S:
        return (f"Not explained here: a run of {length_s:.0f} s takes longer.",)
    depth = explain.Depth(most_exact=6, identifies=False, shows_effects=False, shows_starts=False)
    began_s = perf_counter()

    def require_time(done: int, total: int) -> None:
        if perf_counter() - began_s > limit_s:
            raise errors.ExplainError(f"{done} of {total} simulations took {limit_s:g} s")

    try:
        found = explain.explain_difference(
            replace(reference, name="the reference"),
            replace(run, name="this run"),
            metric=metric,
            trust_law=trust_law,
            depth=depth,
            work=explain.Work(report=require_time),
        )
    except errors.TurtlelogError as err:
        return (f"Not explained: {err}.",)
    from turtlelog.explain.difference_report import write_difference_sentences, write_side_notes

    sentences = write_difference_sentences(found, are_recorded=are_recorded)[:2]
    return *sentences, *(one for one in write_side_notes(found) if one not in sentences)


def _explain_metrics(
    run: Run, reference: MetricsFile, metric: str, limit_s: float, more: str, *, trust_law: bool
) -> tuple[str, ...]:
    """Return why a run differs from the run of a metrics file, if the file's scenario shows it."""
    file = Path(reference.file).name
    if not reference.scenario:
        return (
            f"Not explained: {file} has no scenario. Accept a good recording anew"
            f" (--turtlelog-accept stores it), or with a good recording: {more}",
        )
    try:
        again = _simulate_again(reference, trust_law=trust_law)
    except errors.TurtlelogError as err:
        return (f"Not explained: {err}.",)
    metrics = measure_run(again, only=[*reference.metrics.keys() & list_metrics(again.declaration)])
    apart = [name for name, one in metrics.items() if not _is_same(one, reference.metrics[name])]
    if apart:
        name = metric if metric in apart else apart[0]
        return _describe_apart(run, again, reference, metrics[name])
    again = replace(again, simulated_by=reference.simulated_by)
    # A file of metrics has no samples that its scenario could reproduce.
    why = _explain(run, again, metric, limit_s, trust_law=trust_law, are_recorded=False)
    count = describe_count(len(metrics), "metric")
    basis = f"The scenario in {file}, simulated again, has the {count} of that file."
    return *why, basis


def _simulate_again(reference: MetricsFile, *, trust_law: bool) -> Run:
    """Return the run of the scenario in a file of metrics, if its length and its law allow this."""
    place = f"{reference.file}: scenario"
    try:
        tables = parse_known_toml(reference.scenario)
    except ValueError as err:
        raise errors.ScenarioError(f"{place}: not TOML: {err}") from err
    scenario = build_scenario(tables, source=place, trust_law=trust_law)
    if scenario.law.kind not in LAWS and not trust_law:
        raise errors.ScenarioError(
            f"{scenario.law.kind}, the law in {reference.file}, runs only if its code is trusted"
            " (trust_law=True in pytest)"
        )
    if scenario.max_duration_s > _LONGEST_S:
        lasts = f"a scenario of up to {scenario.max_duration_s:g} s"
        raise errors.ScenarioError(f"{lasts} takes too long here")
    return simulate_run(scenario)


def _is_same(found: Metric, expected: Metric, *, within: tuple[float, float] = _SAME) -> bool:
    if found.value is None or expected.value is None:
        return found.status == expected.status
    return math.isclose(found.value, expected.value, abs_tol=within[0], rel_tol=within[1])


def _describe_apart(run: Run, again: Run, reference: MetricsFile, found: Metric) -> tuple[str, ...]:
    """Return that the present software does not reproduce a file's values, with the differences."""
    name, file, expected = found.id, Path(reference.file).name, reference.metrics[found.id]
    values = [one.status.value if one.value is None else one.value for one in (expected, found)]
    was, now = format_pair(values[0], values[1], expected.unit)
    lines = [
        f"Not explained: {name} is {was} in {file}, and {now} if its scenario is simulated again."
    ]
    if dict(again.parameters) == dict(run.parameters):
        lines.append("No setting differs between that scenario and this run.")
    changes = list_software_changes(reference.simulated_by, again.simulated_by)
    if changes:
        lines.append(f"The software differs: {describe_changes(changes)}.")
    return tuple(lines)
