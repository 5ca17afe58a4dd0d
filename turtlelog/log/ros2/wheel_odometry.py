"""Wheel odometry of a differential drive: what two wheels turned, to poses."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.ros2.joined_messages import JoinedMessages, join_messages
from turtlelog.run.angles import wrap_angle

Values = NDArray[np.float64]

_FIELDS = ("name", "position", "velocity")


def integrate_wheels(
    found: Sequence[TopicColumns], joints: tuple[str, str], wheels_m: tuple[float, float]
) -> tuple[TopicColumns, str]:
    """Return the poses that two wheels of sensor_msgs/JointState tell, and how, in words.

    The robot starts at the origin, along x. From message to message it drives the arc of both
    wheels, which is exact where they turn evenly in between. Where positions are absent their
    velocities are integrated, the mean of two messages over the time between their stamps.

    Args:
        found: Messages of JointState, by file.
        joints: Names of the left and the right wheel.
        wheels_m: Radius of the wheels, and the track between them [m].

    Raises:
        LogError: Where no message holds both joints, or one has neither position nor velocity.
    """
    messages = join_messages(found, _FIELDS)
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
        step_s = np.diff(messages.motion_s[rows])
        steps_rad = (rates_rad_s[1:] + rates_rad_s[:-1]) / 2.0 * step_s[:, np.newaxis]
        notes.append("by their velocities, as positions are absent")
    else:
        raise LogError(
            f"topic {messages.topic}: expected a position or a velocity of {joints[0]} and"
            f" {joints[1]} in every message, found neither in all"
        )
    columns = drive_arcs(wheels_m[0] * steps_rad, wheels_m[1])
    if not has_positions:
        # Beside positions the velocities are left out: of many robots they have another unit.
        left_m_s, right_m_s = wheels_m[0] * rates_rad_s.T
        columns |= {
            "measured_speed": (left_m_s + right_m_s) / 2.0,
            "measured_turn_rate": (right_m_s - left_m_s) / wheels_m[1],
        }
    return messages.make_poses(rows, columns), ", ".join(notes)


def drive_arcs(steps_m: Values, track_m: float) -> dict[str, Values]:
    """Return x, y [m] and heading `theta` [rad] of a differential drive from the origin.

    Args:
        steps_m: Ways of the left and the right wheel from pose to pose [m], shape (n - 1, 2).
        track_m: Distance of the wheels [m].
    """
    turned_rad = (steps_m[:, 1] - steps_m[:, 0]) / track_m
    heading_rad = np.concatenate([[0.0], np.cumsum(turned_rad)])
    # The chord of an arc: sin(a) / a of half the turn; np.sinc is sin(pi x) / (pi x).
    chord_m = steps_m.mean(axis=1) * np.sinc(turned_rad / 2.0 / np.pi)
    middle_rad = heading_rad[:-1] + turned_rad / 2.0
    ways = {"x": chord_m * np.cos(middle_rad), "y": chord_m * np.sin(middle_rad)}
    return {
        **{name: np.concatenate([[0.0], np.cumsum(way)]) for name, way in ways.items()},
        "theta": wrap_angle(heading_rad),
    }


def _find_joints(messages: JoinedMessages, joints: tuple[str, str]) -> NDArray[np.int64]:
    """Return where the joints stand in each message, shape (n, 2); -1: nowhere."""
    places = np.full((len(messages), 2), -1)
    known: Mapping[tuple[str, ...], tuple[int, ...]] = {}
    for row, names in enumerate(messages.fields["name"]):
        listed = tuple(names)
        if listed not in known:
            found = tuple(listed.index(joint) if joint in listed else -1 for joint in joints)
            known = {**known, listed: found}
        places[row] = known[listed]
    return places


def _pick(
    column: NDArray[np.object_], places: NDArray[np.int64], rows: NDArray[np.int64]
) -> Values:
    """Return two numbers of each message; NaN where it has none of a joint."""
    picked = np.full((len(rows), 2), np.nan)
    for number, row in enumerate(rows.tolist()):
        values = column[row]
        for side, place in enumerate(places[row].tolist()):
            if place < len(values):
                picked[number, side] = values[place]
    return picked


def _unwrap(turned_rad: Values) -> tuple[Values, int]:
    """Return angles without wraps of joints that stay within one turn, and how many there were."""
    # From -180 to 180 deg or from 0 to 360 deg: what an encoder of one turn tells.
    low_rad, high_rad = (float(end) for end in (turned_rad.min(), turned_rad.max()))
    most_rad = np.pi * (1.0 + 1e-6)  # positions may have 32 bits
    is_wrapped = max(-low_rad, high_rad) <= most_rad or (
        low_rad >= 0.0 and high_rad <= 2.0 * most_rad
    )
    wraps = int((np.abs(np.diff(turned_rad, axis=0)) > np.pi).sum()) if is_wrapped else 0
    return (np.unwrap(turned_rad, axis=0) if wraps else turned_rad), wraps


def _describe_missing(messages: JoinedMessages, joints: tuple[str, str]) -> str:
    names = sorted({name for listed in messages.fields["name"] for name in listed})
    lacking = [joint for joint in joints if joint not in names]
    if not lacking:
        return (
            f"topic {messages.topic}: expected {joints[0]} and {joints[1]} in one message, found"
            " each in others"
        )
    found = ", ".join(names)[:300] or "none"
    return f"topic {messages.topic}: expected the joint {lacking[0]}, found {found}"
