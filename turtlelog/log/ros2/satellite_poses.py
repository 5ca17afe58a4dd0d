"""Positions of a satellite receiver, on the plane that touches the ellipsoid where it starts."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, format_short
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.ros2.joined_messages import join_messages

Values = NDArray[np.float64]

_FIELDS: Final = ("latitude", "longitude", "altitude", "status.status")

_AXIS_M: Final = 6_378_137.0
_FLATTENING: Final = 1.0 / 298.257223563
"""Of the ellipsoid of WGS84 (NGA.STND.0036)."""

_LEAST_WAY_M: Final = 0.5
"""Way at least over which a course is taken [m]: for a noise of 5 cm or less."""

_NOISES: Final = 10.0
"""Way in standard deviations of the noise: its ends turn it by sqrt(2) / 10 rad, 8 deg."""

_LONGEST_S: Final = 10.0
"""Time in which a receiver that moves comes so far [s]: at 0.05 m/s half a metre. One that stands
wanders by metres in minutes."""

_FEWEST: Final = 3
"""Fixes that a course needs: its own, one behind and one ahead."""

_MEDIAN_OF_SECOND: Final = 2.884
"""Median length of second differences of positions in the plane, in standard deviations of the
noise of one axis: sqrt(6) of a second difference, times sqrt(2 ln 2) of a Rayleigh distribution."""


def locate_fixes(found: Sequence[TopicColumns]) -> tuple[TopicColumns, dict[str, str]]:
    """Return the poses that fixes of sensor_msgs/NavSatFix tell, and notes on them.

    x is east, y north and z up of the first fix. The heading is the course where the receiver
    moves, held where it stands, and the first one before that.

    Args:
        found: Messages of NavSatFix, by file.

    Raises:
        LogError: Where there is no fix, or the receiver never moves.
    """
    messages = join_messages(found, _FIELDS)
    latitude_deg, longitude_deg, altitude_m, status = (
        np.asarray(messages.fields[name], dtype=np.float64) for name in _FIELDS
    )
    is_fix = (status >= 0) & (np.abs(latitude_deg) <= 90.0) & (np.abs(longitude_deg) <= 360.0)
    # A receiver that has found nothing yet publishes zeros, off the coast of Africa.
    is_fix &= (latitude_deg != 0.0) | (longitude_deg != 0.0)
    rows = np.flatnonzero(is_fix)
    if not len(rows):
        raise LogError(
            f"topic {messages.topic}: expected a satellite fix, found none in"
            f" {describe_count(len(messages), 'message')}"
        )
    height_m = np.where(np.isfinite(altitude_m[rows]), altitude_m[rows], 0.0)
    place_m = project_fixes(latitude_deg[rows], longitude_deg[rows], height_m)
    heading_rad, way_m, held = find_courses(messages.motion_s[rows], place_m[:, :2])
    if np.isnan(heading_rad).any():
        standing = _describe_standing(messages.motion_s[rows], place_m)
        raise LogError(
            f"topic {messages.topic}: expected a receiver that moves by {way_m:.2g} m within"
            f" {_LONGEST_S:g} s, found {standing}: it has no heading"
        )
    columns = {"x": place_m[:, 0], "y": place_m[:, 1], "theta": heading_rad}
    if np.isfinite(altitude_m[rows]).all():
        columns["z"] = place_m[:, 2]
    lost = len(messages) - len(rows)
    notes = {
        "heading": (
            f"the course over {way_m:.2g} m, as a receiver has no heading; held at either end and"
            f" where it stands, for {held} of {len(rows)} poses"
        ),
        "origin": (
            f"x is east and y north of {latitude_deg[rows[0]]:.7f} deg,"
            f" {longitude_deg[rows[0]]:.7f} deg (WGS84)"
        ),
    }
    if lost:
        notes["heading"] += f"; {describe_count(lost, 'message')} without a fix left out"
    return messages.make_poses(rows, columns), notes


def _describe_standing(time_s: Values, place_m: Values) -> str:
    """Return what a receiver without a course does instead."""
    if len(time_s) < _FEWEST:
        return f"fewer than {_FEWEST} fixes"
    step_s = float(np.median(np.diff(time_s)))
    if step_s > _LONGEST_S / 2.0:
        return f"fixes {step_s:.3g} s apart, which is too seldom"
    extent_m = format_short(float(np.ptp(place_m[:, :2], axis=0).max()), "m")
    return f"a slower one, within {extent_m} in all"


def project_fixes(latitude_deg: Values, longitude_deg: Values, height_m: Values) -> Values:
    """Return places east, north and up of the first one [m], shape (n, 3)."""
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
    axes = np.array(
        [
            [-sin_long, cos_long, 0.0],
            [-sin * cos_long, -sin * sin_long, cos],
            [cos * cos_long, cos * sin_long, sin],
        ]
    )
    return np.asarray((centred_m - centred_m[0]) @ axes.T)


def find_courses(time_s: Values, xy_m: Values) -> tuple[Values, float, int]:
    """Return the courses [rad], the way that they are taken over [m], and how many are held.

    A course leads from the last position that is half that way behind to the first that is half of
    it ahead, where both lie within ten seconds. Otherwise the one before holds, at the beginning
    the first. NaN throughout for what never moves.

    Args:
        time_s: Of the positions, not decreasing [s], shape (n,).
        xy_m: Positions [m], shape (n, 2).
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
        # Of a turn on the spot both ends are at one place, and tell nothing.
        is_far = np.hypot(x_m, y_m) >= way_m / 2.0
        if is_far and time_s[last] - time_s[first] <= _LONGEST_S:
            courses_rad[row] = np.arctan2(y_m, x_m)
    known = np.flatnonzero(np.isfinite(courses_rad))
    held = len(xy_m) - len(known)
    if len(known):
        places = np.searchsorted(known, np.arange(len(xy_m)), side="right") - 1
        courses_rad = courses_rad[known[np.maximum(places, 0)]]
    return courses_rad, way_m, held


def _find_far(offsets_m: Values, least_m: float) -> int | None:
    """Return the first of some offsets that is long enough; None: none is."""
    far = np.flatnonzero(np.hypot(*offsets_m.T) >= least_m)
    return int(far[0]) if len(far) else None
