"""Specifications: the requirements on recordings, as values and as JSON Schema."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

from turtlelog.compare import ALIGNMENTS, Delta, Tolerance, TrajectorySettings
from turtlelog.compare.trajectory_comparison import ALIGN_IN
from turtlelog.display import describe_count
from turtlelog.errors import CompareError
from turtlelog.escapes import escape_controls
from turtlelog.expressions import Expression
from turtlelog.log import ReadChoice
from turtlelog.log.read_choice import TimeSource
from turtlelog.measure import (
    ANY_LOOP,
    METRICS,
    SIGNALS,
    could_be_signal,
    find_metric_kind,
    list_ids_like,
)
from turtlelog.run.columns import Rebuilding, rebuild_value
from turtlelog.run.loops import DONE, NAME_PATTERN, RESERVED, STATE_PATTERN
from turtlelog.scenario import describe_unknown_key
from turtlelog.scenario.file_tables import name_key

FORMAT: Final = 1
"""Format of specifications; newer formats are refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One requirement.

    Attributes:
        name: Name of the check's table.
        kind: `expect`: a formula over metrics and parameters. `holds`: a formula also over signals
            and time.
        formula: Formula to check.
        phase: Segment for `holds`: `pause`, or a phase of the run's law with the following pause;
            None for the whole run.
        when: Condition without which the check is skipped; None: the check is never skipped.
        reason: Reason for the limit.
        is_observed: Whether the bound comes from a good run and is not yet confirmed.
    """

    name: str
    kind: Literal["expect", "holds"]
    formula: Expression
    phase: str | None = None
    when: Expression | None = None
    reason: str = ""
    is_observed: bool = False

    def describe(self) -> str:
        """Return the requirement as a text, with its segment."""
        return self.formula.text if self.phase is None else f"{self.formula.text} in {self.phase}"


def list_formula_names(checks: Sequence[Check]) -> set[str]:
    """Return the names in the formulas of checks."""
    formulas = [found for check in checks for found in (check.formula, check.when) if found]
    return {name for formula in formulas for name in formula.names}


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """Tolerances of the signals and metrics that are judged.

    Attributes:
        signals: Tolerances by the name of the signal, or of a law's state.
        metrics: Tolerances by the id of the metric. Ids of loops apply to any law.

    Raises:
        CompareError: If no law has such a signal or metric, or the tolerance does not fit it.
    """

    signals: Mapping[str, Tolerance] = field(default_factory=dict)
    metrics: Mapping[str, Tolerance] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for kind in ("signals", "metrics"):
            found = getattr(self, kind)
            for name, tolerance in found.items():
                place = f'{kind}."{name}"' if "." in name else f"{kind}.{name_key(name)}"
                if not is_known(kind, name):
                    known = list_nearby(kind, name)
                    raise CompareError(f"{place}: {describe_unknown_key(name, known)}")
                _require_fitting(kind, name, tolerance, place)
            object.__setattr__(self, kind, MappingProxyType(dict(found)))

    def __bool__(self) -> bool:
        return bool(self.signals or self.metrics)

    def __reduce__(self) -> Rebuilding:
        return rebuild_value(self)


USUAL_TRAJECTORY: Final = TrajectorySettings(deltas=(Delta(value=1.0, unit="m"),))
"""Default settings for errors of trajectories."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """A specification for recordings.

    Attributes:
        checks: Checks in the order of the file.
        tolerances: Allowed differences of signals and metrics from the reference.
        reference: Recording to which tolerances refer; None without tolerances.
        alignment: Alignment of runs and reference.
        trajectory: Settings for errors of trajectories relative to the reference.
        read: Topics, frames and goal to read from third-party files, also from the reference.
        source: Name of the file for messages.
    """

    checks: tuple[Check, ...] = ()
    tolerances: Tolerances = field(default_factory=Tolerances)
    reference: Path | None = None
    alignment: str = "first_sample"
    trajectory: TrajectorySettings = USUAL_TRAJECTORY
    read: ReadChoice = field(default_factory=ReadChoice)
    source: str = "specification"

    def __repr__(self) -> str:
        held = len(self.tolerances.signals) + len(self.tolerances.metrics)
        checks = describe_count(len(self.checks), "check")
        return escape_controls(
            f"<Spec {self.source}: {checks}, {describe_count(held, 'tolerance')}>"
        )


def is_known(kind: str, name: str) -> bool:
    """Return whether runs of any law can have a signal or metric with this name."""
    return could_be_signal(name) if kind == "signals" else find_metric_kind(name) is not None


def list_nearby(kind: str, name: str) -> list[str]:
    """Return the names among which corrections of a misspelled name are searched."""
    return list(SIGNALS) if kind == "signals" else [*METRICS, *list_ids_like(name)]


def _require_fitting(kind: str, name: str, tolerance: Tolerance, place: str) -> None:
    if kind == "metrics" and tolerance.time_s:
        raise CompareError(f"{place}.time_s: expected none for a metric, found {tolerance.time_s}")
    is_label = kind == "signals" and is_label_signal(name)
    if is_label and (tolerance.abs or tolerance.rel):
        key, found = ("abs", tolerance.abs) if tolerance.abs else ("rel", tolerance.rel)
        raise CompareError(f"{place}.{key}: expected none for a label, found {found}")


def is_label_signal(name: str) -> bool:
    """Return whether a signal is a label, which is either equal or not."""
    return name in SIGNALS and SIGNALS[name].compared_as == "label"


_TEXT: Final = {"type": "string", "pattern": "\\S"}
_REASON: Final = {**_TEXT, "description": "Why so much and no more."}
_NOT_NEGATIVE: Final = {"type": "number", "minimum": 0}

_LOOP = f"(?!(?:{'|'.join(sorted(RESERVED))})[.]){NAME_PATTERN}"
"""Pattern of loop names. The run's law determines the loops and phases."""


def build_schema() -> dict[str, Any]:
    """Return the schema, draft 2020-12. Formulas are texts that `turtlelog check` parses."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "turtlelog specification and tolerance file",
        "type": "object",
        "required": ["format"],
        "anyOf": [{"required": [key]} for key in ("checks", "signals", "metrics")],
        "additionalProperties": False,
        "properties": {
            "format": {"const": FORMAT, "description": "Of this file."},
            "reference": {
                **_TEXT,
                "description": "Recording that tolerances are taken from, relative to this file.",
            },
            "alignment": {
                "type": "string",
                "pattern": f"^(?:{'|'.join(ALIGNMENTS).replace('NAME', NAME_PATTERN)})$",
                "description": "How runs and reference are brought together in time.",
            },
            "trajectory": _build_trajectory(),
            "read": _build_read(),
            "checks": {
                "type": "object",
                "additionalProperties": _build_check(),
                "description": "What is to hold, by a name of your own.",
            },
            "signals": _build_signals(),
            "metrics": _build_metrics(),
        },
        "$defs": {
            "signal": _build_tolerance(has_time=True),
            "metric": _build_tolerance(has_time=False),
        },
    }


def _build_table(
    properties: Mapping[str, Any], *, description: str = "", **more: Any
) -> dict[str, Any]:
    """Return the schema of a table with these keys and no others."""
    told = {"description": description} if description else {}
    head = {"type": "object", "additionalProperties": False, **told}
    return {**head, "properties": properties, **more}


def _build_trajectory() -> dict[str, Any]:
    return _build_table(
        {
            "align": {"enum": [*ALIGN_IN], "description": "Transformation that is fitted."},
            "associate": {
                "enum": [*ASSOCIATIONS],
                "description": "Poses of one moment: nearest in time, or linearly interpolated.",
            },
            "max_difference_s": {
                **_NOT_NEGATIVE,
                "description": "Largest difference in time between poses that belong together [s].",
            },
            "time_offset_s": {
                "anyOf": [{"type": "number"}, {"const": "start"}],
                "description": "Added to times of a recording [s]; start: first poses together.",
            },
            "rpe": {**_TEXT, "description": "Length of relative motions, as in 1m or 30deg."},
            "all_pairs": {
                "type": "boolean",
                "description": "A relative motion begins at every pose.",
            },
        },
        description="How ate.* and rpe.* are measured beside the reference.",
    )


ASSOCIATIONS: Final = ("nearest", "linear")
"""Methods of finding poses at equal times."""


def _build_read() -> dict[str, Any]:
    positive = {"type": "number", "exclusiveMinimum": 0}
    return _build_table(
        {
            **{name: {**_TEXT, "description": text} for name, text in READ_TEXTS.items()},
            "goal": {
                **_build_list({"type": "number"}, 2, 3),
                "description": "x, y [m] and perhaps the heading [rad].",
            },
            "wheels": {
                **_build_list(positive, 2, 2),
                "description": "Radius of the wheels, and the distance between them [m].",
            },
            "wheelbase": {
                **positive,
                "description": "Distance of the axles [m], for Ackermann commands.",
            },
            "time": {
                "enum": [*get_args(TimeSource)],
                "description": "What times poses: the recorder, their stamps, or as is best.",
            },
            "columns": {
                "type": "object",
                "additionalProperties": _TEXT,
                "description": "Of a plain table: the column of t, x, y, heading ...",
            },
        },
        description="What is read of third-party files, also of the reference.",
    )


def _build_list(items: Mapping[str, Any], fewest: int, most: int) -> dict[str, Any]:
    return {"type": "array", "items": items, "minItems": fewest, "maxItems": most}


READ_TEXTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "pose_topic": "Poses.",
        "command_topic": "Commands: Twist, TwistStamped, or Ackermann's with a wheelbase.",
        "robot": "Of several robots in a bag the one of this name.",
        "path_topic": "The path to be followed: nav_msgs/Path.",
        "pose_frame": "The robot's frame, of poses from transforms.",
        "world_frame": "The frame in which poses from transforms are given.",
        "wheel_joints": "Joints of the left and the right wheel, whose odometry poses are.",
    }
)
"""Keys of `[read]` with text values, and their meanings."""


def _build_check() -> dict[str, Any]:
    return _build_table(
        {
            "expect": {**_TEXT, "description": "Formula over metrics and parameters."},
            "holds": {**_TEXT, "description": "Formula over signals and time."},
            "phase": {
                "type": "string",
                "pattern": f"^(?!{DONE}$){NAME_PATTERN}$",
                "description": "Stretch that holds looks at: a phase of the law, or pause.",
            },
            "when": {**_TEXT, "description": "Otherwise the check is skipped."},
            "reason": _REASON,
            "observed": {
                "type": "boolean",
                "description": "The bound was read off a good run; nobody has thought about it.",
            },
        },
        oneOf=[{"required": ["expect"]}, {"required": ["holds"]}],
        dependentRequired={"phase": ["holds"]},
    )


def _build_signals() -> dict[str, Any]:
    """Return the schema of signals by name; any law may have further states."""
    return _build_table(
        {name: _describe("signal", found.unit, found.meaning) for name, found in SIGNALS.items()},
        patternProperties={f"^{STATE_PATTERN}$": {"$ref": "#/$defs/signal"}},
    )


def _build_metrics() -> dict[str, Any]:
    """Return the schema of metrics by id. Ids of loops are valid for any law."""
    described = {
        name: _describe("metric", found.unit, found.meaning) for name, found in METRICS.items()
    }
    patterns = {name: name.partition(f"{ANY_LOOP}.")[2] for name in METRICS if ANY_LOOP in name}
    return _build_table(
        {name: found for name, found in described.items() if name not in patterns},
        patternProperties={
            f"^{_LOOP}[.]{plain}$": described[name] for name, plain in patterns.items()
        },
    )


def _describe(kind: str, unit: str, meaning: str) -> dict[str, Any]:
    return {"$ref": f"#/$defs/{kind}", "description": f"[{unit}] {meaning}"}


def _build_tolerance(*, has_time: bool) -> dict[str, Any]:
    share = {**_NOT_NEGATIVE, "maximum": 1}
    properties = {
        "abs": {
            **_NOT_NEGATIVE,
            "description": "How far from the reference, in the unit of the name.",
        },
        "rel": {**share, "description": "As a share of the reference."},
        "reason": _REASON,
    }
    if has_time:
        properties["time_s"] = {**_NOT_NEGATIVE, "description": "How far in time [s]."}
    return {"type": "object", "required": ["reason"], **_build_table(properties)}
