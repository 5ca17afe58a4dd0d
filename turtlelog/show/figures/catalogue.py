"""The figures by name: what each shows, what it needs, and how it is drawn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Final

from matplotlib.figure import Figure

from turtlelog.run import Run
from turtlelog.show.figures import series
from turtlelog.show.figures.plane import draw_plane
from turtlelog.show.figures.theory import (
    draw_plant_responses,
    draw_root_locus,
    draw_step_responses,
)

Draw = Callable[[Figure, Sequence[Run]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureKind:
    """One figure.

    Attributes:
        title: What it shows, for captions.
        paper: The paper's figure that it stands beside; empty where there is none.
        draw: Draws it for some runs; theory needs none.
        height: Over its width.
        needs: `nothing`, `poses`, `goal` or `samples`: what at least one run must hold.
    """

    title: str
    paper: str
    draw: Draw
    height: float = 0.62
    needs: str = "samples"

    def find_lack(self, runs: Sequence[Run]) -> str | None:
        """Return what is missing to draw it, None where nothing is."""
        if self.needs == "nothing":
            return None
        if not runs:
            return "a recording"
        if self.needs == "goal" and all(run.goal_xy_m is None for run in runs):
            return "a goal"
        if self.needs == "samples" and not any(len(run.samples) for run in runs):
            return "the controller's samples"
        return None


def _stack(*panels: Callable[..., None]) -> Draw:
    return partial(series.draw_stack, panels=panels)


def _signal(signal: str, label: str) -> Callable[..., None]:
    return partial(series.draw_signal, signal=signal, label=label)


def _magnitude(signal: str, label: str) -> Callable[..., None]:
    return partial(series.draw_error_magnitude, signal=signal, label=label)


FIGURES: Final[Mapping[str, FigureKind]] = MappingProxyType(
    {
        "plant": FigureKind(
            title="Impulse, step and ramp response of the plant 1/s",
            paper="2",
            draw=draw_plant_responses,
            height=0.36,
            needs="nothing",
        ),
        "step-responses": FigureKind(
            title="Step responses of the ideal closed loop, with 4 tau",
            paper="4",
            draw=draw_step_responses,
            needs="nothing",
        ),
        "root-locus": FigureKind(
            title="Root locus of the ideal closed loop",
            paper="5",
            draw=draw_root_locus,
            needs="nothing",
        ),
        "heading": FigureKind(
            title="Heading, the goal bearing and the ideal response",
            paper="9-16",
            draw=_stack(_signal("heading", "heading [deg]")),
        ),
        "position": FigureKind(
            title="Position, the goal and the ideal response",
            paper="9-16",
            draw=_stack(_signal("x", "x [m]"), _signal("y", "y [m]")),
            height=0.95,
            needs="poses",
        ),
        "heading-error": FigureKind(
            title="Heading error and the ideal response",
            paper="9-16",
            draw=_stack(_signal("heading_error", "heading error [deg]")),
        ),
        "position-error": FigureKind(
            title="Position error and the ideal response",
            paper="9-16",
            draw=_stack(_signal("error_x", "error in x [m]"), _signal("error_y", "error in y [m]")),
            height=0.95,
            needs="goal",
        ),
        "turn-rate": FigureKind(
            title="Turn rate, its limits",
            paper="9-16",
            draw=_stack(partial(series.draw_command, command="turn_rate", label="turn rate")),
        ),
        "speed": FigureKind(
            title="Speed, its limits",
            paper="14",
            draw=_stack(partial(series.draw_command, command="speed", label="speed")),
        ),
        "wanted-speed": FigureKind(
            title="Speed that the law wanted, before clipping",
            paper="14",
            draw=_stack(partial(series.draw_wanted, command="speed", label="wanted speed")),
        ),
        "world-velocity": FigureKind(
            title="Gain times error in the world frame, before projection and clipping",
            paper="9-16",
            draw=_stack(
                _signal("world_velocity_x", "$K_p e_x$ [m/s]"),
                _signal("world_velocity_y", "$K_p e_y$ [m/s]"),
            ),
            height=0.95,
        ),
        "error-log": FigureKind(
            title="Magnitude of the errors on a logarithmic scale, the ideal decay, the tolerances",
            paper="",
            draw=_stack(
                _magnitude("heading_error", "|heading error| [deg]"),
                _magnitude("distance", "distance [m]"),
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
            draw=series.draw_panel,
            height=0.85,
        ),
    }
)
"""Every figure by name."""
