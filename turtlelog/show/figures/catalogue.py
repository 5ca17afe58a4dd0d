"""The figures by name: what each shows, what it needs, and how it is drawn."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Final

from matplotlib.figure import Figure

from turtlelog.compare import order_by_gain, tabulate_table1
from turtlelog.run import Run
from turtlelog.show.close_up import ARRIVED_M, find_close_up, format_length
from turtlelog.show.commanded import Command
from turtlelog.show.figures import series
from turtlelog.show.figures.curves import read_applied, read_command
from turtlelog.show.figures.legend import label_runs
from turtlelog.show.figures.plane import draw_plane
from turtlelog.show.figures.theory import (
    draw_plant_responses,
    draw_root_locus,
    draw_step_responses,
    find_gains,
)

DrawFigure = Callable[[Figure, Sequence[Run]], None]
Arrange = Callable[[Figure, Sequence[Run], Sequence[series.Draw]], None]

_MOST_NAMED: Final = 3
"""So many runs are named that a figure does not show; of more it is said how many."""

_ARRIVAL: Final = f"one goal, and a run that ends within {format_length(ARRIVED_M)} of it"


def _holds_command(run: Run, command: Command, *, is_alone: bool) -> bool:
    """Whether there is something to draw: among several runs that is what was commanded."""
    found = read_command(run, command) or (read_applied(run, command) if is_alone else None)
    return found is not None


_HELD: Final[Mapping[str, tuple[str, Callable[[Run, bool], bool]]]] = MappingProxyType(
    {
        "gain": ("the law's gain", lambda run, _: bool(find_gains([run]))),
        "poses": ("poses", lambda run, _: len(run.poses) > 0),
        "goal": ("a goal", lambda run, _: run.goal_xy_m is not None),
        "samples": ("the controller's samples", lambda run, _: len(run.samples) > 0),
        "speed": ("speed commands", lambda run, a: _holds_command(run, "speed", is_alone=a)),
        "turn_rate": (
            "turn rate commands",
            lambda run, a: _holds_command(run, "turn_rate", is_alone=a),
        ),
        "wanted": (
            "what the law wanted before clipping",
            lambda run, _: len(run.samples) > 0 and run.samples.wanted_speed_m_s is not None,
        ),
    }
)
"""What a panel may need: in words, and whether a run, which may be alone, holds it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel of a figure.

    Attributes:
        name: What it shows, in a word or two.
        needs: What a run must hold to be drawn.
        draw: Draws it for some runs.
    """

    name: str
    needs: str
    draw: series.Draw


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureKind:
    """One figure.

    Attributes:
        title: What it shows, for captions.
        paper: The paper's figure that it stands beside; empty where there is none.
        height: Over its width, with all of its panels.
        needs: What at least one run must hold; each panel has needs of its own where there are any.
        draw: Draws it for some runs, where it has no panels.
        panels: Those that no run has anything for are left out.
        arrange: Puts panels where they stand.
    """

    title: str
    paper: str
    height: float = 0.62
    needs: str = "samples"
    draw: DrawFigure | None = None
    panels: tuple[Panel, ...] = ()
    arrange: Arrange = series.draw_stack

    def find_lack(self, runs: Sequence[Run]) -> str | None:
        """Return what is missing to draw it, None where nothing is; theory needs no runs."""
        needs = [panel.needs for panel in self.panels] or [self.needs]
        if not runs:
            return None if needs == ["gain"] else "a recording"
        lacks = [_HELD[need][0] for need in needs if len(find_lacking(runs, need)) == len(runs)]
        return lacks[0] if len(lacks) == len(needs) else None

    def choose_panels(self, runs: Sequence[Run]) -> tuple[Panel, ...]:
        """Return the panels that a run has something for."""
        return tuple(
            panel for panel in self.panels if len(find_lacking(runs, panel.needs)) < len(runs)
        )

    def find_height(self, runs: Sequence[Run]) -> float:
        """Return its height over its width: fewer panels need less."""
        kept, most = len(self.choose_panels(runs)), len(self.panels)
        return self.height * (1.0 + kept) / (1.0 + most)

    def draw_on(self, figure: Figure, runs: Sequence[Run]) -> None:
        """Draw it for some runs."""
        if self.draw is not None:
            self.draw(figure, runs)
        else:
            self.arrange(figure, runs, [panel.draw for panel in self.choose_panels(runs)])


def find_lacking(runs: Sequence[Run], need: str) -> tuple[int, ...]:
    """Return the numbers of the runs that do not hold what a panel needs."""
    holds = _HELD[need][1]
    return tuple(number for number, run in enumerate(runs) if not holds(run, len(runs) == 1))


def list_left_out(runs: Sequence[Run], names: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return what figures do not show of some runs, and why, one line for each reason.

    Args:
        runs: What is drawn; in these lines they have the names of legends.
        names: Of the figures that were asked for; all, and the tables, where None.
    """
    runs = order_by_gain(runs)
    left_out: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    shown = tuple(FIGURES) if names is None else tuple(dict.fromkeys(names))
    for name in shown:
        for part, need in _list_parts(name, runs):
            if lacking := find_lacking(runs, need):
                left_out.setdefault((_HELD[need][0], lacking), []).append(part)
    lines = [_describe(words, lacking, parts, runs) for (words, lacking), parts in left_out.items()]
    if names is None and not has_table1(runs):
        lines.append("left out table1.tex: expected a gain or the controller's samples, found none")
    if "plane" in shown and find_close_up(runs) is None:
        lines.append(f"left out plane (how each run ends): expected {_ARRIVAL}, found none")
    return tuple(lines)


def has_table1(runs: Sequence[Run]) -> bool:
    """Whether Table 1 of these runs holds anything but their names."""
    return any(value is not None for row in tabulate_table1(runs).rows for value in row[1:])


def _list_parts(name: str, runs: Sequence[Run]) -> list[tuple[str, str]]:
    """Return a figure, or its panels where they need different things, and what each needs."""
    kind = FIGURES[name]
    needs = list(dict.fromkeys(panel.needs for panel in kind.panels)) or [kind.needs]
    if len(needs) == 1 or not kind.choose_panels(runs):
        return [(name, needs[0])]
    return [(f"{name} ({panel.name})", panel.needs) for panel in kind.panels]


def _describe(words: str, lacking: Sequence[int], parts: Sequence[str], runs: Sequence[Run]) -> str:
    listed = ", ".join(parts)
    if len(lacking) == len(runs):
        return f"left out {listed}: expected {words}, found none"
    labels = label_runs(runs)
    named = ", ".join(labels[number] for number in lacking[:_MOST_NAMED])
    more = f" and {len(lacking) - _MOST_NAMED} more" if len(lacking) > _MOST_NAMED else ""
    return f"left {named}{more} out of {listed}: expected {words}, found none"


def _signal(signal: str, label: str, needs: str = "samples", name: str = "") -> Panel:
    draw = partial(series.draw_signal, signal=signal, label=label)
    return Panel(name=name or signal.replace("_", " "), needs=needs, draw=draw)


def _magnitude(signal: str, label: str, needs: str) -> Panel:
    draw = partial(series.draw_error_magnitude, signal=signal, label=label)
    return Panel(name=signal.replace("_", " "), needs=needs, draw=draw)


def _command(command: Command, label: str) -> Panel:
    draw = partial(series.draw_command, command=command, label=label)
    return Panel(name=label, needs=command, draw=draw)


FIGURES: Final[Mapping[str, FigureKind]] = MappingProxyType(
    {
        "plant": FigureKind(
            title="Impulse, step and ramp response of the plant 1/s",
            paper="2",
            draw=draw_plant_responses,
            height=0.36,
            needs="gain",
        ),
        "step-responses": FigureKind(
            title="Step responses of the ideal closed loop, with 4 tau",
            paper="4",
            draw=draw_step_responses,
            needs="gain",
        ),
        "root-locus": FigureKind(
            title="Root locus of the ideal closed loop",
            paper="5",
            draw=draw_root_locus,
            needs="gain",
        ),
        "heading": FigureKind(
            title="Heading, the goal bearing and the ideal response",
            paper="9-16",
            panels=(_signal("heading", "heading [deg]", "poses"),),
        ),
        "position": FigureKind(
            title="Position, the goal and the ideal response",
            paper="9-16",
            panels=(_signal("x", "x [m]", "poses"), _signal("y", "y [m]", "poses")),
            height=0.95,
        ),
        "heading-error": FigureKind(
            title="Heading error and the ideal response",
            paper="9-16",
            panels=(_signal("heading_error", "heading error [deg]"),),
        ),
        "position-error": FigureKind(
            title="Position error and the ideal response",
            paper="9-16",
            panels=(
                _signal("error_x", "error in x [m]", "goal"),
                _signal("error_y", "error in y [m]", "goal"),
            ),
            height=0.95,
        ),
        "turn-rate": FigureKind(
            title="Turn rate, its limits",
            paper="9-16",
            panels=(_command("turn_rate", "turn rate"),),
        ),
        "speed": FigureKind(
            title="Speed, its limits",
            paper="14",
            panels=(_command("speed", "speed"),),
        ),
        "wanted-speed": FigureKind(
            title="Speed that the law wanted, before clipping",
            paper="14",
            panels=(
                Panel(
                    name="wanted speed",
                    needs="wanted",
                    draw=partial(series.draw_wanted, command="speed", label="wanted speed"),
                ),
            ),
        ),
        "world-velocity": FigureKind(
            title="Gain times error in the world frame, before projection and clipping",
            paper="9-16",
            panels=(
                _signal("world_velocity_x", "$K_p e_x$ [m/s]"),
                _signal("world_velocity_y", "$K_p e_y$ [m/s]"),
            ),
            height=0.95,
        ),
        "error-log": FigureKind(
            title="Magnitude of the errors on a logarithmic scale, the ideal decay, the tolerances",
            paper="",
            panels=(
                _magnitude("heading_error", "|heading error| [deg]", "samples"),
                _magnitude("distance", "distance [m]", "goal"),
            ),
            height=0.95,
        ),
        "plane": FigureKind(
            title="Paths in the plane, and how each run ends",
            paper="17",
            draw=draw_plane,
            height=0.57,
            needs="poses",
        ),
        "panel": FigureKind(
            title="Both loops, what they missed and what they were told",
            paper="",
            panels=(
                _signal("heading", "heading [deg]", "poses"),
                _signal("along_track", "along-track [m]"),
                _magnitude("heading_error", "|heading error| [deg]", "samples"),
                _signal("cross_track", "cross-track [m]"),
                _command("turn_rate", "turn rate"),
                _command("speed", "speed"),
            ),
            arrange=series.draw_columns,
            height=0.85,
        ),
    }
)
"""Every figure by name."""
