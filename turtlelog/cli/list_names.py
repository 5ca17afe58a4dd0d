"""`turtlelog list`: names for commands, checks and scenarios; completion by the shell."""

import dataclasses
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.console import fill_lines, find_width, print_json, print_text

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext

Kind = Literal["metrics", "signals", "presets", "laws", "plants", "causes", "figures"]
Entries = list[dict[str, Any]]

_PRESETS: Final = {
    "paper": "the paper's controller with all its effects, Kp = 1",
    "textbook": "the loop of the equations: no pause, no initial queue, the newest command wins",
    "posture": "the law posture in the textbook's loop: to the goal and a heading of 90 deg",
    "track-square": "pure pursuit along a square of 5 m at 0.5 m/s",
    "lagged": "the textbook's loop, robot model of time constant 0.1 s and dead time 0.08 s",
    "plant-impulse": "the turn rate's unit impulse, without limits: the heading stays at 1 rad",
    "plant-step": "the turn rate's unit step, without limits: the heading is t",
    "plant-ramp": "the turn rate's unit ramp, without limits: the heading is t^2 / 2, sampled",
}
_NOTES: Final[Mapping[str, str]] = {
    "metrics": "These metrics belong to the law sequential-p. Other laws have loops of other names:"
    " `turtlelog metrics FILE --all` shows the metrics of a recording.",
    "signals": "The states of your own laws are signals too, under their own names.",
    "causes": "effect: of the implementation; design: a design parameter.",
    "laws": "And laws of your own: FILE.py:NAME.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ListAnswer:
    """Names of a kind, each with its properties."""

    kind: Kind
    entries: list[dict[str, Any]]


def list_(kind: Kind, /, *, json: bool = False) -> None:
    """List the names of metrics, signals, presets, laws, plants, causes or figures.

    Example: turtlelog list metrics

    Args:
        kind: Kind of names to list.
        json: Print one JSON object instead of a table.
    """
    entries = _LISTS[kind]()
    if json:
        print_json(ListAnswer(kind=kind, entries=entries))
        return
    titles = [title for title in entries[0] if title not in _IN_JSON]
    rows = [row for entry in entries for row in _list_rows(entry, titles)]
    notes = ["", fill_lines([_NOTES[kind]])] if kind in _NOTES else []
    print_text("\n".join([f"{len(entries)} {kind}", "", *_align([tuple(titles), *rows]), *notes]))


def _align(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Yield lines of cells. The last cell is wrapped in a terminal, but not in a pipe."""
    *widths, last = (max(map(len, column)) for column in zip(*rows, strict=True))
    indent = sum(widths) + 2 * len(widths)
    width = find_width() if sys.stdout.isatty() else indent + last
    for number, (*first, text) in enumerate(rows):
        head = "".join(f"{cell:<{width + 2}}" for cell, width in zip(first, widths, strict=True))
        yield textwrap.fill(
            text,
            width,
            initial_indent=head,
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        if not number:
            yield "-" * min(indent + last, width)


_IN_JSON: Final = frozenset({"scenario", "parameters"})
"""Fields that have no room in a table."""


def _list_rows(entry: Mapping[str, Any], titles: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the row of an entry, and one row for each further setting in its last column."""
    *first, last = (entry[title] for title in titles)
    if not isinstance(last, Mapping):
        yield (*map(_show, first), _show(last))
        return
    settings = [
        f"{key} not given" if value is None else f"{key} = {value}" for key, value in last.items()
    ] or ["-"]
    yield (*map(_show, first), settings[0])
    yield from ((*("" for _ in first), setting) for setting in settings[1:])


def _show(value: Any) -> str:
    return ", ".join(value) if isinstance(value, list) else str(value or "-")


def _list_metrics() -> Entries:
    declaration = tl.simulate.declare_scenario(tl.load_scenario("textbook"))
    return [
        {"name": name, "unit": kind.unit, "better": kind.better, "meaning": kind.meaning}
        for name, kind in tl.measure.list_metrics(declaration).items()
    ]


def _list_signals() -> Entries:
    rows = [
        {"name": name, "unit": kind.unit, "row per": kind.source, "meaning": kind.meaning}
        for name, kind in tl.SIGNALS.items()
    ]
    from turtlelog.laws import LAWS, Goal

    for law in LAWS.values():
        if law.needs_path:
            continue  # these need a path or a table, and have no states
        declaration = law.declare(law.Parameters(), Goal(0.0, 0.0, 0.0), None)
        for name in declaration.states:
            unit, meaning = declaration.state_units.get(name, ""), f"State of the law {law.name}."
            rows.append({"name": name, "unit": unit, "row per": "sample", "meaning": meaning})
    return rows


def _list_presets() -> Entries:
    return [
        {
            "name": name,
            "meaning": _PRESETS.get(name, "a run that the paper recorded, with all its effects"),
            "scenario": dict(tl.scenario.flatten_scenario(tl.load_scenario(name))),
        }
        for name in tl.PRESETS
    ]


def _list_laws() -> Entries:
    from turtlelog.laws import LAWS

    return [_describe_part(name, law.Parameters, law.meaning) for name, law in LAWS.items()]


def _list_plants() -> Entries:
    from turtlelog.plants import PLANTS

    return [_describe_part(name, part.Keys, part.meaning) for name, part in PLANTS.items()]


def _describe_part(name: str, keys: Any, meaning: str) -> dict[str, Any]:
    parameters = [one.name for one in dataclasses.fields(keys)]
    return {"name": name, "parameters": parameters, "meaning": meaning}


def _list_causes() -> Entries:
    from turtlelog.explain.causes import LOOP_CAUSES, PLANT_CAUSES
    from turtlelog.laws import LAWS, list_causes

    of_plants = [(name, one) for name, causes in PLANT_CAUSES.items() for one in causes]
    of_laws = [(name, one) for name, law in LAWS.items() for one in list_causes(law)]
    return [
        {"name": one.name, "kind": one.kind, "of": law, "without it": dict(one.neutral)}
        for law, one in [*(("any loop", one) for one in LOOP_CAUSES), *of_laws, *of_plants]
    ]


def _list_figures() -> Entries:
    return [
        {"name": name, "paper's figure": kind.paper or None, "meaning": kind.title}
        for name, kind in tl.draw.FIGURES.items()
    ]


_LISTS: Final[Mapping[Kind, Callable[[], Entries]]] = {
    "metrics": _list_metrics,
    "signals": _list_signals,
    "presets": _list_presets,
    "laws": _list_laws,
    "plants": _list_plants,
    "causes": _list_causes,
    "figures": _list_figures,
}


def complete_preset(context: "CompletionContext") -> dict[str, str]:
    """Return presets, and scenario files and recordings that complete a word."""
    found = _find_files(context, {".toml", ".mcap"})
    return {entry["name"]: entry["meaning"] for entry in _list_presets()} | found


def complete_law(context: "CompletionContext") -> dict[str, str]:
    """Return built-in laws, and Python files that complete a word, without running code."""
    found = _find_files(context, {".py"})
    return {entry["name"]: entry["meaning"] for entry in _list_laws()} | found


def _find_files(context: "CompletionContext", suffixes: set[str]) -> dict[str, str]:
    place = Path(context.incomplete)
    folder = place if context.incomplete.endswith("/") else place.parent
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {str(path): "" for path in files if path.suffix in suffixes}


def complete_keys(_: "CompletionContext") -> dict[str, str]:
    """Return the arguments of --set: the keys of a scenario, with the values of preset `paper`."""
    flat = tl.scenario.flatten_scenario(tl.load_scenario("paper"))
    return {f"{key}=": f"{value}, of paper" for key, value in flat.items()}


def _complete_list(context: "CompletionContext", kind: Kind) -> dict[str, str]:
    """Return the words with one more name. The text before the last comma does not change."""
    before, comma, _ = context.incomplete.rpartition(",")
    return {
        f"{before}{comma}{entry['name']}": str(entry.get("meaning") or entry.get("kind"))
        for entry in _LISTS[kind]()
    }


complete_metrics: Final = partial(_complete_list, kind="metrics")
complete_figures: Final = partial(_complete_list, kind="figures")
complete_causes: Final = partial(_complete_list, kind="causes")


def install_completion(
    *,
    shell: Literal["zsh", "bash", "fish", "powershell"] | None = None,
    output: Annotated[Path | None, Parameter(name=("-o", "--output"))] = None,
) -> None:
    """Write the completion script of your shell and say where.

    Args:
        shell: Shell type for completion. If not specified, attempts to auto-detect current shell.
        output: Output path for the completion script. If not specified, uses shell-specific
            default.
    """
    from cyclopts.completion.install import create_install_completion_command

    from turtlelog.cli.app import app  # which names this module's commands

    install = create_install_completion_command(app.install_completion, add_to_startup=False)
    install(shell=shell, output=output)
