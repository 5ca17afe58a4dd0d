"""Why a run that fails a check is another one than its reference, in three lines at most."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Final

from turtlelog.check.result import CheckResult, JudgedMetric
from turtlelog.check.spec import Check
from turtlelog.errors import ExplainError, TurtlelogError
from turtlelog.explain import Depth, Work, choose_common_metric, explain_difference
from turtlelog.measure import find_metric_kind, list_metrics
from turtlelog.run import Run

LIMIT_S: Final = 10.0
"""The longest that a failed check waits for its reason [s]."""

_LONGEST_S: Final = 600.0
"""Longer runs are not simulated again here [s]: each simulation alone takes a second."""

_DEPTH: Final = Depth(most_exact=6, identifies=False, shows_effects=False, shows_starts=False)

_PREFIX: Final = "metrics."


def add_reason(
    run: Run,
    reference: Run,
    results: Sequence[CheckResult],
    *,
    place: str = "REFERENCE",
    trust_law: bool = False,
    limit_s: float = LIMIT_S,
) -> list[CheckResult]:
    """Return results, one of those that fail with why the run differs from its reference.

    That is the check of the metric that matters most, or else the first that names a metric.

    Args:
        run: That was judged.
        reference: What it was held to, or what was as it should be.
        results: Of the run.
        place: What a command calls the reference.
        trust_law: Run the laws that the recordings name, if they are not built in: their code.
        limit_s: After this time the reason is what to type [s].
    """
    failed = [one for one in results if one.verdict == "FAIL"]
    if not failed:
        return [*results]
    known = list_metrics(run.declaration).keys() & list_metrics(reference.declaration).keys()
    main = choose_common_metric(reference, run)
    named = [(one, name) for one in failed for name in _list_metrics(one) if name in known]
    chosen, metric = min(named or [(failed[0], main)], key=lambda pair: pair[1] != main)
    words = ["turtlelog", "compare", place, chosen.file, "--why", metric]
    more = shlex.join([*words, *(["--trust-law"] if trust_law else [])])
    why = (*_explain(run, reference, metric, limit_s, trust_law=trust_law), f"More: {more}")
    return [replace(one, why=why) if one is chosen else one for one in results]


def _list_metrics(result: CheckResult) -> list[str]:
    """Return the metrics that a check names."""
    names = [result.check.removeprefix(_PREFIX)]
    if isinstance(result.judged, JudgedMetric):
        names.append(result.judged.metric.id)
    if isinstance(result.judged, Check) and result.judged.formula is not None:
        names += result.judged.formula.names
    return [name for name in names if find_metric_kind(name) is not None]


def _explain(
    run: Run, reference: Run, metric: str, limit_s: float, *, trust_law: bool
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
    return found.sentences[:2]


class _Deadline:
    """Ends simulations that would take too long."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s, self._began_s = limit_s, perf_counter()

    def __call__(self, done: int, total: int) -> None:
        if perf_counter() - self._began_s > self._limit_s:
            raise ExplainError(f"{done} of {total} simulations took {self._limit_s:g} s")
