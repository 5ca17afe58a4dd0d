"""Names in a recording: where each thing of a run is found. docs/rerun.md explains them."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from rerun import escape_entity_path_part

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
START: Final = "plane/start"
GOAL: Final = "plane/goal"
TOLERANCE: Final = "plane/goal/tolerance"
NAMES: Final = "plane/names"
EXTREMES: Final = "plane/names/extremes"
END: Final = "plane/end"
CLOSE_UP: Final = "plane/close_up"
RINGS: Final = "plane/close_up/rings"
RING_NAMES: Final = "plane/close_up/rings/names"
MISSES: Final = "plane/close_up/misses"
WORST: Final = "plane/close_up/worst"
WORST_NAME: Final = "plane/close_up/worst/name"

POSITION: Final = "position"
POSITION_ERROR: Final = "position_error"
HEADING: Final = "heading_deg"
HEADING_ERROR: Final = "heading_error_deg"
HEADING_ERROR_LOG: Final = "heading_error_log10"
ALONG_TRACK: Final = "along_track"
ALONG_TRACK_ERROR: Final = "along_track_error"
CROSS_TRACK: Final = "cross_track"
DISTANCE: Final = "distance"
DISTANCE_LOG: Final = "distance_log10"
SPEED: Final = "speed"
TURN_RATE: Final = "turn_rate"
COMMANDED: Final = "commanded"
WANTED: Final = "wanted"
SHAPED: Final = "shaped"
APPLIED: Final = "applied"
MEASURED: Final = "as_measured"  # before `commanded`: the viewer draws later names on top
OUTLIERS: Final = "outliers"
SENSED: Final = "sensed"
DROPPED_OUT: Final = "dropped_out"
WORLD_VELOCITY: Final = "world_velocity"
STATE: Final = "state"
IDEAL: Final = "ideal"
SAMPLED: Final = "sampled"
AIMED: Final = "reference"
BEARING_NOW: Final = "bearing_now"
TO_REFERENCE: Final = "to_reference"
MARKS: Final = "marks"

PHASE: Final = "phase"
DEAD_TIME: Final = "dead_time"
EVENTS: Final = "events"
LINES: Final = "lines"
DOCUMENTS: Final = "documents"
REFERENCE: Final = "reference"
RUNS: Final = "runs"
GHOSTS: Final = "ghosts"
"""Plots draw curves in the order of their paths: a run above its ghosts."""

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
"""Below it, in the order of drawing, as the viewer draws later names on top: band to points."""


PLOTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "heading": HEADING,
        "along_track": ALONG_TRACK,
        "cross_track": CROSS_TRACK,
        "distance": DISTANCE,
    }
)
"""The plot of each signal that a loop can control."""


TITLES: Final[Mapping[str, str]] = MappingProxyType(
    {
        HEADING: "Heading [deg]",
        HEADING_ERROR: "Heading error [deg]",
        HEADING_ERROR_LOG: "log₁₀ heading error [deg]",
        TURN_RATE: "Turn rate [rad/s]",
        POSITION: "Position [m]",
        POSITION_ERROR: "Position error [m]",
        ALONG_TRACK: "Along-track [m]",
        ALONG_TRACK_ERROR: "Along-track error [m]",
        CROSS_TRACK: "Cross-track [m]",
        DISTANCE: "Distance [m]",
        DISTANCE_LOG: "log₁₀ distance [m]",
        SPEED: "Speed [m/s]",
        GAP_MM: "Distance to ghost [mm]",
        GAP_M: "Distance to ghost [m]",
        WORLD_VELOCITY: "World velocity [m/s]",
    }
)
"""Titles of plots."""


def join_path(*parts: str) -> str:
    """Return an entity path from parts that are escaped already; empty ones are left out."""
    return "/" + "/".join(part.strip("/") for part in parts if part.strip("/"))


def locate_phases(prefix: str) -> str:
    """Return where the phases of a run are: views of phases show paths as names of their rows."""
    return join_path(PHASE, prefix.rpartition("/")[2])


def locate_dead_times(prefix: str) -> str:
    """Return where the dead times of a run are: a row below that of its phases."""
    return f"{locate_phases(prefix)}_{DEAD_TIME}"


def name_part(name: str) -> str:
    """Return a part of an entity path that is as readable as a name: `_` for what needs escapes."""
    kept = [letter if escape_entity_path_part(letter) == letter else " " for letter in name]
    return "_".join("".join(kept).split()) or escape_entity_path_part(name)


def name_document(title: str) -> str:
    """Return the entity path of a document."""
    return join_path(DOCUMENTS, escape_entity_path_part(title))
