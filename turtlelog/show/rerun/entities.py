"""Names in a recording: where each thing of a run is found. docs/rerun.md explains them."""

from typing import Final

APPLICATION_ID: Final = "turtlelog"
TIMELINE: Final = "sim_time"

PLANE: Final = "plane"
PATH: Final = "plane/path"
TURTLE: Final = "plane/turtle"
ARROW: Final = "plane/turtle/arrow"
BORDER: Final = "plane/border"
START: Final = "plane/start"
GOAL: Final = "plane/goal"
TOLERANCE: Final = "plane/goal/tolerance"
NAMES: Final = "plane/names"

POSITION: Final = "position"
HEADING: Final = "heading_deg"
HEADING_ERROR: Final = "heading_error_deg"
ALONG_TRACK: Final = "along_track"
CROSS_TRACK: Final = "cross_track"
DISTANCE: Final = "distance"
SPEED: Final = "speed"
TURN_RATE: Final = "turn_rate"
COMMANDED: Final = "commanded"
WANTED: Final = "wanted"
APPLIED: Final = "applied"

PHASE: Final = "phase"
EVENTS: Final = "events"
DOCUMENTS: Final = "documents"
REFERENCE: Final = "reference"
RUNS: Final = "runs"
LEGEND: Final = "legend"


def join_path(*parts: str) -> str:
    """Return an entity path from parts that are escaped already; empty ones are left out."""
    return "/" + "/".join(part.strip("/") for part in parts if part.strip("/"))
