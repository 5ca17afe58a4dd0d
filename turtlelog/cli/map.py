"""`turtlelog plot TABLE`: maps, curves and sensitivities of a sweep."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

import turtlelog as tl
from turtlelog.cli.list_names import complete_keys
from turtlelog.cli.map_answer import build_map_answer, list_map_lines, list_sensitivity_lines
from turtlelog.cli.output import fill_lines, list_written, print_json, print_note, print_text
from turtlelog.cli.picture_options import PageOptions
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import PICTURES, require_new_target
from turtlelog.errors import TurtlelogError, UsageError

if TYPE_CHECKING:
    from turtlelog.sweep import LoopLimits, SweptView


Kind = Literal["map", "curves", "tornado"]


@Parameter(name="*", group=Group("Tables of sweeps", sort_key=2))
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptions:
    """View of a sweep's table.

    Attributes:
        kind: Maps over two keys (curves if only one varies), curves over one key with a line for
            each value of a second, or the change of each metric along each key (tornado). Default:
            map.
        x: Key at the bottom.
        y: Key at the side.
        at: Fix a varied key at a value. Example: loop.transport_delay_ticks=4. Can be repeated.
    """

    kind: Kind | None = None
    x: Annotated[str | None, Parameter(metavar="KEY", completer=complete_keys)] = None
    y: Annotated[str | None, Parameter(metavar="KEY", completer=complete_keys)] = None
    at: Annotated[list[str] | None, Parameter(metavar="KEY=VALUE", completer=complete_keys)] = None

    @property
    def is_given(self) -> bool:
        """Whether any of these options is given."""
        return self != ViewOptions()

    def list_words(self) -> list[str]:
        """Return the options as given."""
        given = (("--x", self.x), ("--y", self.y))
        words = [word for name, text in given if text is not None for word in (name, text)]
        return words + [word for text in self.at or [] for word in ("--at", text)]

    def read_held(self) -> dict[str, Any]:
        """Return the values of --at."""
        return tl.scenario.parse_assignments(self.at or [], source="--at")


def find_sweep_table(files: Sequence[Path], view: ViewOptions) -> Path | None:
    """Return the table of a sweep among the files; None if there are recordings.

    Raises:
        UsageError: If there are further files, or options of tables without a table.
    """
    tables = [path for path in files if path.suffix.lower() == ".parquet" and _is_table(path)]
    if not tables and not view.is_given:
        return None
    if not tables:
        what = f"{files[0]} is a recording; " if files else ""
        need = "--kind, --x, --y and --at need one table written by turtlelog sweep"
        raise UsageError(f"{what}{need}")
    if len(files) > 1:
        raise UsageError(f"{tables[0]} is the table of a sweep, which is plotted alone")
    return tables[0]


def _is_table(path: Path) -> bool:
    try:
        facts = tl.sweep.read_result_facts(path)
    except TurtlelogError:
        return False
    return facts is not None and facts.get("kind") == "sweep"


def draw_table(
    table: Path,
    output: Path | None,
    view: ViewOptions,
    where: PageOptions,
    patterns: list[str] | None,
    *,
    json: bool,
) -> None:
    """Draw the table of a sweep, and print the best rows of its metrics.

    Args:
        table: Table written by `turtlelog sweep`.
        output: Figure or report (.html) to write. None: nothing is drawn.
        view: View options.
        where: Page options.
        patterns: Metrics to draw. Default: up to four.
        json: Print one JSON object instead of lines.
    """
    kind: Kind = view.kind or "map"
    _require_output(output, table, kind, where)
    results = tl.sweep.read_swept_results(table, patterns)
    gains = tl.sweep.list_gain_keys(results)
    held = view.read_held()
    shown = tl.sweep.choose_view(results, x=view.x, y=view.y, at=held, gains=gains)
    tl.sweep.require_values(shown)
    if kind == "tornado" and not tl.sweep.list_varied(results):
        raise UsageError(f"--kind tornado: no key varies in {table}")
    limits = tl.sweep.find_loop_limits(shown)
    if output is not None:
        with show_progress("drawing"):
            words = [*view.list_words(), *(["--metric", ",".join(patterns)] if patterns else [])]
            _write(shown, limits, output, kind, where, words)
    _answer(shown, limits, output, kind, json=json)


def _require_output(output: Path | None, table: Path, kind: str, where: PageOptions) -> None:
    """Refuse an output that cannot be written."""
    suffix = "" if output is None else output.suffix.lower()
    if suffix == ".rrd":
        need = "view shows the recordings of rows, which sweep --record keeps"
        raise UsageError(f"--output {output}: a table becomes a figure or a report (.html); {need}")
    if suffix not in PICTURES and where != PageOptions():
        raise UsageError("--for, --text-width and --dpi need a figure to write: -o NAME.png")
    if output is None:
        return
    if suffix not in {*PICTURES, ".html"}:
        expected = "a name that ends in .pdf, .png, .svg or .html"
        raise UsageError(f"--output {output}: must be {expected}")
    if suffix == ".html" and kind != "map":
        raise UsageError(
            f"--kind {kind}: {output} is no figure; end its name in .pdf, .png or .svg"
        )
    require_new_target(output, [table], suffix=suffix)


def _write(
    view: "SweptView",
    limits: "list[LoopLimits]",
    output: Path,
    kind: Kind,
    where: PageOptions,
    words: Sequence[str],
) -> None:
    suffix = output.suffix.lower()
    if suffix == ".html":
        command = ["turtlelog", "plot", str(view.results.path), *words, "-o", str(output)]
        tl.draw.write_map_report(view, limits, output, command=shlex.join(command))
    else:
        page = where.build_page([suffix[1:]], None, usual="page")
        tl.draw.write_map_figure(view, limits, output, kind=kind, page=page)


def _answer(
    view: "SweptView", limits: "list[LoopLimits]", output: Path | None, kind: str, *, json: bool
) -> None:
    told = build_map_answer(view, limits, output)
    for note in told.notes:
        print_note(f"plot: {note}")
    if json:
        print_json(told)
        return
    lines = list_map_lines(view, limits, told)
    if kind == "tornado":
        lines = [lines[0], *list_sensitivity_lines(view)]
    lines = [line if " run --from " in line else fill_lines([line], indent=2) for line in lines]
    print_text("\n".join([*lines, *list_written([] if output is None else [output])]))
