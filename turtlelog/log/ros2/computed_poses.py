"""Computation of poses from other messages: satellite fixes, or rotations of two wheels."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.display import describe_count, format_short
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.planar_poses import Values
from turtlelog.log.ros2.bag_rows import OrderedRows
from turtlelog.log.ros2.reported_motion import STRIDE_NS
from turtlelog.log.ros2.stamps import TimesNs, join_arrays, join_stamps, read_stamps, thin_rows
from turtlelog.log.units import CURVED_RAD, fits_degrees
from turtlelog.run.angles import wrap_angle

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")


def _join_messages(found: Sequence[TopicColumns], names: Sequence[str]) -> TopicColumns:
    """Return the messages of a topic in all files in order of log time, with stamps (or 0)."""
    for columns in found:
        for name in names:
            if name not in columns.fields:
                raise columns.describe_missing(name)
    log_ns, stamp_ns = join_arrays([columns.log_time_ns for columns in found]), join_stamps(found)
    stamps = np.divmod(np.zeros_like(log_ns) if stamp_ns is None else stamp_ns, 1_000_000_000)
    joined = TopicColumns(
        topic=found[0].topic,
        type=found[0].type,
        log_time_ns=log_ns,
        publish_time_ns=join_arrays([columns.publish_time_ns for columns in found]),
        sequence=join_arrays([columns.sequence for columns in found]),
        fields=dict(zip(_STAMP, stamps, strict=True))
        | {
            name: np.concatenate([np.asarray(columns.fields[name]) for columns in found])
            for name in names
        },
    )
    return joined.select(np.argsort(log_ns, kind="stable"))


def _time_motion(messages: TopicColumns) -> Values:
    """Return the time of the motion [s], shape (n,): increasing stamps, otherwise log times."""
    time_ns = read_stamps(messages)
    if time_ns is None or (time_ns <= 0).any() or (np.diff(time_ns) < 0).any():
        time_ns = messages.log_time_ns
    return np.asarray((time_ns - time_ns[:1]) / 1e9)


def _make_poses(
    messages: TopicColumns, rows: NDArray[np.int64], columns: Mapping[str, Values]
) -> TopicColumns:
    stamps = {name: messages.fields[name] for name in _STAMP}
    found = replace(messages, fields=stamps).select(rows)
    return replace(found, fields={**found.fields, **columns})


_FIX_FIELDS: Final = ("latitude", "longitude", "altitude", "status.status")

_AXIS_M: Final = 6_378_137.0
_FLATTENING: Final = 1.0 / 298.257223563
"""Flattening of the WGS84 ellipsoid (NGA.STND.0036)."""

_LEAST_WAY_M: Final = 0.5
"""Smallest distance over which a course is computed [m], suitable for noise up to 5 cm."""

_NOISES: Final = 10.0
"""The same distance in standard deviations of the noise, which turns the course by up to 8 deg."""

_LONGEST_S: Final = 10.0
"""Longest time in which a moving receiver covers this distance [s]: half a metre at 0.05 m/s. A
receiver at rest drifts by metres in minutes."""

_FEWEST: Final = 3
"""Number of fixes needed for a course: its own, one before and one after."""

_MEDIAN_OF_SECOND: Final = 2.884
"""Median length of second differences of positions, in standard deviations of one axis's noise:
sqrt(6) for the differences, times sqrt(2 ln 2) for the median of a Rayleigh distribution."""


def locate_fixes(found: Sequence[TopicColumns]) -> tuple[TopicColumns, dict[str, str]]:
    """Return the poses from fixes of sensor_msgs/NavSatFix, and notes on them.

    x, y and z are the distances east, north and above the first fix. The heading is the course
    while the receiver moves, held at rest, and before the first course equal to it.
    """
    messages = _join_messages(found, _FIX_FIELDS)
    latitude_deg, longitude_deg, altitude_m, status = (
        np.asarray(messages.fields[name], dtype=np.float64) for name in _FIX_FIELDS
    )
    is_fix = (status >= 0) & (np.abs(latitude_deg) <= 90.0) & (np.abs(longitude_deg) <= 360.0)
    # A receiver without a fix publishes zeros, a place off the coast of Africa.
    is_fix &= (latitude_deg != 0.0) | (longitude_deg != 0.0)
    rows = np.flatnonzero(is_fix)
    if not len(rows):
        raise LogError(
            f"topic {messages.topic}: expected a satellite fix, found none in"
            f" {describe_count(len(messages), 'message')}"
        )
    height_m = np.where(np.isfinite(altitude_m[rows]), altitude_m[rows], 0.0)
    place_m = project_fixes(latitude_deg[rows], longitude_deg[rows], height_m)
    motion_s = _time_motion(messages)[rows]
    heading_rad, way_m, held = find_courses(motion_s, place_m[:, :2])
    if np.isnan(heading_rad).any():
        standing = _describe_standing(motion_s, place_m)
        raise LogError(
            f"topic {messages.topic}: expected a receiver that moves by {way_m:.2g} m within"
            f" {_LONGEST_S:g} s, found {standing}: it has no heading"
        )
    columns = {"x": place_m[:, 0], "y": place_m[:, 1], "theta": heading_rad}
    if np.isfinite(altitude_m[rows]).all():
        columns["z"] = place_m[:, 2]
    lost = len(messages) - len(rows)
    notes = {
        "heading": _describe_courses("a receiver has no heading", way_m, held, len(rows)),
        "origin": (
            f"x is east and y north of {latitude_deg[rows[0]]:.7f} deg,"
            f" {longitude_deg[rows[0]]:.7f} deg (WGS84)"
        ),
    }
    if lost:
        notes["heading"] += f"; {describe_count(lost, 'message')} without a fix left out"
    return _make_poses(messages, rows, columns), notes


def _describe_standing(time_s: Values, place_m: Values) -> str:
    if len(time_s) < _FEWEST:
        return f"fewer than {_FEWEST} fixes"
    step_s = float(np.median(np.diff(time_s)))
    if step_s > _LONGEST_S / 2.0:
        return f"fixes {step_s:.3g} s apart, which is too seldom"
    extent_m = format_short(float(np.ptp(place_m[:, :2], axis=0).max()), "m")
    return f"a slower one, within {extent_m} in all"


def project_fixes(latitude_deg: Values, longitude_deg: Values, height_m: Values) -> Values:
    """Return positions east, north and above the first position [m], shape (n, 3).

    Heights are those above the ellipsoid: the earth curves away from a plane, by 5 cm in 0.8 km.
    """
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    squared = _FLATTENING * (2.0 - _FLATTENING)
    normal_m = _AXIS_M / np.sqrt(1.0 - squared * np.sin(latitude) ** 2)
    across_m = (normal_m + height_m) * np.cos(latitude)
    centred_m = np.column_stack(
        [
            across_m * np.cos(longitude),
            across_m * np.sin(longitude),
            (normal_m * (1.0 - squared) + height_m) * np.sin(latitude),
        ]
    )
    sin, cos = np.sin(latitude[0]), np.cos(latitude[0])
    sin_long, cos_long = np.sin(longitude[0]), np.cos(longitude[0])
    axes = np.array([[-sin_long, cos_long, 0.0], [-sin * cos_long, -sin * sin_long, cos]])
    level_m = (centred_m - centred_m[0]) @ axes.T
    return np.column_stack([level_m, height_m - height_m[0]])


def find_courses(time_s: Values, xy_m: Values) -> tuple[Values, float, int]:
    """Return courses [rad], the distance over which they are computed [m], and how many are held.

    A course leads from a position at least half this distance behind to one at least half of it
    ahead, both within ten seconds; otherwise the previous or first course is held. All are NaN if
    nothing moves. Times do not decrease, shape (n,); positions have the shape (n, 2).
    """
    second_m = np.hypot(*np.diff(xy_m, n=2, axis=0).T)
    noise_m = float(np.median(second_m)) / _MEDIAN_OF_SECOND if len(second_m) else 0.0
    way_m = max(_LEAST_WAY_M, _NOISES * noise_m)
    courses_rad = np.full(len(xy_m), np.nan)
    starts = np.searchsorted(time_s, time_s - _LONGEST_S)
    ends = np.searchsorted(time_s, time_s + _LONGEST_S, side="right")
    for row, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        behind = _find_far(xy_m[start:row][::-1] - xy_m[row], way_m / 2.0)
        ahead = _find_far(xy_m[row + 1 : end] - xy_m[row], way_m / 2.0)
        if behind is None or ahead is None:
            continue
        first, last = row - 1 - behind, row + 1 + ahead
        x_m, y_m = xy_m[last] - xy_m[first]
        # During a turn on the spot both ends are at one position and give no course.
        is_far = np.hypot(x_m, y_m) >= way_m / 2.0
        if is_far and time_s[last] - time_s[first] <= _LONGEST_S:
            courses_rad[row] = np.arctan2(y_m, x_m)
    known = np.flatnonzero(np.isfinite(courses_rad))
    held = len(xy_m) - len(known)
    if len(known):
        places = np.searchsorted(known, np.arange(len(xy_m)), side="right") - 1
        courses_rad = courses_rad[known[np.maximum(places, 0)]]
    return courses_rad, way_m, held


def _describe_courses(reason: str, way_m: float, held: int, count: int) -> str:
    """Return a sentence on courses that stand for headings for a reason."""
    return (
        f"the course over {way_m:.2g} m, as {reason}; held at either end and where it stands, for"
        f" {held} of {count} poses"
    )


_AROUND: Final = 2
"""Number of positions on either side in a median, which leaves out two outliers in a row."""


def take_courses(time_ns: TimesNs, xy_m: Values, reason: str) -> tuple[Values, str]:
    """Return courses [rad] that stand for headings for a reason, and the sentence on them."""
    padded_m = np.pad(xy_m, ((_AROUND, _AROUND), (0, 0)), mode="edge")
    median_m = np.median(sliding_window_view(padded_m, 2 * _AROUND + 1, axis=0), axis=-1)
    courses_rad, way_m, held = find_courses((time_ns - time_ns[0]) / 1e9, median_m)
    return courses_rad, _describe_courses(reason, way_m, held, len(xy_m))


def take_asked_courses(
    time_ns: NDArray[np.int64], x_m: Values, y_m: Values
) -> tuple[Values, dict[str, str]]:
    """Return courses as headings, NaN without a place, and a note on them."""
    heading_rad = np.full(len(x_m), np.nan)
    placed = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    xy_m = np.column_stack([x_m, y_m])[placed]
    if not len(placed):
        return heading_rad, {}
    heading_rad[placed], told = take_courses(time_ns[placed], xy_m, "asked for")
    if not np.isfinite(heading_rad).any():
        raise LogError("--column heading=course: the robot moves too little for a course")
    return heading_rad, {"heading": told}


def judge_headings(
    poses: OrderedRows, commands: OrderedRows | None, reports_sideways: Callable[[], bool]
) -> tuple[OrderedRows, dict[str, str], bool]:
    """Return poses with headings that fit the path, a note, and whether they are courses.

    Angles are in degrees if the direction of travel shows it. If the orientation never changes
    though the path turns, as in positions of a satellite receiver, courses stand for it, unless the
    robot publishes the applied speeds, moves to the side by its commands, its poses or (asked last)
    its other odometry, or reports the speed along this orientation.
    """
    columns = poses.columns
    heading_rad, xy_m = columns["heading"], np.column_stack([columns["x"], columns["y"]])
    if "tilt" not in columns and fits_degrees(xy_m, heading_rad):  # an angle, no quaternion
        columns = {**columns, "heading": np.radians(heading_rad)}
        note = {"heading": "in degrees, as the direction of travel shows"}
        return replace(poses, columns=columns), note, False
    asides = [columns.get("measured_lateral_speed")]
    asides.append(commands.columns["lateral_speed"] if commands else None)
    is_aside = any(aside is not None and np.nan_to_num(aside).any() for aside in asides)
    if is_aside or "speed" in columns or (heading_rad != heading_rad[:1]).any():
        return poses, {}, False
    reason = "the orientation never changes though the path turns"
    courses_rad, told = take_courses(poses.time_ns, xy_m, reason)
    # Reversing is no turn. Unknown courses are NaN, which exceeds no limit.
    if not float(np.ptp(np.unwrap(courses_rad, period=math.pi))) > CURVED_RAD:
        return poses, {}, False
    if _reports_ahead(poses.time_ns, columns) or reports_sideways():
        return poses, {}, False
    return replace(poses, columns={**columns, "heading": courses_rad}), {"heading": told}, True


_FITS_BETTER: Final = 3.0
"""Ratio of misfits from which reported speeds are those along the orientation, not the path: a
wheel that slips by a tenth, and noise, make both misfits alike."""


def _reports_ahead(time_ns: TimesNs, columns: Mapping[str, Values]) -> bool:
    """Return whether the reported speed is that along a constant heading: a robot drives aside."""
    speed_m_s, rows = columns.get("measured_speed"), thin_rows(time_ns, STRIDE_NS)
    if speed_m_s is None or not speed_m_s.any() or len(rows) < 2:
        return False
    step_s = np.diff(time_ns[rows]) / 1e9
    x_m_s, y_m_s = (np.diff(columns[axis][rows]) / step_s for axis in "xy")
    heading_rad = columns["heading"][0]
    ahead_m_s = x_m_s * np.cos(heading_rad) + y_m_s * np.sin(heading_rad)
    reported_m_s = np.add.reduceat(speed_m_s, rows)[:-1] / np.diff(rows)
    by_heading = np.abs(reported_m_s - ahead_m_s).mean()
    by_path = np.abs(np.abs(reported_m_s) - np.hypot(x_m_s, y_m_s)).mean()
    return bool(by_path > _FITS_BETTER * by_heading)


def _find_far(offsets_m: Values, least_m: float) -> int | None:
    """Return the index of the first offset that is long enough; None if no offset is."""
    far = np.flatnonzero(np.hypot(*offsets_m.T) >= least_m)
    return int(far[0]) if len(far) else None


_JOINT_FIELDS = ("name", "position", "velocity")


def integrate_wheels(
    found: Sequence[TopicColumns], joints: tuple[str, str], wheels_m: tuple[float, float]
) -> tuple[TopicColumns, str]:
    """Return poses computed from two wheels in sensor_msgs/JointState, and the method in words.

    The robot starts at the origin, along x. Between messages it drives the arc given by both
    wheels, which is exact if they turn evenly. Without positions, velocities are integrated: the
    mean of two messages times the time between their stamps.

    Args:
        found: Messages of JointState, by file.
        joints: Names of the left and the right wheel.
        wheels_m: Radius of the wheels, and the track between them [m].
    """
    messages = _join_messages(found, _JOINT_FIELDS)
    places = _find_joints(messages, joints)
    rows = np.flatnonzero((places >= 0).all(axis=1))
    if not len(rows):
        raise LogError(_describe_missing(messages, joints))
    turned_rad = _pick(messages.fields["position"], places, rows)
    rates_rad_s = _pick(messages.fields["velocity"], places, rows)
    notes = [f"of {joints[0]} and {joints[1]}, radius {wheels_m[0]:g} m, track {wheels_m[1]:g} m"]
    has_positions = bool(np.isfinite(turned_rad).all())
    if has_positions:
        turned_rad, wraps = _unwrap(turned_rad)
        steps_rad = np.diff(turned_rad, axis=0)
        if wraps:
            notes.append(f"{describe_count(wraps, 'step')} beyond half a turn taken as wrapped")
    elif np.isfinite(rates_rad_s).all():
        step_s = np.diff(_time_motion(messages)[rows])
        steps_rad = (rates_rad_s[1:] + rates_rad_s[:-1]) / 2.0 * step_s[:, np.newaxis]
        notes.append("by their velocities, as positions are absent")
    else:
        raise LogError(
            f"topic {messages.topic}: expected a position or a velocity of {joints[0]} and"
            f" {joints[1]} in every message, found neither in all"
        )
    columns = _drive_arcs(wheels_m[0] * steps_rad, wheels_m[1])
    if not has_positions:
        # If there are positions, velocities are ignored: many robots publish them in another unit.
        left_m_s, right_m_s = wheels_m[0] * rates_rad_s.T
        columns |= {
            "measured_speed": (left_m_s + right_m_s) / 2.0,
            "measured_turn_rate": (right_m_s - left_m_s) / wheels_m[1],
        }
    return _make_poses(messages, rows, columns), ", ".join(notes)


def _drive_arcs(steps_m: Values, track_m: float) -> dict[str, Values]:
    """Return x, y [m] and `theta` [rad] by the steps of left and right wheel, shape (n - 1, 2)."""
    turned_rad = (steps_m[:, 1] - steps_m[:, 0]) / track_m
    heading_rad = np.concatenate([[0.0], np.cumsum(turned_rad)])
    # Chord of an arc: sin(a) / a of half the rotation; np.sinc is sin(pi x) / (pi x).
    chord_m = steps_m.mean(axis=1) * np.sinc(turned_rad / 2.0 / np.pi)
    middle_rad = heading_rad[:-1] + turned_rad / 2.0
    ways = {"x": chord_m * np.cos(middle_rad), "y": chord_m * np.sin(middle_rad)}
    return {
        **{name: np.concatenate([[0.0], np.cumsum(way)]) for name, way in ways.items()},
        "theta": wrap_angle(heading_rad),
    }


def _find_joints(messages: TopicColumns, joints: tuple[str, str]) -> NDArray[np.int64]:
    """Return the indices of the joints in each message, shape (n, 2); -1 if missing."""

    @cache
    def find(listed: tuple[str, ...]) -> list[int]:
        return [listed.index(joint) if joint in listed else -1 for joint in joints]

    found = [find(tuple(names)) for names in messages.fields["name"]]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _pick(
    column: NDArray[np.object_], places: NDArray[np.int64], rows: NDArray[np.int64]
) -> Values:
    """Return two numbers of each message; NaN for a missing joint."""
    picked = np.full((len(rows), 2), np.nan)
    for number, row in enumerate(rows.tolist()):
        values = column[row]
        for side, place in enumerate(places[row].tolist()):
            if place < len(values):
                picked[number, side] = values[place]
    return picked


def _unwrap(turned_rad: Values) -> tuple[Values, int]:
    """Return unwrapped angles of joints that stay within one turn, and the number of wraps."""
    # An encoder of one turn counts from -180 to 180 deg or from 0 to 360 deg.
    low_rad, high_rad = (float(end) for end in (turned_rad.min(), turned_rad.max()))
    most_rad = np.pi * (1.0 + 1e-6)  # positions may have 32 bits
    is_wrapped = max(-low_rad, high_rad) <= most_rad or (
        low_rad >= 0.0 and high_rad <= 2.0 * most_rad
    )
    wraps = int((np.abs(np.diff(turned_rad, axis=0)) > np.pi).sum()) if is_wrapped else 0
    return (np.unwrap(turned_rad, axis=0) if wraps else turned_rad), wraps


def _describe_missing(messages: TopicColumns, joints: tuple[str, str]) -> str:
    names = sorted({name for listed in messages.fields["name"] for name in listed})
    found = ", ".join(names)[:300] or "none"
    for joint in joints:
        if joint not in names:
            return f"topic {messages.topic}: expected the joint {joint}, found {found}"
    return (
        f"topic {messages.topic}: expected {joints[0]} and {joints[1]} in one message, found each"
        " in others"
    )
