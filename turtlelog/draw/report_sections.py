"""The text parts of a report: conclusions, tables, steps of an attribution, checks, provenance."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Final

from turtlelog.charts.attribution_steps import draw_up_attribution
from turtlelog.charts.close_up import format_length
from turtlelog.charts.curve_marks import ViolatedSignal
from turtlelog.charts.many_runs import group_equal
from turtlelog.charts.palette import to_hex
from turtlelog.compare import Table, format_cell, judge_runs, summarise_run
from turtlelog.compare.ranking import name_few
from turtlelog.compare.run_selection import describe_runs, list_differing
from turtlelog.display import describe_count, join_words
from turtlelog.draw.report_drawing import MOST_VIOLATIONS
from turtlelog.escapes import escape_controls
from turtlelog.explain import Attribution, choose_leading, choose_named, write_sentences
from turtlelog.log.read_choice import label_note
from turtlelog.measure import Metric, describe_source
from turtlelog.run import CUT_SHORT, Run
from turtlelog.run.stop_reasons import MAX_DURATION

_MOST_DIFFERING: Final = 8  # keys in a table of differences; more keys would be wider than a page
_LEAST_PERCENT: Final = 0.4  # smallest visible width of a bar [% of the width]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckLine:
    """The result of a check, as text."""

    run: str  # name of the run, or of a file that could not be read
    check: str  # name of the check
    verdict: str  # `PASS`, `FAIL` or `SKIPPED`
    value: str = ""  # measured value with its unit; empty without a value
    limit: str = ""  # limit with its unit; empty without a limit
    margin: str = ""  # margin with its unit; empty without a margin
    expected: str = ""  # expectation, as written
    first_violation_s: float | None = None  # first violation [s]; None if it has no time
    reason: str = ""  # why the check fails or is skipped, if values do not show it
    names: tuple[str, ...] = ()  # names of the signals in the check
    signal: ViolatedSignal | None = None  # violated signal with its band; None without violation


def show(text: object) -> str:
    """Return any text as HTML that shows it literally."""
    return escape(escape_controls(str(text)))


def write_table(table: Table) -> str:
    """Return a table with its notes. Words mark the best and the worst values of a column."""
    heads = [show(f"{one.title} [{one.unit}]" if one.unit else one.title) for one in table.columns]
    rows = []
    for row, cells in enumerate(table.rows):
        parts = []
        for column, cell in enumerate(cells):
            mark = table.marks.get((row, column))
            text = show(format_cell(cell, table.columns[column]))
            kind = ' class="number"' if isinstance(cell, int | float) else ""
            text += f' <small class="{mark}">{mark}</small>' if mark else ""
            parts.append(f"<td{kind}>{text}</td>" if column else f'<th scope="row">{text}</th>')
        rows.append(f"<tr>{''.join(parts)}</tr>")
    notes = "".join(f'<p class="note">{show(note)}</p>' for note in table.notes)
    return _wrap_table(table.title, heads, rows) + notes


def write_attribution(name: str, found: Attribution) -> str:
    """Return the steps from the logged value to the remaining one, and their basis."""
    waterfall = draw_up_attribution(found)
    sentences = "".join(f"<li>{show(text)}</li>" for text in write_sentences(found))
    bars = ""
    if waterfall.steps:
        low, high = waterfall.span
        span = (high - low) or 1.0
        parts = []
        for step in waterfall.steps:
            first, last = sorted((step.start, step.end))
            left = 100.0 * (first - low) / span
            width = max(100.0 * (last - first) / span, _LEAST_PERCENT)
            style = f"left:{left:.3f}%;width:{width:.3f}%;background:{to_hex(step.color)}"
            parts.append(
                f'<div class="step"><span class="what">{show(step.name)}</span>'
                f'<span class="bar"><i style="{style}"></i></span>'
                f'<span class="size">{show(step.text)}</span></div>'
            )
        notes = "".join(f'<p class="note">{show(note)}</p>' for note in waterfall.notes)
        bars = f'<div class="steps">{"".join(parts)}</div>{notes}'
    head = f"<h2>What caused {show(found.metric)} of {show(name)}</h2>"
    return f'<section id="cause">{head}{bars}<ul>{sentences}</ul></section>'


def write_notes(runs: Sequence[Run], names: Sequence[str]) -> str:
    """Return the notes on the data of the runs, as `info` shows them; empty without notes."""
    whose: dict[str, list[str]] = {}
    for run, name in zip(runs, names, strict=True):
        for note, text in describe_source(run).items():
            whose.setdefault(f"{label_note(note)}: {text}", []).append(name)
    lines = [f"{name_few(of)}: {text}" if len(runs) > 1 else text for text, of in whose.items()]
    told = "".join(f'<p class="note">{show(line)}</p>' for line in lines)
    return f'<section id="notes">{told}</section>' if told else ""


def write_checks(lines: Sequence[CheckLine]) -> str:
    """Return the checks as a table, failed checks first, each with its first violation."""
    heads = ["verdict", "run", "check", "value", "limit", "margin", "first violated", "why"]
    order = sorted(lines, key=lambda line: line.verdict != "FAIL")
    rows = []
    for line in order:
        at = "" if line.first_violation_s is None else f"{line.first_violation_s:.3f} s"
        why = line.reason or (f"expected {line.expected}" if line.expected else "")
        texts = (line.run, line.check, line.value, line.limit, line.margin, at, why)
        cells = "".join(f"<td>{show(text)}</td>" for text in texts)
        rows.append(f'<tr><td class="{show(line.verdict)}">{show(line.verdict)}</td>{cells}</tr>')
    marks = (
        '<p class="note">Dotted red lines in the plots stand where checks are first violated.</p>'
        if any(line.first_violation_s is not None for line in lines)
        else ""
    )
    table = _wrap_table("Checks; times from the first sample", heads, rows)
    return f'<section id="checks"><h2>Checks</h2>{table}{marks}{_place_violations(order)}</section>'


def _place_violations(lines: Sequence[CheckLine]) -> str:
    """Return the places of the plots of failed checks, each with a description."""
    failed = [line for line in lines if line.verdict == "FAIL"]
    drawn = [(line, line.signal) for line in failed if line.signal is not None][:MOST_VIOLATIONS]
    parts = []
    for number, (line, signal) in enumerate(drawn):
        moments = [signal.describe_moment(signal.worst, signal.worst_word)]
        if signal.first != signal.worst:
            moments.insert(0, signal.describe_moment(signal.first, "first"))
        parts.append(
            f"<div><h3>{show(line.check)} in {show(line.run)}</h3>"
            f'<p class="note">expected {show(line.expected)}; {show("; ".join(moments))}</p>'
            f'<div class="plot" id="violation-{number}"></div></div>'
        )
    left = len(failed) - len(drawn)
    note = f'<p class="note">{describe_count(left, "more failed check")} without a plot.</p>'
    places = f'<div class="series">{"".join(parts)}</div>' if parts else ""
    return places + (note if left and drawn else "")


def write_page(title: str, kind: str, body: str, *, policy: str, style: str = "") -> str:
    """Return a page with a heading, which is also the title of the window after its kind.

    The policy is a tag by `write_policy_tag`; the style rules add to those of all pages.
    """
    common = files("turtlelog.draw").joinpath("report.css").read_text("utf-8")
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">{policy}
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">
<title>{show(title)}: turtlelog {kind}</title><style>{common}{style}</style></head>
<body><header><h1>{show(title)}</h1></header>{body}</body></html>
"""


def wrap_provenance(versions: str, command: str, rest: str) -> str:
    """Return the section on programs, the command if known, and files in `rest` as HTML."""
    written = f"<p>Written by:</p><pre><code>{show(command)}</code></pre>" if command else ""
    parts = f"<p>{show(versions)}.</p>{written}{rest}"
    return f'<section id="provenance"><h2>Where this comes from</h2>{parts}</section>'


def write_provenance(
    runs: Sequence[Run],
    names: Sequence[str],
    sources: Sequence[tuple[str, str]],
    versions: Iterable[str],
    command: str,
) -> str:
    """Return the report's provenance: programs, command, file and sha256 of each run if known."""
    rows = [
        f'<tr><th scope="row">{show(name)}</th><td>{show(file)}</td><td><code>{show(key)}</code>'
        f"</td><td>{show(run.source)}</td></tr>"
        for run, name, (file, key) in zip(runs, names, sources, strict=True)
    ]
    rest = _wrap_table("Recordings", ["run", "file", "sha256", "source"], rows)
    if len(runs) == 1:
        rest += f"<details><summary>Scenario</summary>{_list_scenario(runs[0])}</details>"
    else:
        rest += _write_differences(runs, names)
    return wrap_provenance(", ".join(versions), command, rest)


def _write_differences(runs: Sequence[Run], names: Sequence[str]) -> str:
    """Return a table of the keys in which scenarios differ, with links to complete scenarios."""
    keys = list_differing(runs)[:_MOST_DIFFERING]
    rows = [
        f'<tr><th scope="row">{show(name)}</th>'
        + "".join(f"<td>{show(run.parameters.get(key, ''))}</td>" for key in keys)
        + "</tr>"
        for run, name in zip(runs, names, strict=True)
    ]
    table = _wrap_table("What differs between the scenarios", ["run", *keys], rows) if keys else ""
    note = "Whole scenarios: <code>turtlelog scenario FILE</code>."
    return f'{table}<p class="note">{note}</p>'


def _list_scenario(run: Run) -> str:
    known: list[tuple[str, object]] = [*run.parameters.items()]
    known += [(f"note {name}", text) for name, text in run.notes.items()]
    known += [("not recorded", ", ".join(run.absent))] if run.absent else []
    rows = [
        f'<tr><th scope="row">{show(key)}</th><td>{show(value)}</td></tr>' for key, value in known
    ]
    return _wrap_table("", ["key", "value"], rows) if rows else "<p>None is recorded.</p>"


_MOST_SEEN: Final = 15
"""Rows that fit into a table's box of 30 rem (report.css); more rows scroll in the box."""


def _wrap_table(title: str, heads: Sequence[str], rows: Sequence[str]) -> str:
    """Return a table that scrolls on its own in a narrow window; the titles are HTML."""
    count = f"{len(rows)} rows" if len(rows) > _MOST_SEEN else ""
    told = ", ".join(filter(None, [show(title), count]))
    caption = f"<caption>{told}</caption>" if told else ""
    head = "".join(f'<th scope="col">{text}</th>' for text in heads)
    label = f' aria-label="{show(title)}"' if title else ""
    return (
        f'<div class="wide" tabindex="0" role="region"{label}><table>{caption}<thead><tr>{head}'
        f"</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


_MOST_NAMED: Final = 4  # runs or checks that a sentence names; of more, it gives the number


def conclude_runs(
    runs: Sequence[Run], names: Sequence[str], metrics: Sequence[Mapping[str, Metric]]
) -> list[str]:
    """Return sentences on the runs that end nearest and furthest, and on equal or cut-off runs.

    Runs under different conditions are not ranked; the differences are returned instead.
    """
    found = _list_misses(runs, metrics)
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
            sentences.append(f"{name_few([names[n] for n in group])} are equal in every row.")
    ended = [(run.stop_reason, name) for run, name in zip(runs, names, strict=True)]
    if late := [name for reason, name in ended if reason == MAX_DURATION]:
        sentences.append(f"{name_few(late)} reached the time limit.")
    cut = [name for reason, name in ended if reason in CUT_SHORT - {MAX_DURATION}]
    if cut:
        whose = "its" if len(cut) == 1 else "their"
        sentences.append(f"{name_few(cut)} did not come to {whose} own end.")
    return sentences


def _list_misses(runs: Sequence[Run], metrics: Sequence[Mapping[str, Metric]]) -> dict[int, float]:
    """Return the final position error of each run with a goal [m], by its index."""
    found = {}
    for number, (run, known) in enumerate(zip(runs, metrics, strict=True)):
        metric = known.get("final.position_error")
        aims = run.is_lawless or run.declaration.uses_goal
        if aims and metric is not None and metric.value is not None:
            found[number] = metric.value
    return found


def conclude_checks(verdicts: Sequence[tuple[str, str, str]]) -> str:
    """Return a sentence on failed and skipped checks, given as run, check and verdict, if any."""
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
    """Return the causes of a run's value, in the words of `turtlelog explain`; empty if unknown."""
    leading = choose_leading(found)
    if found.withheld or found.without_value or not (found.acting or leading):
        return ""
    told = found.sentences[: 2 + len(leading) + bool(choose_named(found))]
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
