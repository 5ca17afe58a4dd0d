"""The reason why a run that fails a check differs from its reference, in a few lines."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Final

from turtlelog.check.reference import MetricsFile
from turtlelog.check.result import CheckResult, JudgedMetric
from turtlelog.check.spec import Check
from turtlelog.display import describe_count, format_pair
from turtlelog.errors import ExplainError, ScenarioError, TurtlelogError
from turtlelog.explain import Depth, Work, choose_common_metric, explain_difference
from turtlelog.explain.difference_report import write_difference_sentences
from turtlelog.files.text_files import parse_known_toml
from turtlelog.laws import LAWS
from turtlelog.measure import Metric, find_metric_kind, list_metrics, measure_run
from turtlelog.run import Run, describe_changes, list_software_changes
from turtlelog.scenario import Scenario, build_scenario
from turtlelog.simulate import simulate_run

LIMIT_S: Final = 10.0
"""Longest time that a failed check waits for the reason of its failure [s]."""

_LONGEST_S: Final = 600.0
"""Longest run that is simulated again for this reason [s]; longer simulations take more than a
second each."""

_DEPTH: Final = Depth(most_exact=6, identifies=False, shows_effects=False, shows_starts=False)

_PREFIX: Final = "metrics."

_SAME: Final = (1e-9, 1e-6)
"""Difference of a metric between two platforms, absolute and relative, which counts as 0."""


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
        of_reference, main = {*reference.metrics}, choose_common_metric(run, run)
    else:
        of_reference = {*list_metrics(reference.declaration)}
        main = choose_common_metric(reference, run)
    known = of_reference & list_metrics(run.declaration).keys()
    named = [(one, name) for one in failed for name in _list_metrics(one) if name in known]
    chosen, metric = min(named or [(failed[0], main)], key=lambda pair: pair[1] != main)
    if isinstance(reference, MetricsFile):
        more = _write_command("GOOD.mcap", chosen.file, metric, trust_law=trust_law)
        why = _explain_metrics(run, reference, metric, limit_s, more, trust_law=trust_law)
    else:
        more = _write_command(place, chosen.file, metric, trust_law=trust_law)
        why = (*_explain(run, reference, metric, limit_s, trust_law=trust_law), f"More: {more}")
    return [replace(one, why=why) if one is chosen else one for one in results]


def _write_command(reference: str, file: str, metric: str, *, trust_law: bool) -> str:
    words = ["turtlelog", "compare", reference, file, "--why", metric]
    return shlex.join([*words, *(["--trust-law"] if trust_law else [])])


def _list_metrics(result: CheckResult) -> list[str]:
    """Return the metrics in a check."""
    names = [result.check.removeprefix(_PREFIX)]
    if isinstance(result.judged, JudgedMetric):
        names.append(result.judged.metric.id)
    if isinstance(result.judged, Check) and result.judged.formula is not None:
        names += result.judged.formula.names
    return [name for name in names if find_metric_kind(name) is not None]


def _explain(
    run: Run,
    reference: Run,
    metric: str,
    limit_s: float,
    *,
    trust_law: bool,
    are_recorded: bool = True,
) -> tuple[str, ...]:
    lengths_s = [float(one.end_ns - one.poses.time_ns[0]) / 1e9 for one in (reference, run)]
    if max(lengths_s) > _LONGEST_S:
        return (f"Not explained here: a run of {max(lengths_s):.0f} s takes longer.",)
    names = zip((reference, run), ("the reference", "this run"), strict=True)
    try:
        found = explain_difference(
            *(replace(one, name=name) for one, name in names),
            metric=metric,
            trust_law=trust_law,
            depth=_DEPTH,
            work=Work(report=_Deadline(limit_s)),
        )
    except TurtlelogError as err:
        return (f"Not explained: {err}.",)
    return write_difference_sentences(found, are_recorded=are_recorded)[:2]


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
    except TurtlelogError as err:
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
    scenario = _read_scenario(reference, trust_law=trust_law)
    if scenario.law.kind not in LAWS and not trust_law:
        raise ScenarioError(
            f"{scenario.law.kind}, the law in {reference.file}, runs only if its code is trusted"
            " (trust_law=True in pytest)"
        )
    if scenario.max_duration_s > _LONGEST_S:
        raise ScenarioError(
            f"a scenario of up to {scenario.max_duration_s:g} s takes too long here"
        )
    return simulate_run(scenario)


def _read_scenario(reference: MetricsFile, *, trust_law: bool) -> Scenario:
    try:
        tables = parse_known_toml(reference.scenario)
    except ValueError as err:
        raise ScenarioError(f"{reference.file}: scenario: not TOML: {err}") from err
    return build_scenario(tables, source=f"{reference.file}: scenario", trust_law=trust_law)


def _is_same(found: Metric, expected: Metric) -> bool:
    if found.value is None or expected.value is None:
        return found.status == expected.status
    least, part = _SAME
    return abs(found.value - expected.value) <= max(least, part * abs(expected.value))


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


class _Deadline:
    """A time limit that ends simulations."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s, self._began_s = limit_s, perf_counter()

    def __call__(self, done: int, total: int) -> None:
        if perf_counter() - self._began_s > self._limit_s:
            raise ExplainError(f"{done} of {total} simulations took {self._limit_s:g} s")
