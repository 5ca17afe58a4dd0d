"""Movies of one or several runs as .mp4 (VP9) or .gif: their times, their pictures, their files.

A picture shows the plane on the left, curves and the goal on the right. Static content is drawn
once; for each picture, moving content is drawn over a copy of it.

VP9 and its encoder are free of fees, and OpenCV contains FFmpeg under the LGPL. H.264, which older
players also support, has no available encoder without the GPL.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.libraries import load_library

load_library("matplotlib")

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from turtlelog.charts import plane_scene, plotted_curves, time_plots
from turtlelog.charts.close_up import CloseUp, Lettering, format_length, list_miss_labels
from turtlelog.charts.curves import Values, choose_rows
from turtlelog.charts.plane_scene import part_path
from turtlelog.charts.time_plots import TIME_PLOTS, TIMELINE, Film
from turtlelog.compare import order_by_gain
from turtlelog.draw.figures.figure_curves import NAMES_HEIGHT, choose_run_lines, name_runs_above
from turtlelog.draw.figures.page import GOAL, LOOKS, START, fix_style, use_looks
from turtlelog.draw.figures.plane_panels import find_named_close_up
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.log import replace_when_complete
from turtlelog.run import Run

Picture = NDArray[np.uint8]
"""Pixels of a picture, shape (height, width, 3): red, green and blue."""

_SIZES: Final = {".mp4": (1280, 720), ".gif": (800, 450)}
"""Widths and heights [pixels]: of a slide, and of a page with text next to the movie."""


def write_movie(
    runs: Sequence[Run],
    path: str | Path,
    *,
    timeline: str = TIMELINE,
    length_s: float | None = None,
    on_picture: Callable[[int, int], None] | None = None,
) -> None:
    """Write a movie: turtles with growing trails, and a close-up of the goal at the end.

    Args:
        runs: Runs, at least one. Several runs are in one picture, in the order of their gains.
        path: A .mp4 (VP9) or .gif file. An existing file is replaced when the new one is complete.
        timeline: `sim_time`: from each run's first sample; or a later phase, such as
            `translate_time`: from each start of this phase.
        length_s: Length of the movie [s], 1 to 600, for a .gif up to 60. Default: real time, at
            most 10 s.
        on_picture: Function that is called with the numbers of pictures done and in total.

    Raises:
        ShowError: If there is no run, a run does not have the timeline, the length is out of range,
            or the file cannot be written.
        LibraryError: If the encoder of such a file is not installed.
    """
    path = make_path(path)
    suffix = path.suffix.lower()
    require_encoder(suffix)
    if not runs:
        raise ShowError(f"{path}: no run to film")
    longest_s = LONGEST_S[suffix]
    if length_s is not None and not SHORTEST_S <= length_s <= longest_s:
        raise ShowError(
            f"movie: expected a length of {SHORTEST_S:g} to {longest_s:g} s for {suffix}, found"
            f" {length_s:g}"
        )
    runs = order_by_gain(runs)
    film = time_plots.plan_film(
        runs, timeline=timeline, length_s=length_s, pictures_per_s=PICTURES_PER_S[suffix]
    )
    pictures = draw_pictures(runs, film, size=_SIZES[suffix], on_picture=on_picture)
    with replace_when_complete(path, raising=ShowError) as part:
        (_encode_mp4 if suffix == ".mp4" else _encode_gif)(pictures, part)


PICTURES_PER_S: Final = {".mp4": 24.0, ".gif": 20.0}
"""Picture rates [1/s]. For .mp4, the rate is that of the cinema; VP9 takes 0.13 s of processor time
per picture. For .gif, a picture lasts whole hundredths of a second, and many programs show none for
less than five."""

_COLORS: Final = 128
"""Number of colours of a GIF; twelve runs with faint paths and smooth edges need about 90."""


def require_encoder(suffix: str) -> None:
    """Load the encoder for a suffix; ShowError without a format, LibraryError without encoder."""
    if suffix not in _SIZES:
        raise ShowError(f"movie: expected a name that ends in .mp4 or .gif, found {suffix!r}")
    load_library("cv2" if suffix == ".mp4" else "PIL.Image")


def _encode_mp4(pictures: Iterable[Picture], path: Path) -> None:
    cv2 = load_library("cv2")
    # OpenCV chooses the encoder by the file's suffix, which the temporary name of the target lacks.
    with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
        whole = Path(folder) / "movie.mp4"
        writer: Any = None
        for picture in pictures:
            if writer is None:
                height, width = picture.shape[:2]
                codec = cv2.VideoWriter_fourcc(*"vp09")
                rate = PICTURES_PER_S[".mp4"]
                writer = cv2.VideoWriter(str(whole), cv2.CAP_FFMPEG, codec, rate, (width, height))
                if not writer.isOpened():
                    raise ShowError(f"{path}: expected OpenCV to write VP9, found that it cannot")
            writer.write(np.ascontiguousarray(picture[:, :, ::-1]))
        if writer is not None:
            writer.release()
        path.write_bytes(whole.read_bytes())


def _encode_gif(pictures: Iterable[Picture], path: Path) -> None:
    image = load_library("PIL.Image")
    shown = [image.fromarray(picture) for picture in pictures]
    # One colour table for all pictures, from the last, which has all colours: nothing flickers.
    table = shown[-1].quantize(_COLORS)
    frames = [picture.quantize(palette=table, dither=image.Dither.NONE) for picture in shown]
    frames[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=round(1000.0 / PICTURES_PER_S[".gif"]),
        loop=0,
        optimize=False,
    )


SHORTEST_S: Final = 1.0  # shortest movie [s]; shorter movies would be a picture

LONGEST_S: Final = {".mp4": 600.0, ".gif": 60.0}
"""Longest movie [s]. An .mp4 takes 3 s of work per second, a .gif 22 MB of memory."""

_INCH: Final = (12.8, 7.2)
_LOOKS: Final = {
    **LOOKS,
    "font.size": 13.0,
    "axes.titlesize": 14.0,
    "axes.labelsize": 13.0,
    "xtick.labelsize": 11.0,
    "ytick.labelsize": 11.0,
    "legend.fontsize": 13.0,
    "lines.linewidth": 2.2,
    "axes.linewidth": 1.0,
}
"""Settings of matplotlib: on a slide, text is legible from the last row of the audience."""

_PLANE: Final = (0.055, 0.095, 0.48, 0.79)
_CURVES: Final = ((0.63, 0.725, 0.35, 0.16), (0.63, 0.49, 0.35, 0.16))
_GOAL: Final = (0.63, 0.035, 0.35, 0.345)
_TALL_CURVES: Final = ((0.63, 0.53, 0.35, 0.355), (0.63, 0.095, 0.35, 0.355))

_FAINT: Final = 0.22  # opacity of the path that is not driven yet

_BESIDE: Final = fix_style(color="0.5", linewidth=1.2, linestyle=":", zorder=1.5)
"""Style of ideal responses and references."""

_TURTLE: Final = np.array([(1.0, 0.0), (-0.7, 0.62), (-0.35, 0.0), (-0.7, -0.62)])
_TURTLE_SIZE: Final = 0.045
"""Size of a turtle as a share of the plane's half-width, large enough to see the heading."""

_NEAR: Final = 3.0
"""Distance in half-widths of the close-up from which a robot is near: about a second away."""

_MOST_POINTS: Final = 2000  # points of a trail: more than the picture is wide

_LETTERS: Final = Lettering(letter=0.095, line=0.22, gap=0.16, reach=1.85)
"""Size of text at 13 points in the view of the goal, whose half-height is 90 points."""

_USUAL: Final = ("heading", "speed")  # default curves of a robot whose loops are unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class _Growing:
    """A line that is drawn up to a given time."""

    line: Any  # artist of matplotlib
    time_s: Values  # times of the points on the timeline [s]
    points: Values  # points of the line, shape (n, 2)

    def grow(self, time_s: float, tip: Values | None) -> None:
        """Show the part before a time, and a line from the end of this part to the tip."""
        shown = self.points[: int(np.searchsorted(self.time_s, time_s, side="right"))]
        self.line.set_data(*(shown if tip is None else np.vstack([shown, tip])).T)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Goal:
    axes: Axes  # axes of the view
    close_up: CloseUp  # content of the view
    words: list[Artist]  # distances of the runs, shown when they have arrived


@dataclass(slots=True, kw_only=True)
class _Stage:
    """The figure with its moving parts. All sequences of runs have the same order."""

    figure: Figure
    film: Film
    places: list[tuple[Values, Values]]
    trails: list[_Growing] = field(default_factory=list)
    near_trails: list[_Growing] = field(default_factory=list)
    curves: list[_Growing] = field(default_factory=list)
    turtles: list[tuple[Polygon, float]] = field(default_factory=list)
    cursors: list[Any] = field(default_factory=list)
    dots: list[Any] = field(default_factory=list)
    goal: _Goal | None = None
    clock: Any = None


def draw_pictures(
    runs: Sequence[Run],
    film: Film,
    *,
    size: tuple[int, int],
    on_picture: Callable[[int, int], None] | None = None,
) -> Iterator[Picture]:
    """Yield the pictures of a film, each of a given width and height [pixels]."""
    origin_m = plane_scene.find_origin(runs)
    runs, _ = plane_scene.move_near(runs)
    with use_looks(_LOOKS):
        figure = Figure(figsize=_INCH, dpi=size[0] / _INCH[0])
        canvas = FigureCanvasAgg(figure)
        stage = _set_stage(figure, runs, film)
        x_label, y_label = map(plane_scene.label_coordinate, "xy", origin_m)
        figure.axes[0].set(xlabel=x_label, ylabel=y_label)
        canvas.draw()
        still = canvas.copy_from_bbox(figure.bbox)
    for number, time_s in enumerate(film.time_s.tolist()):
        with use_looks(_LOOKS):
            canvas.restore_region(still)
            for artist in _move(stage, number, time_s):
                figure.draw_artist(artist)
        yield np.asarray(canvas.buffer_rgba())[: size[1], :, :3].copy()
        if on_picture is not None:
            on_picture(number + 1, len(film.time_s))


Look = dict[str, Any]


def _set_stage(figure: Figure, runs: Sequence[Run], film: Film) -> _Stage:
    looks = [
        {"color": line["color"], "zorder": line.get("zorder", 2)} for line in choose_run_lines(runs)
    ]
    pairs = list(zip(runs, film.zeros_ns, strict=True))
    stage = _Stage(
        figure=figure,
        film=film,
        places=[time_plots.locate_run(run, zero_ns, film.time_s) for run, zero_ns in pairs],
    )
    close_up = find_named_close_up(runs)
    _set_plane(stage, runs, looks)
    for place, name in zip(
        _TALL_CURVES if close_up is None else _CURVES, _choose_plots(runs), strict=False
    ):
        _set_curve(stage, figure.add_axes(place), runs, looks, name)
    if close_up is not None:
        _set_goal(stage, runs, looks, close_up)
    name_runs_above(figure, runs, [look["color"] for look in looks], left=_PLANE[0])
    stage.clock = figure.text(0.98, NAMES_HEIGHT, "", ha="right", va="center", animated=True)
    return stage


def _set_plane(stage: _Stage, runs: Sequence[Run], looks: Sequence[Look]) -> None:
    axes = stage.figure.add_axes(_PLANE)
    goals = plane_scene.list_goals(runs)
    outlines = [plane_scene.outline_path(path) for path in plane_scene.list_paths(runs)]
    for outline in outlines:
        axes.plot(*outline.T, color="0.85", linewidth=5.0, zorder=1)
    for run, zero_ns, look in zip(runs, stage.film.zeros_ns, looks, strict=True):
        axes.plot(*part_path(run).T, **look, alpha=_FAINT)
        stage.trails.append(_start_trail(axes, run, zero_ns, look))
    axes.plot(*plane_scene.list_starts(runs).T, **START, ms=8.0)
    if len(goals):
        axes.plot(*goals.T, **GOAL, ms=13.0, mew=2.5)
    points = np.concatenate([*(run.poses.xy_m for run in runs), *outlines, goals])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    center, half_m = (low + high) / 2.0, max(0.6 * float((high - low).max()), 1e-3)
    ratio = _find_ratio(stage.figure, _PLANE)
    axes.set_xlim(center[0] - half_m * ratio, center[0] + half_m * ratio)
    axes.set_ylim(center[1] - half_m, center[1] + half_m)
    for look in looks:
        turtle = Polygon(_TURTLE, closed=True, facecolor=look["color"], edgecolor="black", lw=1.0)
        turtle.set(animated=True, zorder=4)
        axes.add_patch(turtle)
        stage.turtles.append((turtle, _TURTLE_SIZE * half_m))


def _start_trail(axes: Axes, run: Run, zero_ns: int, look: Look) -> _Growing:
    xy_m = part_path(run)
    time_s = (run.poses.time_ns - zero_ns) / 1e9
    if len(xy_m) != len(time_s):  # a reset separates the path by a row of nan
        xy_m = run.poses.xy_m
    rows = choose_rows(xy_m, _MOST_POINTS)
    rows = np.arange(len(xy_m)) if rows is None else rows
    (line,) = axes.plot([], [], **look, animated=True)
    return _Growing(line=line, time_s=time_s[rows], points=xy_m[rows])


def _choose_plots(runs: Sequence[Run]) -> list[str]:
    """Return the names of two plots: signals of the loops, in declared order."""
    controlled = [plot for run in runs for plot in time_plots.list_controlled(run)]
    found = dict.fromkeys([*controlled, *_USUAL])
    return [
        name for name in found if any(plotted_curves.has_own(run, TIME_PLOTS[name]) for run in runs)
    ][:2]


def _set_curve(
    stage: _Stage, axes: Axes, runs: Sequence[Run], looks: Sequence[Look], name: str
) -> None:
    """Draw a plot over time. Curves of runs grow, references are complete."""
    plot = TIME_PLOTS[name]
    for number, (run, zero_ns) in enumerate(zip(runs, stage.film.zeros_ns, strict=True)):
        look = looks[number]
        for found in plotted_curves.list_plotted(
            run, plot, plotted_curves.choose_kinds(number, len(runs)) or plotted_curves.COMPARED
        ):
            curve, time_s = found.curve, (found.curve.time_ns - zero_ns) / 1e9
            rows = choose_rows(curve.values, _MOST_POINTS)
            kept = slice(None) if rows is None else rows
            time_s, values = time_s[kept], curve.values[kept]
            step: Look = {"drawstyle": "steps-post"} if found.curve.holds else {}
            if found.kind not in ("run", "measured"):
                axes.plot(time_s, values, **step, **_BESIDE)
                continue
            axes.plot(time_s, values, **look, **step, alpha=_FAINT)
            (line,) = axes.plot([], [], **look, **step, animated=True)
            stage.curves.append(
                _Growing(line=line, time_s=time_s, points=np.column_stack([time_s, values]))
            )
    levels = dict.fromkeys(level.value for level in plotted_curves.list_plot_levels(runs, plot))
    for level in levels if len(levels) == 1 else ():
        axes.axhline(level, color="0.45", linewidth=1.0, zorder=1)
    own = [curve.values for run in runs for curve in plotted_curves.list_own(run, plot)]
    limits = plotted_curves.find_plot_range(own, plotted_curves.list_plot_levels(runs, plot))
    if limits is not None:
        axes.set_ylim(limits)
    axes.set_title(plot.label, loc="left", pad=4.0)
    axes.set_xlim(float(stage.film.time_s[0]), float(stage.film.time_s[-1]))
    axes.locator_params(axis="y", nbins=4)
    stage.cursors.append(axes.axvline(0.0, color="0.2", linewidth=1.2, animated=True))


def _set_goal(stage: _Stage, runs: Sequence[Run], looks: Sequence[Look], close_up: CloseUp) -> None:
    axes = stage.figure.add_axes(_GOAL, animated=True)
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(True)
    goal = close_up.goal_xy_m
    words: list[Artist] = []
    for ring_m in close_up.rings_m:
        axes.add_patch(Circle(goal, ring_m, fill=False, color="0.7", linewidth=1.0))
        name = axes.text(
            goal[0], goal[1] - ring_m, format_length(ring_m), color="0.4", fontsize=11.0
        )
        name.set(ha="center", va="top", clip_on=True)
    axes.plot(*goal, **GOAL, ms=13.0, mew=2.5)
    for run, zero_ns, look in zip(runs, stage.film.zeros_ns, looks, strict=True):
        trail = _start_trail(axes, run, zero_ns, look)
        trail.line.set_animated(False)
        stage.near_trails.append(trail)
        stage.dots.append(axes.plot([], [], "o", ms=9.0, **{**look, "zorder": 4})[0])
    for label in list_miss_labels(close_up, _LETTERS):
        color = looks[label.runs[0]]["color"] if len(label.runs) == 1 else "0.2"
        miss = axes.text(*label.xy_m, label.text, color=color, ha="center", va="center", zorder=5)
        miss.set(bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.85})
        words.append(miss)
    (x_m, y_m), ratio = goal, _find_ratio(stage.figure, _GOAL)
    axes.set_xlim(x_m - close_up.half_m * ratio, x_m + close_up.half_m * ratio)
    axes.set_ylim(y_m - close_up.half_m, y_m + close_up.half_m)
    axes.set_title(f"at the goal, {close_up.describe()}", loc="left", pad=4.0)
    stage.goal = _Goal(axes=axes, close_up=close_up, words=words)


def _move(stage: _Stage, number: int, time_s: float) -> Iterator[Artist]:
    """Yield the moving artists at their places in a picture."""
    for trails in (stage.trails, stage.near_trails):
        for trail, (xy_m, _) in zip(trails, stage.places, strict=False):
            trail.grow(time_s, xy_m[number])
    for curve in stage.curves:
        curve.grow(time_s, None)
        yield curve.line
    for cursor in stage.cursors:
        cursor.set_xdata([time_s, time_s])
        yield cursor
    yield from (trail.line for trail in stage.trails)
    for (turtle, size_m), (xy_m, heading_rad) in zip(stage.turtles, stage.places, strict=True):
        cosine, sine = np.cos(heading_rad[number]), np.sin(heading_rad[number])
        turned = _TURTLE @ np.array([(cosine, sine), (-sine, cosine)])
        turtle.set_xy(xy_m[number] + size_m * turned)
        yield turtle
    if stage.goal is not None:
        _show_goal(stage, stage.goal, number)
        yield stage.goal.axes
    stage.clock.set_text(f"{time_s:.2f} s{_tell_film(stage.film)}")
    yield stage.clock


def _show_goal(stage: _Stage, goal: _Goal, number: int) -> None:
    """Show the view of the goal while a robot is near it; otherwise it would be an empty box."""
    goal_xy_m = goal.close_up.goal_xy_m
    ways = [xy_m[number] - goal_xy_m for xy_m, _ in stage.places]
    reach_m = _NEAR * goal.close_up.half_m
    goal.axes.set_visible(any(np.hypot(*way) <= reach_m for way in ways))
    for words in goal.words:
        words.set_visible(number + 1 >= stage.film.driving)
    for dot, (xy_m, _) in zip(stage.dots, stage.places, strict=True):
        dot.set_data(*xy_m[number : number + 1].T)


def _tell_film(film: Film) -> str:
    """Return the zero of the time, if it is not the first sample, and the speed of the movie."""
    phase = film.timeline.removesuffix("_time").removeprefix("phase.")
    zero = "" if film.timeline == TIMELINE else f" from the start of {phase}"
    pace = f"{film.pace:.0f}" if film.pace >= 10.0 else f"{film.pace:.2g}"
    return zero + ("" if abs(film.pace - 1.0) < 0.005 else f", {pace} times real time")


def _find_ratio(figure: Figure, place: tuple[float, float, float, float]) -> float:
    width, height = figure.get_size_inches()
    return float(place[2] * width / (place[3] * height))
