"""The sentences on top of a report: only what is measured, judged or explained."""

from collections.abc import Mapping, Sequence
from typing import Final

from turtlelog.charts.close_up import format_length
from turtlelog.charts.endings import describe_runs
from turtlelog.charts.many_runs import group_equal
from turtlelog.compare import judge_runs, summarise_run
from turtlelog.display import describe_count, join_words
from turtlelog.explain import Attribution, choose_named
from turtlelog.measure import Metric, is_lawless
from turtlelog.run import CUT_SHORT, Run

_MOST_NAMED: Final = 4
"""Runs or checks that a sentence names; of more it says how many there are."""


def conclude(
    runs: Sequence[Run], names: Sequence[str], metrics: Sequence[Mapping[str, Metric]]
) -> list[str]:
    """Return which run ends nearest to its goal and which furthest, which are equal, or cut.

    Runs under different conditions are not ranked; then it returns what differs.
    """
    found = list_misses(runs, metrics)
    sentences = []
    if len(runs) == 1 or not found:
        sentences.append(describe_runs(runs))
    elif len(found) == 1:
        ((number, miss_m),) = found.items()
        sentences.append(f"Only {names[number]} has a goal; it ends {format_length(miss_m)} off.")
    elif found:
        pairs = zip(runs, metrics, strict=True)
        ranking = judge_runs([summarise_run(run, metrics=known) for run, known in pairs])
        ranked = _compare(found, names, of=len(runs))
        why = f"{describe_count(len(runs), 'run')}: {ranking.describe()}."
        sentences.append(ranked if ranking.is_fair else why)
    for group in group_equal(runs):
        if len(group) > 1:
            same = [names[number] for number in group]
            who = join_words(same) if len(same) <= _MOST_NAMED else describe_count(len(same), "run")
            sentences.append(f"{who} are equal in every row.")
    cut = [name for run, name in zip(runs, names, strict=True) if run.stop_reason in CUT_SHORT]
    if cut:
        who = join_words(cut) if len(cut) <= _MOST_NAMED else describe_count(len(cut), "run")
        sentences.append(f"{who} did not come to {'its' if len(cut) == 1 else 'their'} own end.")
    return sentences


def list_misses(runs: Sequence[Run], metrics: Sequence[Mapping[str, Metric]]) -> dict[int, float]:
    """Return the final position error of each run that aims at a goal [m], by its number."""
    found = {}
    for number, (run, known) in enumerate(zip(runs, metrics, strict=True)):
        metric = known.get("final.position_error")
        aims = is_lawless(run) or run.declaration.uses_goal
        if aims and metric is not None and metric.value is not None:
            found[number] = metric.value
    return found


def conclude_checks(verdicts: Sequence[tuple[str, str, str]]) -> str:
    """Return how many checks fail and which, and how many are skipped; empty without checks.

    Args:
        verdicts: Name of the run, of the check, and its verdict.
    """
    judged = [found for found in verdicts if found[2] != "SKIPPED"]
    failed = [f"{check} in {run}" for run, check, verdict in judged if verdict == "FAIL"]
    skipped = len(verdicts) - len(judged)
    rest = f" {describe_count(skipped, 'check')} {'is' if skipped == 1 else 'are'} skipped."
    rest = rest if skipped else ""
    if not judged:
        return rest.strip()
    if not failed:
        whole = "The check passes." if len(verdicts) == 1 else f"All {len(judged)} checks pass."
        verb = "passes" if len(judged) == 1 else "pass"
        return f"{len(judged)} of {len(verdicts)} checks {verb}.{rest}" if skipped else whole
    where = {run for run, _, verdict in judged if verdict == "FAIL"}
    which = f", all in {min(where)}" if len(where) == 1 else ""
    which = f": {join_words(failed)}" if len(failed) <= _MOST_NAMED else which
    verb = "fails" if len(failed) == 1 else "fail"
    return f"{len(failed)} of {describe_count(len(verdicts), 'check')} {verb}{which}.{rest}"


def conclude_cause(name: str, found: Attribution) -> str:
    """Return what causes the value of a run, in the words of `turtlelog explain`; empty if none."""
    if found.withheld or found.without_value or not found.acting:
        return ""
    told = found.sentences[: 3 if choose_named(found) else 2]
    return f"{name}: {' '.join(told)}"


def _compare(found: Mapping[int, float], names: Sequence[str], *, of: int) -> str:
    nearest, furthest = (choose(found, key=lambda number: found[number]) for choose in (min, max))
    runs = f"{of} runs" if len(found) == of else f"the {len(found)} runs with a goal"
    if format_length(found[nearest]) == format_length(found[furthest]):
        return f"Of {runs} each ends {format_length(found[nearest])} from its goal."
    return (
        f"Of {runs} {names[nearest]} ends nearest to its goal ({format_length(found[nearest])}),"
        f" and {names[furthest]} furthest from it ({format_length(found[furthest])})."
    )
