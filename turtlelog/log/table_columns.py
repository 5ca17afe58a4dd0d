"""The columns of a table by quantity, by name or as requested, and the robots that they name."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import join_words
from turtlelog.errors import LogError
from turtlelog.log.table_files import KITTI_COLUMNS, PlainTable
from turtlelog.log.units import DATES, QUANTITIES, UNITS, read_unit

_NAMES: Final[Mapping[str, str]] = {
    "t": "t time timestamp timestamps stamp header_stamp header_stamp_sec header_stamp_secs"
    " stamp_sec stamp_secs elapsed elapsed_time sim_time ros_time sec secs seconds",
    "t_nanosec": "",  # only together with seconds
    **{
        axis: f"{axis} pos_{axis} position_{axis} p{axis} {axis}_pos {axis}_position {axis}pos"
        f" pose_{axis} t{axis} pose_position_{axis} pose_pose_position_{axis}"
        f" transform_translation_{axis} translation_{axis} p_rs_r_{axis}"
        for axis in "xyz"
    },
    "heading": "heading yaw theta psi pos_theta pose_theta heading_angle yaw_angle"
    " orientation_yaw pose_yaw",
    **{
        f"q{axis}": f"q{axis} q_{axis} q_{number} quat_{axis} quaternion_{axis} orientation_{axis}"
        f" rotation_{axis} pose_orientation_{axis} pose_pose_orientation_{axis}"
        f" transform_rotation_{axis} q_rs_{axis}"
        for number, axis in enumerate("wxyz")  # PX4's q[0] is w
    },
    "speed": "speed v vel velocity linear_velocity linear_speed lin_vel forward_speed linear_x"
    " vel_linear_x twist_linear_x twist_twist_linear_x",
    "turn_rate": "turn_rate omega w wz yaw_rate yawrate angular_velocity angular_speed"
    " ang_vel angular_z vel_angular_z twist_angular_z twist_twist_angular_z",
}
"""Known column names by field, in lower case, with _ for other characters."""

_OF_COMMANDS: Final[Mapping[str, str]] = {
    "command_speed": "vx v_x vel_x x_vel lin lin_x linear",
    "command_turn_rate": "wz w_z vel_z z_vel ang ang_z angular vth vtheta",
}
"""Further names of commands; a measured `vx` may be along x of the world."""

_COMMANDS: Final = frozenset({"cmd", "command", "commanded", "commands"})

_SET: Final = _COMMANDS | {"set", "setpoint", "sp", "ref", "reference", "desired", "des", "target"}
"""Words in names of columns that may be commands."""

_ACTUATORS: Final = frozenset(
    {"wheel", "motor", "steering", "steer", "throttle", "vel", "velocity", "speed"}
)
"""Words in names of commands that are neither a speed nor a turn rate of the robot."""

_OTHERS: Final = frozenset({"measured", "meas", "actual", "odom", "field", "robot", "data"})
"""Words in column names that only indicate that a robot measured the values."""

_WANTED: Final = frozenset(
    {
        *("goal", "target", "ref", "reference", "desired", "setpoint", "start"),
        *("error", "err", "cov", "covariance", "std", "var", "sigma"),
    }
)
"""Words in names of columns without the robot's position or motion."""

_ROBOTS: Final = frozenset(
    f"{noun}{end}" for noun in ("robot", "agent", "vehicle") for end in ("", "_id", "_name")
) | {"id", "name", "object_id", "track_id"}
"""Names of columns that may contain the robot of each row."""

_FEWEST_ROWS: Final = 10
"""Smallest number of rows of each of several robots."""

_LONGEST_NAME: Final = 512
"""Longest name that is searched for a quantity [letters]; the topic in it may take 255."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A column of a table and its quantity.

    Attributes:
        field: Quantity, a key of `QUANTITIES`.
        column: Index of the column, from 0.
        name: Name in the header.
        unit: Unit, a key of `UNITS`; None if neither the name nor the user gives it.
    """

    field: str
    column: int
    name: str
    unit: str | None

    @property
    def units(self) -> Mapping[str, float]:
        """The possible units."""
        return UNITS[QUANTITIES[self.field]]


def assign_columns(
    names: Sequence[str], asked: Mapping[str, str], units: Mapping[str, str]
) -> dict[str, Choice]:
    """Return the columns with known quantities, by quantity; `asked` has the user's names."""
    chosen: dict[str, Choice] = {}
    for field, text in asked.items():
        if field not in QUANTITIES:
            known = ", ".join(QUANTITIES)
            raise LogError(f"--column {field}: expected one of {known}, found {field!r}")
        chosen[field] = _find_asked(field, text, names)
    taken, pair = {choice.column for choice in chosen.values()}, _find_stamp(names)
    for field in QUANTITIES:
        if field not in chosen:
            guess = _guess(field, names, {*taken, *pair}, _find_home(chosen))
            if guess is not None:
                chosen[field] = guess
    if "t" not in chosen and pair and "t_nanosec" not in chosen:
        for field, unit, place in zip(("t", "t_nanosec"), ("s", "ns"), pair, strict=True):
            chosen[field] = Choice(field=field, column=place, name=names[place], unit=unit)
    return {
        field: _fill_unit(chosen[field], units.get(names[chosen[field].column], ""))
        for field in QUANTITIES
        if field in chosen
    }


def _fill_unit(choice: Choice, text: str) -> Choice:
    """Return a column with the unit of a table or of its row of units, unless its name has one."""
    text = text.strip("[]() ")
    if choice.unit is not None or not text or QUANTITIES[choice.field] == "number":
        return choice
    unit = read_unit(choice.field, text)
    if unit is None and choice.field == "t" and text.lower() in DATES:
        return choice
    if unit is None:
        known = ", ".join(choice.units)
        raise LogError(
            f"column {choice.name}: expected a unit of {known}, found {text[:40]!r}:"
            f" --column {choice.field}='{choice.name} [UNIT]' names one"
        )
    return replace(choice, unit=unit)


QUATERNION: Final = ("qx", "qy", "qz", "qw")

_PLANAR: Final = ("qz", "qw")
"""Columns of a quaternion about the vertical axis; x and y are 0 if no column has them."""

COURSE: Final = "course"
"""Name that asks for the direction of travel instead of a column of headings."""

_NEEDED: Final = ("t", "x", "y", "heading")

_SHOWN_NAMES: Final = 12
"""Largest number of columns that an error lists."""


def require_columns(
    table: PlainTable, chosen: Mapping[str, Choice], robots: Sequence[str], *, has_courses: bool
) -> None:
    """Raise an error with options if columns of a run are missing."""
    is_turned = has_courses or has_quaternion(chosen)
    known = {*chosen, "heading"} if is_turned else {*chosen}
    if missing := [name for name in _NEEDED if name not in known]:
        if {"row", "failed"} <= {*table.names}:
            raise LogError("a table of turtlelog sweep, not a run: turtlelog plot shows it")
        if {"file", "sha256", "error"} <= {*table.names}:
            raise LogError(
                "results of turtlelog metrics or check, not a run: its column file names the runs"
            )
        if table.names == KITTI_COLUMNS and not table.has_header:
            raise LogError(
                "a KITTI trajectory has no times, so it is no run; turtlelog compare FILE"
                " --reference FILE --ate compares two of them"
            )
        shown = range(min(len(table.names), _SHOWN_NAMES))
        found = ", ".join(show_column(table.names, place) for place in shown)
        more = ", ..." if len(table.names) > _SHOWN_NAMES else ""
        offered = "" if missing == ["t"] else offer_robots(robots)  # all robots have the others
        options = offered or f"--column {missing[0]}='NAME [UNIT]' says which"
        if missing == ["heading"] and not offered:
            options += f", or --column heading={COURSE} takes the direction of travel"
        raise LogError(f"no column for {join_words(missing)}; there are {found}{more}: {options}")


def has_quaternion(chosen: Mapping[str, Choice]) -> bool:
    """Return whether the columns are all those of a quaternion, at least about the vertical."""
    return {*QUATERNION}.intersection(chosen) in ({*QUATERNION}, {*_PLANAR})


def describe_unread_commands(names: Sequence[str], chosen: Mapping[str, Choice]) -> str:
    """Return which unread columns look like commands of an axis without a column; may be empty."""
    lacking = [field for field in _OF_COMMANDS if field not in chosen]
    taken = {choice.column for choice in chosen.values()}
    short = (place for place, name in enumerate(names) if len(name) <= _LONGEST_NAME)
    unread = [place for place in short if place not in taken]
    found = {field: [one for one in unread if _may_command(field, names[one])] for field in lacking}
    places = [place for fitting in found.values() for place in fitting]
    options = [
        f"--column {field}='{_name(names, fitting[0])}'"
        for field, fitting in found.items()
        if fitting
    ]
    advice = " ".join(options)
    if lacking and not places:
        places = [place for place in unread if _may_move(names[place])]
        columns = join_words([f"--column {field}=NAME" for field in lacking])
        advice = f"{columns} name columns of the robot's own rates"
    if not places:
        return ""
    look = "looks like commands but is" if len(places) == 1 else "look like commands but are"
    return f"{join_words([show_column(names, one) for one in places])} {look} not read: {advice}"


def _may_move(name: str) -> bool:
    """Return whether a name has the words of a command and those of a motor or a wheel."""
    words = {*_simplify(name).split("_")}
    return bool(words & _SET and words & _ACTUATORS) and not words & {"error", "err"}


def _may_command(field: str, name: str) -> bool:
    """Return whether a name has the words of a command and those of a speed or turn rate."""
    words = _split_name(field, name, is_asked=True)[0].split("_")
    base = "_".join(word for word in words if word not in _SET)
    known = f"{_NAMES[field.removeprefix('command_')]} {_OF_COMMANDS[field]}".split()
    return not _SET.isdisjoint(words) and base in known


def find_table_robots(names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the columns of each robot by quantity, for names such as `robot1_x` or `/robot1/x`."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        match = re.fullmatch(r"/?([^_./]{1,64})[_./](.{1,64})", name.strip())
        if match is None or match[1].lower() in _COMMANDS | _WANTED:
            continue
        for field in QUANTITIES:
            if _rank(field, _split_name(field, match[2])[0]) == 0:
                found.setdefault(match[1], {}).setdefault(field, name.strip())
    needed = ({"x", "y", "heading"}, {"x", "y", "qx", "qy", "qz", "qw"})
    return {
        robot: columns
        for robot, columns in found.items()
        if any(fields <= {*columns} for fields in needed)
    }


def find_robot_column(names: Sequence[str], taken: set[int]) -> list[int]:
    """Return the column that may contain the robot of each row, as a list of at most one index."""
    short = ((place, name) for place, name in enumerate(names) if len(name) <= _LONGEST_NAME)
    found = (place for place, name in short if place not in taken and _simplify(name) in _ROBOTS)
    return [*islice(found, 1)]


def list_row_robots(names: Sequence[str], time_ns: NDArray[np.int64]) -> list[str]:
    """Return the robots whose rows alternate in time; empty for one robot.

    The number of a lap or waypoint changes seldom, and that of a row is never repeated.
    """
    known, codes, counts = np.unique(
        np.array(names, dtype=object).astype(str), return_inverse=True, return_counts=True
    )
    if len(known) < 2 or (second := int(np.sort(counts)[-2])) < _FEWEST_ROWS:
        return []
    codes = codes[np.argsort(time_ns, kind="stable")]
    changes = int(np.count_nonzero(np.diff(codes)))
    return known.tolist() if changes >= second else []


def offer_robots(robots: Sequence[str]) -> str:
    """Return the options that choose one of several robots; empty without robots."""
    options = " or ".join(f"--robot {robot}" for robot in robots[:3])
    return options and f"{options} chooses a robot"


def _find_asked(field: str, text: str, names: Sequence[str]) -> Choice:
    # `psi [deg]` is a name, or `psi` in deg.
    readings: list[tuple[str, str | None]] = [(text.strip(), None)]
    bracketed = re.fullmatch(r"(.*?)\s*\[([^\]]*)\]", text.strip())
    if bracketed is not None and text.strip() not in map(str.strip, names):  # as q[0] is
        given = read_unit(field, bracketed[2])
        if given is None:
            known, found = ", ".join(UNITS[QUANTITIES[field]]), bracketed[2]
            raise LogError(f"--column {field}={text}: expected a unit of {known}, found {found}")
        readings.append((bracketed[1], given))
    for name, unit in readings:
        matches = [place for place, known in enumerate(names) if known.strip() == name]
        if not matches and re.fullmatch(r"#\d{1,5}", name) and 0 < int(name[1:]) <= len(names):
            matches = [int(name[1:]) - 1]
        if len(matches) > 1:
            places = join_words([f"#{place + 1}" for place in matches])
            raise LogError(
                f"column {name}: expected one of that name, found {len(matches)}, {places}:"
                f" --column {field}='#{matches[0] + 1}' chooses"
            )
        if matches:
            unit = unit or _split_name(field, names[matches[0]], is_asked=True)[1]
            return Choice(field=field, column=matches[0], name=_name(names, matches[0]), unit=unit)
    found = ", ".join(names)[:160]
    raise LogError(f"--column {field}={text}: expected a column of the table, found {found}")


_OF_POSE: Final = ("x", "y", "z", "heading", "qx", "qy", "qz", "qw")


def _find_home(chosen: Mapping[str, Choice]) -> str:
    """Return the name of a chosen column of the pose; empty if none is chosen yet."""
    return next((chosen[field].name for field in _OF_POSE if field in chosen), "")


def _count_shared(name: str, other: str) -> int:
    """Return how many parts of a topic two names share, as in `/odom/x` and `/odom/yaw`."""
    pairs = zip(_split_topic(name), _split_topic(other), strict=False)
    return next((count for count, (one, two) in enumerate(pairs) if one != two), 0)


def _split_topic(name: str) -> list[str]:
    return re.split(r"[/.]", name.strip().removeprefix("/"))


def describe_mixed_topics(chosen: Mapping[str, Choice]) -> str:
    """Return a sentence on columns of one pose from several topics; empty for one topic."""
    topics: dict[str, list[str]] = {}
    for field in _OF_POSE:
        if field in chosen and chosen[field].name.strip().startswith("/"):
            topics.setdefault(_split_topic(chosen[field].name)[0], []).append(field)
    if len(topics) < 2:
        return ""
    parts = [f"{join_words(fields)} from /{topic}" for topic, fields in topics.items()]
    return f"the pose is joined from several topics: {'; '.join(parts)}"


def _rank_columns(field: str, names: Sequence[str], taken: set[int]) -> dict[int, list[Choice]]:
    """Return the columns whose names match a quantity, by rank."""
    ranked: dict[int, list[Choice]] = {}
    for place, name in enumerate(names):
        if place in taken or len(name) > _LONGEST_NAME:
            continue
        base, unit = _split_name(field, name)
        rank = _rank(field, base)
        if rank is not None:
            choice = Choice(field=field, column=place, name=name.strip(), unit=unit)
            ranked.setdefault(rank, []).append(choice)
    return ranked


def _guess(field: str, names: Sequence[str], taken: set[int], home: str) -> Choice | None:
    ranked = _rank_columns(field, names, taken)
    if not ranked:
        return None
    if field in _OF_POSE and home:  # a pose is of one topic
        shared = {one.column: _count_shared(one.name, home) for of in ranked.values() for one in of}
        most = max(shared.values())
        near = {
            rank: [one for one in of if shared[one.column] == most] for rank, of in ranked.items()
        }
        ranked = {rank: of for rank, of in near.items() if of}
    best = ranked[min(ranked)]
    if min(ranked) == _RARELY and len(best) > 1:
        return None  # they are named as columns that may be commands
    if field == "heading" and any(_split_name(field, name)[0] == "phi" for name in names):
        # Of the Euler angles phi, theta and psi, theta is the pitch.
        best = [one for one in best if _split_name(field, one.name)[0] != "theta"] or best
    if len(best) > 1:
        found = " and ".join(show_column(names, choice.column) for choice in best)
        first = _name(names, best[0].column)
        raise LogError(
            f"columns: expected one for {field}, found {found}: --column {field}='{first}' chooses"
        )
    return best[0]


def _name(names: Sequence[str], place: int) -> str:
    """Return a column's name, or its number as in `#2` if it has no name of its own."""
    name = names[place].strip()
    return name if name and [one.strip() for one in names].count(name) == 1 else f"#{place + 1}"


def show_column(names: Sequence[str], place: int) -> str:
    """Return a column's name, with its number if it has no name of its own."""
    name, shown = names[place].strip(), _name(names, place)
    return shown if shown == name or not name else f"{name} ({shown})"


def _find_stamp(names: Sequence[str]) -> tuple[int, ...]:
    """Return the columns of seconds and nanoseconds that form one time, if they exist."""
    short = ((place, name) for place, name in enumerate(names) if len(name) <= _LONGEST_NAME)
    places = {_simplify(name): place for place, name in short}
    for base, place in places.items():
        match = re.fullmatch(r"(|(?:.*_)?stamp_)(?:nanosec|nsec)(s?)", base)
        seconds = None if match is None else places.get(f"{match[1]}sec{match[2]}")
        if seconds is not None:
            return seconds, place
    return ()


def _rank(field: str, base: str) -> int | None:
    """Return how well a name matches a quantity, 0 is best; None if it does not match."""
    words = base.split("_")
    is_command = not _COMMANDS.isdisjoint(words)
    if is_command != field.startswith("command_") or not _WANTED.isdisjoint(words):
        return None
    known = _NAMES[field.removeprefix("command_")].split()
    rest = [word for word in words if word not in _COMMANDS]
    short = [word for word in rest if word not in _OTHERS]
    for rank, tried in enumerate((rest, short)):
        if "_".join(tried) in known:
            return rank
    # The part before is a topic: /odom/pose/pose/position/x, cmd_vel.linear.x.
    tails = ("_".join(short[place:]) for place in range(1, len(short) - 1))
    if any(tail in known for tail in tails):
        return 2
    return _RARELY if "_".join(rest) in _OF_COMMANDS.get(field, "").split() else None


_RARELY: Final = 3  # rank of the further names of commands


def _split_name(field: str, name: str, *, is_asked: bool = False) -> tuple[str, str | None]:
    """Return a lower-case name without its unit, and the unit if it fits this quantity.

    Unless the user named this column, the words before the unit must name the quantity.
    """
    text = name.strip().lower()
    if QUANTITIES[field] == "number" and _rank(field, _simplify(text)) is not None:
        return _simplify(text), None  # q[1] has no unit
    match = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]", text)
    if match is not None and (unit := read_unit(field, match[2])) is not None:
        return _simplify(match[1]), unit
    words = _simplify(text).split("_")
    for count in range(min(3, len(words) - 1), 0, -1):  # deg_per_s, m_s, rad
        unit, rest = read_unit(field, "_".join(words[-count:])), "_".join(words[:-count])
        if unit is not None and (is_asked or _rank(field, rest) is not None):
            return rest, unit
    return "_".join(words), None


def _simplify(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def read_length_unit(axis: str, name: str) -> float:
    """Return the metres of a unit of length in the name of a column; 1 without a unit."""
    unit = _split_name(axis, name)[1]
    bracketed = re.search(r"[\[(]([^\])]+)[\])]\s*$", name)
    if unit is None and bracketed is not None:
        known = ", ".join(UNITS["length"])
        raise LogError(f"column {name}: expected a unit of {known}, found {bracketed[1][:40]!r}")
    return UNITS["length"][unit or "m"]
