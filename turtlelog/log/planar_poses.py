"""Poses in the plane and commands, from messages and quaternions; poses of two programs."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import LogError
from turtlelog.run import Origin
from turtlelog.run.angles import wrap_angle

Values = NDArray[np.float64]
Fields = Mapping[str, NDArray[Any]]

ROWS_AT_ONCE: Final = 65_536
"""Number of rows that are compared or computed at once."""

MOVED_M: Final = 0.1
"""Smallest extent of a robot that moved, without jumps [m]; noise of robots at rest is smaller."""

TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
FRAME_TRANSFORM: Final = "foxglove.FrameTransform"
TRANSFORM_TYPES: Final = (TRANSFORMS, FRAME_TRANSFORM)
FIX: Final = "sensor_msgs/msg/NavSatFix"
JOINTS: Final = "sensor_msgs/msg/JointState"
ODOMETRY: Final = "nav_msgs/msg/Odometry"


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseShape:
    """The fields of a pose in a message.

    Attributes:
        position: Prefix of x and y.
        orientation: Prefix of x, y, z and w of a quaternion, if there is no heading.
        heading: Field of the heading; None if there is a quaternion.
        is_degrees: Whether the heading is in degrees.
    """

    position: str
    orientation: str = ""
    heading: str | None = None
    is_degrees: bool = False


_STAMPED: Final = PoseShape(position="pose.position.", orientation="pose.orientation.")
_COVARIANT: Final = PoseShape(position="pose.pose.position.", orientation="pose.pose.orientation.")
_TRANSFORM: Final = PoseShape(position="transform.translation.", orientation="transform.rotation.")
POSE_TYPES: Final[Mapping[str, tuple[int, PoseShape | None]]] = {
    "turtlesim/msg/Pose": (0, None),
    "turtlesim_msgs/msg/Pose": (0, None),
    ODOMETRY: (1, _COVARIANT),
    "geometry_msgs/msg/PoseStamped": (2, _STAMPED),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (2, _COVARIANT),
    "geometry_msgs/msg/Pose": (3, PoseShape(position="position.", orientation="orientation.")),
    "geometry_msgs/msg/Pose2D": (3, PoseShape(position="", heading="theta")),
    "geometry_msgs/msg/TransformStamped": (4, _TRANSFORM),
    **dict.fromkeys(TRANSFORM_TYPES, (5, None)),
    FIX: (6, None),
}
"""The message types of poses: the priority among the topics of a bag, and the fields of the pose.

The lowest priority number is first: odometry, because it has rates, then types with stamps, and
satellite fixes last, because they give no heading. Types without fields have a reader of their
own."""

POSES_IN_SHORT: Final = (
    "turtlesim/msg/Pose, Odometry, Pose with or without stamp, Pose2D, /tf, and NavSatFix"
)

_OF_MODELS: Final = "poses of several models in each message; record the robot's own odometry"
OTHER_PLACES: Final[Mapping[str, str]] = {
    "foxglove.LocationFix": f"latitude and longitude, which are read from {FIX} only",
    "gazebo_msgs/msg/ModelStates": _OF_MODELS,
    "gazebo_msgs/msg/LinkStates": _OF_MODELS,
}
"""Message types of places that are not read as poses, with the reason."""

TWIST_TYPES: Final[Mapping[str, str]] = {
    "geometry_msgs/msg/Twist": "",
    "geometry_msgs/msg/TwistStamped": "twist.",
}
ACKERMANN_TYPES: Final[Mapping[str, str]] = {
    "ackermann_msgs/msg/AckermannDrive": "",
    "ackermann_msgs/msg/AckermannDriveStamped": "drive.",
}
COMMAND_TYPES: Final[Mapping[str, str]] = {**TWIST_TYPES, **ACKERMANN_TYPES}
"""The message types of commands, with the prefix of their fields."""

POSITIONS: Final = {kind: shape.position for kind, (_, shape) in POSE_TYPES.items() if shape}
"""Prefix of x and y in the fields of each pose type."""

_ANGLES: Final = ("theta", "heading", "yaw", "orientation.yaw", "rotation.yaw")


def extract_poses(kind: str, fields: Fields) -> dict[str, Values]:
    """Return x, y [m] and heading [rad], and speeds, height and tilt if messages contain them.

    turtlesim publishes the applied velocities (`speed`, `turn_rate`), odometry the measured ones
    (`measured_speed`, `measured_lateral_speed`, `measured_turn_rate`). `z` is the height [m],
    `tilt` the angle between the robot's vertical axis and the world's [rad].

    Raises:
        LogError: If no quaternion is a valid rotation.
        KeyError: If a field is missing.
    """
    if kind.startswith("turtlesim"):
        return {
            "x": widen(fields["x"]),
            "y": widen(fields["y"]),
            "heading": widen(fields["theta"]),
            # Before Humble, turtlesim also published the sign of the speed.
            "speed": np.abs(widen(fields["linear_velocity"])),
            "turn_rate": widen(fields["angular_velocity"]),
        }
    # Errors about missing fields name those of a stamped pose.
    shape = POSE_TYPES.get(kind, (0, None))[1] or find_pose_shape(fields) or _STAMPED
    if shape.heading is not None:
        heading_rad = widen(fields[shape.heading])
        columns = {"heading": np.radians(heading_rad) if shape.is_degrees else heading_rad}
    else:
        columns = _turn_quaternions(fields, shape.orientation)
    axes = "xyz" if f"{shape.position}z" in fields else "xy"
    columns |= {name: widen(fields[f"{shape.position}{name}"]) for name in axes}
    for name in ("measured_speed", "measured_turn_rate"):
        if kind == JOINTS and name in fields:
            columns[name] = widen(fields[name])
    if kind == ODOMETRY:
        rates = read_twist(fields, "twist.twist.")
        columns |= {f"measured_{name}": values for name, values in rates.items()}
    return columns


def find_pose_shape(fields: Collection[str]) -> PoseShape | None:
    """Return the fields of a pose in an unknown type, by their names (`_deg`: in degrees)."""
    places = [name[:-1] for name in fields if name == "x" or name.endswith(".x")]
    for place in (place for place in places if f"{place}y" in fields):
        home = place.removesuffix("position.").removesuffix("translation.")
        for turn in ("orientation", "rotation"):
            if home != place and all(f"{home}{turn}.{axis}" in fields for axis in "xyzw"):
                return PoseShape(position=place, orientation=f"{home}{turn}.")
        for name in (f"{home}{angle}{unit}" for angle in _ANGLES for unit in ("", "_rad", "_deg")):
            if name in fields:
                return PoseShape(position=place, heading=name, is_degrees=name.endswith("_deg"))
    return None


def find_twist(fields: Collection[str]) -> str | None:
    """Return the prefix of a twist in an unknown type, by the names of its fields."""
    needed = ("linear.x", "linear.y", "angular.z")
    prefixes = TWIST_TYPES.values()
    return next((one for one in prefixes if all(one + name in fields for name in needed)), None)


def read_twist(fields: Fields, prefix: str) -> dict[str, Values]:
    """Return forward and lateral speed [m/s] and turn rate [rad/s] after a prefix."""
    return {
        "speed": widen(fields[f"{prefix}linear.x"]),
        "lateral_speed": widen(fields[f"{prefix}linear.y"]),
        "turn_rate": widen(fields[f"{prefix}angular.z"]),
    }


def extract_commands(kind: str, fields: Fields, *, wheelbase_m: float | None) -> dict[str, Values]:
    """Return forward and lateral speed [m/s] and turn rate [rad/s].

    A car turns with speed * tan(steering angle) / wheelbase; NaN from 90 deg on.
    """
    if kind in ACKERMANN_TYPES and wheelbase_m is not None:
        drive = COMMAND_TYPES[kind]
        speed_m_s = widen(fields[f"{drive}speed"])
        steering_rad = widen(fields[f"{drive}steering_angle"])
        is_aside = np.abs(steering_rad) >= np.pi / 2.0  # No car turns with a wheel at 90 deg.
        steering_rad = np.where(is_aside, np.nan, steering_rad)
        return {
            "speed": speed_m_s,
            "lateral_speed": np.zeros_like(speed_m_s),
            "turn_rate": speed_m_s * np.tan(steering_rad) / wheelbase_m,
        }
    prefix = COMMAND_TYPES.get(kind)
    return read_twist(fields, (find_twist(fields) or "") if prefix is None else prefix)


def _turn_quaternions(fields: Fields, orientation: str) -> dict[str, Values]:
    """Return heading and tilt of quaternions of any length [rad]; NaN for length 0."""
    parts = [fields[f"{orientation}{name}"] for name in "xyzw"]
    name = orientation.removesuffix(".")
    yaw_rad, tilt_rad = np.empty(len(parts[0])), np.empty(len(parts[0]))
    empty = np.zeros(len(yaw_rad), dtype=np.bool_)
    for first in range(0, len(yaw_rad), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        x, y, z, w = (widen(part[rows]) for part in parts)
        # Messages have zeros by default in ROS 1, and in programs that never set the quaternion.
        empty[rows] = x**2 + y**2 + z**2 + w**2 == 0.0
        yaw_rad[rows], tilt_rad[rows] = compute_heading(x, y, z, w), compute_tilt(x, y, z, w)
    if len(empty) and empty.all():
        if len(empty) == 1:
            raise LogError(f"message 0: {name}: expected a rotation, found all zeros")
        raise LogError(
            f"{name}: expected rotations, found all zeros in each of {len(empty)} messages:"
            " it was never set, and there is no heading"
        )
    # Some programs set quaternions only from the second message on; a camera may lose its robot.
    yaw_rad[empty] = np.nan
    return {"heading": yaw_rad, "tilt": tilt_rad}


def widen(values: NDArray[Any]) -> Values:
    """Return numbers in double precision."""
    return np.ascontiguousarray(values, dtype=np.float64)


_MOST_HEIGHT_M: Final = 0.05
"""Range of heights that counts as a plane [m]: a door sill, or noise of a tracking camera."""

_MOST_TILT_RAD: Final = 0.1
"""Tilt that counts as upright [rad]: at 0.1 rad a path seen from above is 0.5 % too short."""

_LEAST_LEVEL: Final = math.cos(math.radians(85.0))
"""Smallest horizontal part of a forward axis of length 1 that gives a heading.

At 85 deg of pitch, 1 deg of noise turns the heading by 11 deg."""

_SEEN: Final = "most metrics are seen from above"


_HEIGHT_RANGE: Final = 9.0
"""Range of heights with white noise in a plane, in standard deviations: of 100,000 normal values it
is 8.8. The height of a satellite receiver scatters by some centimetres."""


def describe_height(z_m: Values | None, tilt_rad: Values | None) -> str | None:
    """Return a sentence on a robot that leaves the plane; None if it stays in the plane.

    Heights [m] and tilts [rad] that are not finite are ignored.
    """
    heights, tilts = _keep_finite(z_m), _keep_finite(tilt_rad)
    found = []
    bends_m = np.abs(np.diff(heights, 2))  # of white noise, with a median of 0.6745 sqrt(6) of it
    noise_m = float(np.median(bends_m)) / (0.6745 * math.sqrt(6.0)) if len(bends_m) else 0.0
    most_m = max(_MOST_HEIGHT_M, _HEIGHT_RANGE * noise_m)
    if len(heights) and (height := float(np.ptp(heights))) > most_m:
        low_m, high_m = float(heights.min()), float(heights.max())
        found.append(f"its height varies by {height:.3g} m ({low_m:.3g} to {high_m:.3g} m)")
    if len(tilts) and float(tilts.max()) > _MOST_TILT_RAD:
        ends = (f"{math.degrees(end):.3g}" for end in (tilts.min(), tilts.max()))
        tilt = f"{' to '.join(dict.fromkeys(ends))} deg"
        if not found and float(np.ptp(tilts)) <= _MOST_TILT_RAD:
            # For example a frame whose z axis points down, or that of a camera.
            return f"the robot or its frame is tilted by {tilt} throughout; {_SEEN}"
        found.append(f"it tilts by {tilt}")
    if not found:
        return None
    return f"the robot leaves the plane: {' and '.join(found)}; {_SEEN}"


def describe_order(
    x: Values, y: Values, z: Values, w: Values, *, names: Sequence[str]
) -> dict[str, str]:
    """Return a note on a robot that stays upright only if its quaternions begin with w.

    The columns of x, y, z and w have these `names`.
    """
    tilt_rad, other_rad = _keep_finite(compute_tilt(x, y, z, w)), compute_tilt(y, z, w, x)
    if not len(tilt_rad) or float(np.ptp(tilt_rad)) <= _MOST_TILT_RAD:
        return {}  # a frame that is tilted throughout
    if float(np.nanmax(other_rad)) > _MOST_TILT_RAD:
        return {}
    pairs = zip(("qw", "qx", "qy", "qz"), names, strict=True)
    options = " ".join(f"--column {part}='{name}'" for part, name in pairs)
    return {"quaternion_order": f"as w, x, y, z they keep the robot upright: {options}"}


def describe_level(z_m: Values | None) -> str | None:
    """Return a sentence on the height of a robot that stays in a plane; None if it is about 0."""
    heights = _keep_finite(z_m)
    if not len(heights) or abs(level_m := float(np.median(heights))) <= _MOST_HEIGHT_M:
        return None
    return f"the poses are at a height of {level_m:.3g} m, which is left out"


def lift_poses(z_m: Values | None, tilt_rad: Values | None) -> dict[str, Values]:
    """Return the heights and tilts of a robot that leaves the plane, by column name."""
    if describe_height(z_m, tilt_rad) is None:
        return {}
    found = {"height_m": z_m, "tilt_rad": tilt_rad}
    return {
        name: np.where(np.isfinite(values), values, np.nan)
        for name, values in found.items()
        if values is not None and np.isfinite(values).any()
    }


def compute_heading(x: Values, y: Values, z: Values, w: Values) -> Values:
    """Return the heading of the forward axis projected onto the plane, for any tilt [rad].

    It is NaN if the axis points up or down (`_LEAST_LEVEL`). No quaternion has length 0.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # lengths beyond 1e154 overflow
        left, ahead = 2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2
        level = np.hypot(left, ahead) >= _LEAST_LEVEL * (w**2 + x**2 + y**2 + z**2)
        return np.where(level, np.arctan2(left, ahead), np.nan)


def compute_tilt(x: Values, y: Values, z: Values, w: Values) -> Values:
    """Return the angle between the vertical axes before and after a rotation [rad], in [0, pi]."""
    return 2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z))


def _keep_finite(values: Values | None) -> Values:
    return np.zeros(0) if values is None else values[np.isfinite(values)]


def separate_times(time_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Return strictly increasing times, and how many were moved to 1 ns after the previous time.

    Rows with equal times are different ticks; dropping one would lose a step of the motion.
    """
    rows = np.arange(len(time_ns))
    moved = np.maximum.accumulate(time_ns - rows) + rows
    return moved, int((moved != time_ns).sum())


def sort_rows(
    time_ns: NDArray[np.int64], values: Mapping[str, Values]
) -> tuple[NDArray[np.int64], dict[str, Values], Origin]:
    """Return the rows sorted by time without duplicates, and the numbers of changed rows."""
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    if late:
        order = np.argsort(time_ns, kind="stable")
        time_ns = time_ns[order]
        values = {name: column[order] for name, column in values.items()}
    twice = np.flatnonzero(time_ns[1:] == time_ns[:-1])
    for column in values.values():
        bits = column.view(np.int64)
        twice = twice[bits[twice] == bits[twice + 1]]
    changed = Origin(sorted_rows=late, dropped_duplicates=len(twice))
    if len(twice):
        time_ns = np.delete(time_ns, twice + 1)
        values = {name: np.delete(column, twice + 1) for name, column in values.items()}
    return time_ns, dict(values), changed


def note_changes(origin: Origin) -> dict[str, str]:
    """Return notes on the numbers of rows that were sorted, and dropped as duplicates."""
    counts = (origin.sorted_rows, origin.dropped_duplicates)
    return dict(zip(("sorted_rows", "dropped_duplicates"), map(str, counts), strict=True))


def wrap_far_headings(heading_rad: Values) -> tuple[Values, int]:
    """Return headings within a float32 step of [-pi, pi), and the number of changed headings.

    turtlesim's own rounding exceeds that interval by less than a step; such headings are kept.
    """
    far = np.abs(heading_rad) > np.nextafter(np.float32(np.pi), np.float32(4.0))
    return np.where(far, wrap_angle(heading_rad), heading_rad), int(far.sum())


_LEAP_M: Final = 0.1
"""Smallest step of a leap [m]; the noise of a filter between two poses is smaller."""

_LEAP_BACK: Final = 0.2
"""Largest distance of a later pose from the start of the leap, as a share of the leap."""

_LEAP_SHARE: Final = 0.2
"""Smallest share of poses, or steps, that leap if two programs publish poses. One program may
publish only every fourth pose; a tenth of the poses of pure noise leap and return."""

_LEAP_ROWS: Final = 4


def describe_leaps(xy_m: Values) -> str | None:
    """Return a sentence on poses, as received, that alternate between two places; else None."""
    rows = len(xy_m) - _LEAP_ROWS
    if rows < _LEAP_ROWS:
        return None
    far_m = np.hypot(*(xy_m[1 : 1 + rows] - xy_m[:rows]).T)
    least_m = np.full(rows, np.inf)
    for later in range(2, _LEAP_ROWS + 1):
        np.minimum(least_m, np.hypot(*(xy_m[later : later + rows] - xy_m[:rows]).T), out=least_m)
    leaps = (far_m > _LEAP_M) & (least_m < _LEAP_BACK * far_m)
    if leaps.mean() <= _LEAP_SHARE:
        return None
    size_m = float(np.median(far_m[leaps]))
    return (
        f"poses leap to and fro by {size_m:.3g} m, {describe_count(int(leaps.sum()), 'time')}: two"
        " programs seem to publish them, and no motion can be told"
    )


_LEAST_LEAP_M: Final = 0.01
"""Smallest leap of a driving robot [m]; a filter's noise, and rounding, are smaller."""

_ROWS: Final = 4
"""Number of poses on either side that give the robot's motion. Leaps cancel out in them."""

_OPPOSITE: Final = 0.9
"""Cosine of the angle between a leap and the reverse of the next (26 deg) from which they agree."""

_MOST_LEAPS: Final = 0.8
"""Smallest share of leaps that the next leap reverses; for noise in any direction it is below
0.5."""

_FAR: Final = 5.0
"""Smallest motion in leaps: a robot at rest may alternate between two rounded positions."""


def describe_small_leaps(xy_m: Values) -> str | None:
    """Return a sentence on poses of two programs that are a few centimetres apart; else None."""
    # Messages that were recorded twice add steps of 0.
    xy_m = xy_m[np.append(True, (np.diff(xy_m, axis=0) != 0.0).any(axis=1))]
    if len(xy_m) <= 4 * _ROWS:
        return None
    drive_m = (xy_m[2 * _ROWS :] - xy_m[: -2 * _ROWS]) / (2 * _ROWS)
    steps_m = np.diff(xy_m, axis=0)[_ROWS - 1 : _ROWS - 1 + len(drive_m)]
    beyond_m = steps_m - drive_m
    size_m = np.hypot(*beyond_m.T)
    least_m = max(_LEAST_LEAP_M, 0.5 * float(np.quantile(size_m, 0.9)))
    leaps = np.flatnonzero(size_m > least_m)
    if len(leaps) < max(_LEAP_SHARE * len(size_m), 2):
        return None
    unit = beyond_m[leaps] / size_m[leaps, np.newaxis]
    is_back = -(unit[1:] * unit[:-1]).sum(axis=1) >= _OPPOSITE
    leap_m = float(np.median(size_m[leaps]))
    driven_m = float(np.hypot(*np.diff(xy_m[:: 2 * _ROWS], axis=0).T).sum())
    if is_back.mean() <= _MOST_LEAPS or driven_m < _FAR * leap_m:
        return None
    return (
        f"poses go to and fro by {leap_m:.3g} m, {describe_count(len(leaps), 'time')}, beside the"
        " way: two programs seem to publish them; a reported speed is more likely right than"
        " differences of poses"
    )
