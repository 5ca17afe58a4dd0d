"""Entity names in a recording, which docs/rerun.md explains."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from rerun import escape_entity_path_part

from turtlelog.charts.plotted_curves import TimePlot
from turtlelog.charts.time_plots import TIME_PLOTS

APPLICATION_ID: Final = "turtlelog"
TICKS: Final = "tick"
PLANE: Final = "plane"
PATH: Final = "plane/path"
TRAIL: Final = "plane/trail"
SPEED_PATH: Final = "plane/path_by_speed"
ERROR: Final = "plane/error"
EVENT_PLACES: Final = "plane/events"
VIOLATION: Final = "plane/violation"
VIOLATED_STRETCH: Final = "plane/violated"
TRACKED_PATH: Final = "plane/tracked_path"
REFERENCE_PATH: Final = "plane/reference_path"
SENSED_PLACES: Final = "plane/sensed"
DROPPED_PLACES: Final = "plane/dropped_out"
REFERENCE_POSE: Final = "plane/reference_pose"
TURTLE: Final = "plane/turtle"
BODY: Final = "plane/turtle/body"
SHELL: Final = "plane/turtle/body/shell"
ARROW: Final = "plane/turtle/arrow"
COMMAND: Final = "plane/turtle/command"
BORDER: Final = "plane/border"
MAP: Final = "plane/map"
COSTMAP: Final = "plane/costmap"
WALLS: Final = "plane/walls"
SCAN: Final = "plane/scan"
START: Final = "plane/start"
GOAL: Final = "plane/goal"
TOLERANCE: Final = "plane/goal/tolerance"
NAMES: Final = "plane/names"
EXTREMES: Final = "plane/names/extremes"
END: Final = "plane/end"
ENDS: Final = "plane/ends"
OUTLINES: Final = "plane/ends/outlines"
MEDIANS: Final = "plane/ends/medians"
CLOSE_UP: Final = "plane/close_up"
RINGS: Final = "plane/close_up/rings"
RING_NAMES: Final = "plane/close_up/rings/names"
MISSES: Final = "plane/close_up/misses"
WORST: Final = "plane/close_up/worst"
WORST_NAME: Final = "plane/close_up/worst/name"
POSITION: Final = "position"
HEADING: Final = "heading_deg"
HEADING_ERROR: Final = "heading_error_deg"
ALONG_TRACK: Final = "along_track"
SPEED: Final = "speed"
TURN_RATE: Final = "turn_rate"
MEASURED: Final = "as_measured"  # sorted before `commanded`: the viewer draws later names on top
OUTLIERS: Final = "outliers"
SENSED: Final = "sensed"
DROPPED_OUT: Final = "dropped_out"
STATE: Final = "state"
IDEAL: Final = "ideal"
SAMPLED: Final = "sampled"
MARKS: Final = "marks"
PHASE: Final = "phase"
DEAD_TIME: Final = "dead_time"
EVENTS: Final = "events"
LINES: Final = "lines"
DOCUMENTS: Final = "documents"
REFERENCE: Final = "reference"
RUNS: Final = "runs"
GHOSTS: Final = "ghosts"
"""Prefix of ghosts. Plots draw curves in the order of their paths, so a run is above its ghosts."""

LEGEND: Final = "legend"
STEPS: Final = "attribution"
LUCK: Final = "luck"
LUCK_ENDS: Final = "plane/close_up/luck"
GAP: Final = "plane/gap"
GAP_NAME: Final = "plane/names/gap"
KEY: Final = "plane/names/key"
KEY_NAMES: Final = "plane/names/key/words"
GAP_MM: Final = "gap_mm"
GAP_M: Final = "gap_m"
VIOLATED: Final = "violated"
"""Prefix of a violation's entities, from band to points. The viewer draws later names on top."""


def name_plot(name: str) -> str:
    """Return the entity of a plot over time. x and y share an entity; angles include their unit."""
    plot = TIME_PLOTS[name]
    return plot.pair or (f"{name}_deg" if plot.unit == "deg" else name)


def name_logarithm(entity: str) -> str:
    """Return the entity of the logarithm of a plot."""
    return f"{entity.removesuffix('_deg')}_log10"


def _group_plots() -> dict[str, tuple[TimePlot, ...]]:
    groups: dict[str, tuple[TimePlot, ...]] = {}
    for name, plot in TIME_PLOTS.items():
        entity = name_plot(name)
        groups[entity] = (*groups.get(entity, ()), plot)
    return groups


GROUPS: Final[Mapping[str, tuple[TimePlot, ...]]] = MappingProxyType(_group_plots())
"""Plots over time of each entity. x and y share an entity."""

RESTLESS: Final = frozenset(name for name, plots in GROUPS.items() if plots[0].is_filled)
"""Plots without the curves of those runs among many that never settle."""


def title_plot(entity: str) -> str:
    """Return the title of a plot from its entity."""
    if entity in GROUPS:
        plots = GROUPS[entity]
        title = plots[0].title if len(plots) == 1 else entity.replace("_", " ")
        return f"{title.capitalize()} [{plots[0].unit}]"
    for name, plots in GROUPS.items():
        if entity == name_logarithm(name):
            return f"log₁₀ {plots[0].label}"
    return {GAP_MM: "Distance to ghost [mm]", GAP_M: "Distance to ghost [m]"}[entity]


def join_path(*parts: str) -> str:
    """Return an entity path from escaped parts, without empty parts."""
    return "/" + "/".join(part.strip("/") for part in parts if part.strip("/"))


def locate_phases(prefix: str) -> str:
    """Return the entity of a run's phases. Views of phases show the paths as names of rows."""
    return join_path(PHASE, prefix.rpartition("/")[2])


def locate_dead_times(prefix: str) -> str:
    """Return the entity of a run's dead times, shown in a row below its phases."""
    return f"{locate_phases(prefix)}_{DEAD_TIME}"


def name_part(name: str) -> str:
    """Return a readable part of an entity path. Characters that need escapes become `_`."""
    kept = [letter if escape_entity_path_part(letter) == letter else " " for letter in name]
    return "_".join("".join(kept).split()) or escape_entity_path_part(name)


def name_document(title: str) -> str:
    """Return the entity path of a document."""
    return join_path(DOCUMENTS, escape_entity_path_part(title))
