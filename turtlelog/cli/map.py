"""`turtlelog map`: the table of a sweep as maps, curves and sensitivities."""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.list_names import complete_keys, complete_metrics
from turtlelog.cli.map_answer import describe_map, list_map_lines, list_sensitivity_lines
from turtlelog.cli.options import Json, MaxDownload, Place
from turtlelog.cli.output import print_json, print_lines, print_note
from turtlelog.cli.progress import show_progress
from turtlelog.cli.scenario_options import is_recording
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog.show import Page
    from turtlelog.sweep import LoopLimits, SweptView

_PICTURES: Final = frozenset({".pdf", ".png", ".svg"})


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptions:
    """What is shown.

    Attributes:
        kind: A map over two keys (curves where one varies), curves over one key, with a line for
            each value of a second, or how far each key moves each metric.
        metrics: Ids or patterns of the table's metrics, as in translate.stable,*.overshoot;
            otherwise up to four of them.
        x: Key at the bottom.
        y: Key at the side.
        at: Hold a key that varies at a value, as in loop.transport_delay_ticks=4; may stand several
            times.
    """

    kind: Literal["map", "curves", "tornado"] = "map"
    metrics: Annotated[str | None, Parameter(metavar="IDS", completer=complete_metrics)] = None
    x: Annotated[str | None, Parameter(metavar="KEY", completer=complete_keys)] = None
    y: Annotated[str | None, Parameter(metavar="KEY", completer=complete_keys)] = None
    at: Annotated[list[str] | None, Parameter(metavar="KEY=VALUE", completer=complete_keys)] = None

    def list_patterns(self) -> list[str] | None:
        """Return the metrics that are asked for, None where none are."""
        if self.metrics is None:
            return None
        patterns = [name.strip() for name in self.metrics.split(",")]
        if not all(patterns):
            raise UsageError(f"--metrics: expected ids separated by commas, found {self.metrics!r}")
        return patterns

    def list_words(self) -> list[str]:
        """Return the options as they were given."""
        given = (("--metrics", self.metrics), ("--x", self.x), ("--y", self.y))
        words = [word for name, text in given if text is not None for word in (name, text)]
        return words + [word for text in self.at or [] for word in ("--at", text)]

    def read_held(self) -> dict[str, Any]:
        """Return what --at says."""
        return tl.scenario.parse_assignments(self.at or [], source="--at")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """Where a figure will stand.

    Attributes:
        place: column is one of two columns of a paper, page its whole width, slide 16:9 with large
            lettering.
        text_width: Width of the paper's text [mm], 120 to 1000; 181 unless given. Not of a slide.
        dpi: Resolution of a PNG [dots per inch], 50 to 600; 300 unless given; 144 for a slide.
    """

    place: Annotated[Literal["column", "page", "slide"], Parameter(name="--for")] = "page"
    text_width: Annotated[float | None, Parameter(metavar="WIDTH")] = None
    dpi: int | None = None

    @property
    def is_given(self) -> bool:
        """Whether any of it was asked for."""
        return self != PictureOptions()

    def build_page(self, suffix: str) -> "Page":
        """Return the page of a figure whose file ends so."""
        if self.text_width is not None and self.place == "slide":
            raise UsageError("--text-width: expected --for column or page, found slide")
        if self.dpi is not None and suffix != ".png":
            raise UsageError(f"--dpi: expected a .png file, found {suffix}")
        page = tl.show.Page(kind=self.place, dpi=self.dpi)
        return page if self.text_width is None else replace(page, text_width_mm=self.text_width)


def map_(
    table: Place,
    /,
    *,
    output: Annotated[Place | None, Parameter(name=("--output", "-o"))] = None,
    view: ViewOptions | None = None,
    picture: PictureOptions | None = None,
    json: Json = False,
    max_download: MaxDownload = None,  # noqa: ARG001 (it holds as soon as it is read)
) -> None:
    """Draw the table of a sweep: metrics over its keys, with theory's limits of the gain.

    Two keys that vary make a map of each metric; where a gain is one of them, theory's limits of
    its loop are lines over it. One key makes curves. The other keys are held at the values of the
    scenario that was varied, or in the middle; --at holds others. Over seeds values are means.

    The lines name the best row of each metric, and the command that runs it again.

    Example: turtlelog map results.parquet -o map.png

    Example: turtlelog map results.parquet --kind tornado -o keys.pdf

    Args:
        table: What `turtlelog sweep` wrote (.parquet).
        output: Write this figure (.pdf, .png, .svg), report (.html) or Rerun recording (.rrd).
        json: Print one JSON object instead of lines.
        max_download: Longest file behind a URL that is fetched as a whole, which servers without
            ranges need, as in 500MB. Default: 4GiB.
    """
    options, picture = view or ViewOptions(), picture or PictureOptions()
    page = _require_output(output, table, options.kind, picture)
    patterns, held = options.list_patterns(), options.read_held()
    if is_recording(table) and table.suffix.lower() != ".parquet":
        raise UsageError(f"{table} is a recording; map needs a table written by turtlelog sweep")
    results = tl.sweep.read_swept_results(table, patterns)
    gains = tl.sweep.list_gain_keys(results)
    shown = tl.sweep.choose_view(results, x=options.x, y=options.y, at=held, gains=gains)
    tl.sweep.require_values(shown)
    if options.kind == "tornado" and not tl.sweep.list_varied(results):
        raise UsageError(f"--kind tornado: expected a key that varies, found none in {table}")
    limits = tl.sweep.find_loop_limits(shown)
    if output is not None:
        with show_progress("drawing"):
            _write(shown, limits, output, options, page)
    _answer(shown, limits, output, options.kind, json=json)


def _require_output(
    output: Path | None, table: Path, kind: str, picture: PictureOptions
) -> "Page | None":
    """Refuse an output that cannot be written; return the page of a figure."""
    suffix = "" if output is None else output.suffix.lower()
    if suffix not in _PICTURES and picture.is_given:
        raise UsageError("--for, --text-width, --dpi: expected a figure to write, found none")
    if output is None:
        return None
    if suffix not in {*_PICTURES, ".html", ".rrd"}:
        expected = "a name that ends in .pdf, .png, .svg, .html or .rrd"
        raise UsageError(f"--output {output}: expected {expected}, found another")
    if suffix in {".html", ".rrd"} and kind != "map":
        raise UsageError(f"--kind {kind}: expected a figure to write, found {output}")
    require_new_target(output, [table], suffix=suffix)
    return picture.build_page(suffix) if suffix in _PICTURES else None


def _write(
    view: "SweptView",
    limits: "list[LoopLimits]",
    output: Path,
    options: ViewOptions,
    page: "Page | None",
) -> None:
    suffix = output.suffix.lower()
    if suffix == ".rrd":
        tl.show.write_map_rrd(view, limits, output)
    elif suffix == ".html":
        words = ["turtlelog", "map", str(view.results.path), *options.list_words()]
        tl.show.write_map_report(
            view, limits, output, command=shlex.join([*words, "-o", str(output)])
        )
    else:
        tl.show.write_map_figure(view, limits, output, kind=options.kind, page=page)


def _answer(
    view: "SweptView", limits: "list[LoopLimits]", output: Path | None, kind: str, *, json: bool
) -> None:
    told = describe_map(view, limits)
    for note in told["notes"]:
        print_note(f"map: {note}")
    if json:
        print_json({**told, "output": None if output is None else str(output)})
        return
    lines = list_map_lines(view, limits, told)
    if kind == "tornado":
        lines = [lines[0], *list_sensitivity_lines(view)]
    print_lines([*lines, *([] if output is None else [f"wrote {output}"])])
