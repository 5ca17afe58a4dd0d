"""Ranking of runs: conditions that must agree before a run is called the best, and its marks."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from turtlelog.arithmetic import SETTLING_BAND
from turtlelog.compare.table import Mark
from turtlelog.display import describe_count, format_number, format_range, join_words, show_list
from turtlelog.errors import CompareError, describe_unknown
from turtlelog.measure import Metric, Status, find_metric_kind
from turtlelog.run import Run
from turtlelog.run.angles import wrap_angle
from turtlelog.run.paths import closes_by_itself
from turtlelog.run.stop_reasons import allow_position

if TYPE_CHECKING:
    from turtlelog.compare.run_summary import RunSummary

CONDITIONS: Final = ("goal", "path", "start", "plant", "limits")
"""Conditions that runs must have in common. Runs under other conditions solved another task."""

_HEADING_RAD: Final = 0.02
"""Resolution of a heading with unknown tolerances [rad]: the same share of one radian."""

_TABLES: Final[Mapping[str, tuple[str, ...]]] = {
    "path": ("path.",),
    "plant": ("plant.", "disturbance."),
    "limits": ("limits.",),
}
"""Keys of a scenario that belong to a condition; the condition of the plant includes its
disturbances."""

_NO_GOAL_M: Final = 1.0
"""Distance of a run without a goal, for the resolution [m]."""

_MOST_NAMED: Final = 4
"""Largest number of runs that a sentence names; of more runs, it gives the number."""

Keys = tuple[tuple[str, Any], ...]
"""Keys of a scenario with their values; a list of values is represented as text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Conditions of a run; None: unknown.

    Attributes:
        goal: x, y [m] and heading [rad] of the goal, None without a heading; () without a goal.
        start: x, y [m] and heading [rad] of the first pose that was read.
        plant: `turtlesim`, `lagged` or `robot`; None: unknown.
        tables: Keys of path, plant and limits, each None if unknown.
        reach_m: Resolution of positions from the law's tolerances [m].
        reach_rad: Resolution of headings from the law's tolerances [rad].
    """

    goal: tuple[float, float, float | None] | tuple[()] | None
    start: tuple[float, float, float]
    plant: str | None
    tables: tuple[Keys | None, Keys | None, Keys | None]
    reach_m: float
    reach_rad: float

    @property
    def is_whole(self) -> bool:
        """Whether path, plant and limits are known, as in a run with its whole scenario."""
        return None not in self.tables


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionDifference:
    """A condition that prevents a ranking.

    Attributes:
        condition: One of `CONDITIONS`.
        key: Key of the scenario (`limits.speed_m_s`), or the condition itself.
        values: Value of each run, in order; None if unknown.
        is_unknown: Whether the ranking is prevented because the condition of a run is unknown.
    """

    condition: str
    key: str
    values: tuple[Any, ...]
    is_unknown: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranking:
    """Decision whether runs may be ranked, with the reasons.

    Attributes:
        varied: Keys that were varied intentionally and differ: gains, and named keys.
        differences: Conditions that prevent a ranking, in order of `CONDITIONS`.
        unknown: Conditions that are unknown for all runs, which prevent nothing, with the runs.
    """

    varied: tuple[str, ...]
    differences: tuple[ConditionDifference, ...]
    unknown: Mapping[str, tuple[int, ...]]

    @property
    def is_fair(self) -> bool:
        """Whether a run may be called the best."""
        return not self.differences

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that differ; the intentionally varied ones come first."""
        return (*self.varied, *(found.key for found in self.differences))

    def describe(self) -> str:
        """Return why no run may be called the best, as a clause; empty if a run may."""
        known = [one.condition for one in self.differences if not one.is_unknown]
        unknown = [one.condition for one in self.differences if one.is_unknown]
        clauses = [
            f"{join_words([*dict.fromkeys(names)])} {_choose_verb(names, *verbs)}"
            for names, verbs in ((known, _DIFFER), (unknown, _UNKNOWN))
            if names
        ]
        return f"{' and '.join(clauses)}, so nothing is called best" if clauses else ""

    def list_notes(self, names: Sequence[str]) -> list[str]:
        """Return each difference with its values, and unknown conditions, as sentences.

        `names` are those of the runs, in order.
        """
        notes = [_describe_values(found, names) for found in self.differences]
        by_runs: dict[str, list[str]] = {}
        for condition, rows in self.unknown.items():
            by_runs.setdefault(name_few([names[row] for row in rows]), []).append(condition)
        notes += [
            f"Not known of {who}: {join_words(found)}. The ranking takes"
            f" {_choose_verb(found, 'it', 'them')} for equal."
            for who, found in by_runs.items()
            if self.is_fair
        ]
        return notes


_DIFFER: Final = ("differs", "differ")
_UNKNOWN: Final = ("is not known of every run", "are not known of every run")


def _choose_verb(names: Sequence[str], one: str, many: str) -> str:
    return one if len({*names}) == 1 and names[0] != "limits" else many


def find_conditions(run: Run, parameters: Mapping[str, Any]) -> Conditions:
    """Return the conditions of a run with these parameters, with defaults as far as known."""
    first = [*run.samples.pose_sequence[:1], 0][0]
    x_m, y_m = map(float, run.poses.xy_m[first])
    path, plant, limits = (_take_table(run, parameters, name) for name in _TABLES)
    goal: tuple[float, float, float | None] | tuple[()] | None = None
    if not run.declaration.uses_goal and not run.is_lawless:
        goal = ()
    elif run.goal_xy_m is not None:
        goal = (*run.goal_xy_m, run.goal_heading_rad)
    distance_m = math.hypot(goal[0] - x_m, goal[1] - y_m) if goal else _NO_GOAL_M
    reach_m, reach_rad = _find_reach(parameters, distance_m)
    return Conditions(
        goal=goal,
        start=(x_m, y_m, float(run.poses.heading_rad[first])),
        plant=_find_plant(run, parameters, is_simulated=limits is not None),
        tables=(path, plant, limits),
        reach_m=reach_m,
        reach_rad=reach_rad,
    )


def _take_table(run: Run, parameters: Mapping[str, Any], condition: str) -> Keys | None:
    """Return the keys of a condition; None if the condition is unknown."""
    closed = closes_by_itself(str(parameters.get("path.kind")))  # as is meant without the key
    found = tuple(
        (key, value if isinstance(value, str | int | float | list) else str(value))
        for key, value in sorted(parameters.items())
        if key.startswith(_TABLES[condition]) and not (key == "path.closed" and value is closed)
    )
    return found if found or run.scenario_is_complete else None


def _find_reach(parameters: Mapping[str, Any], distance_m: float) -> tuple[float, float]:
    heading_rad = parameters.get("law.heading_tolerance_rad")
    position_m = parameters.get("law.position_tolerance_m")
    if heading_rad is None or position_m is None:
        # Within this band, metrics regard a robot as arrived.
        return SETTLING_BAND * distance_m, _HEADING_RAD
    return allow_position(heading_rad, position_m, distance_m), float(heading_rad)


def _find_plant(run: Run, parameters: Mapping[str, Any], *, is_simulated: bool) -> str | None:
    """Return the kind of a plant; without the key, a scenario has turtlesim."""
    if is_simulated:
        return str(parameters.get("plant.kind", "turtlesim"))
    if not run.is_lawless:
        return None
    if run.poses.speed_m_s is not None:
        return "turtlesim"
    return None if run.origin.poses is None else "robot"


def judge_runs(
    summaries: "Sequence[RunSummary]", *, varied: Collection[str] = (), source: str = "varied"
) -> Ranking:
    """Return whether one of several runs may be called the best. Only this function decides.

    Goals and starts may differ by a resolution from the laws' tolerances: heading tolerance times
    distance plus position tolerance, and the heading tolerance. If the tolerances are unknown, the
    resolution is 2 % of the distance to the goal and 0.02 rad. An unknown goal of a run prevents a
    ranking. An unknown path, plant or limit prevents a ranking only if it is known for other runs.

    Args:
        summaries: Runs to judge.
        varied: Conditions and scenario keys, in addition to gains, that were varied intentionally.
        source: Beginning of error lines.

    Raises:
        CompareError: If one of `varied` is neither a condition nor a key of these runs.
    """
    purpose = {*varied, *(key for one in summaries for key in one.declaration.list_gains())}
    differing = _list_varied(summaries, purpose)
    _require_known(summaries, varied, source)
    known = [one.conditions for one in summaries if one.conditions is not None]
    if len(known) < max(len(summaries), 2):
        return Ranking(varied=differing, differences=(), unknown={})
    found = [
        difference
        for condition in CONDITIONS
        if condition not in purpose
        for difference in _judge(condition, known)
        if difference.key not in purpose
    ]
    unknown = {
        condition: rows
        for condition in CONDITIONS
        if (rows := _list_unknown(condition, known)) and condition not in purpose
        if all(one.condition != condition for one in found)
    }
    # What is known of some runs alone may differ; what is known of none is the same lack of all.
    for condition in [one for one in unknown if len(unknown[one]) < len(known)]:
        lacking = unknown.pop(condition)
        told = [_write_condition(condition, one) for one in known]
        values = [None if row in lacking else text for row, text in enumerate(told)]
        found.append(_differ(condition, values, is_unknown=True))
    return Ranking(varied=differing, differences=tuple(found), unknown=unknown)


def _write_condition(condition: str, found: Conditions) -> str:
    keys = [
        f"{key.partition('.')[2]} = {format_number(value) if isinstance(value, float) else value}"
        for key, value in _get_table(condition, found) or ()
        if key != "plant.kind"
    ]
    kind = [found.plant] if condition == "plant" and found.plant else []
    return ", ".join([*kind, *keys]) or "none"


def _list_varied(summaries: "Sequence[RunSummary]", purpose: Collection[str]) -> tuple[str, ...]:
    """Return the intentionally varied keys that differ, in the order of the scenario."""
    return tuple(
        key
        for key, values in collect_values(summaries).items()
        if len(values) > 1 and (key in purpose or _find_condition(key) in purpose)
    )


def collect_values(summaries: "Sequence[RunSummary]") -> dict[str, set[str]]:
    """Return the different values of every parameter, as Python writes them."""
    values: dict[str, set[str]] = {}
    for summary in summaries:
        for key, value in summary.parameters.items():
            values.setdefault(key, set()).add(repr(value))
    return values


def _find_condition(key: str) -> str:
    """Return the condition that a scenario's key belongs to, or else its table."""
    for condition, prefixes in _TABLES.items():
        if key.startswith(prefixes):
            return condition
    return key.partition(".")[0]


def _require_known(summaries: "Sequence[RunSummary]", varied: Collection[str], source: str) -> None:
    keys = dict.fromkeys([*CONDITIONS, *(key for one in summaries for key in one.parameters)])
    for name in varied:
        if name not in keys:
            raise CompareError(f"{source}: {describe_unknown('key', name, keys)}")


def _list_unknown(condition: str, known: Sequence[Conditions]) -> tuple[int, ...]:
    def is_unknown(found: Conditions) -> bool:
        if condition == "plant":
            return found.plant in {None, "robot"}
        return condition in _TABLES and _get_table(condition, found) is None

    return tuple(row for row, found in enumerate(known) if is_unknown(found))


def _get_table(condition: str, found: Conditions) -> Keys | None:
    return found.tables[[*_TABLES].index(condition)]


def _judge(condition: str, known: Sequence[Conditions]) -> list[ConditionDifference]:
    """Return how runs differ in a condition: in a whole value, or in keys of its table."""
    if condition in {"goal", "start"}:
        places = [found.goal if condition == "goal" else found.start for found in known]
        if None in places:
            return [_differ(condition, places, is_unknown=True)]
        given = [place for place in places if place]
        is_same = len(given) in {0, len(places)} and _are_near(known, given)
        return [] if is_same else [_differ(condition, places)]
    kinds = [found.plant for found in known]
    if condition == "plant" and len({*kinds} - {None}) > 1:
        return [ConditionDifference(condition=condition, key="plant.kind", values=tuple(kinds))]
    return _judge_table(condition, known)


def _differ(name: str, values: Iterable[Any], *, is_unknown: bool = False) -> ConditionDifference:
    held = tuple(values)
    return ConditionDifference(condition=name, key=name, values=held, is_unknown=is_unknown)


def _are_near(
    known: Sequence[Conditions], places: Sequence[tuple[float, float, float | None]]
) -> bool:
    """Return whether positions agree within the finest resolution of the runs."""
    if not places:
        return True
    x_m, y_m, headings = zip(*places, strict=True)
    apart_m = math.hypot(max(x_m) - min(x_m), max(y_m) - min(y_m))
    turned = [heading for heading in headings if heading is not None]
    if len(turned) not in {0, len(headings)}:
        return False
    off_rad = [float(wrap_angle(heading - turned[0])) for heading in turned]
    apart_rad = max(off_rad, default=0.0) - min(off_rad, default=0.0)
    is_close = apart_m <= min(one.reach_m for one in known)
    return is_close and apart_rad <= min(one.reach_rad for one in known)


def _judge_table(condition: str, known: Sequence[Conditions]) -> list[ConditionDifference]:
    """Return the keys of a table that differ between the runs with a known table."""
    held = [_get_table(condition, found) for found in known]
    tables = [None if table is None else dict(table) for table in held]
    present = [table for table in tables if table is not None]
    keys = dict.fromkeys(key for table in present for key in table)
    return [
        ConditionDifference(
            condition=condition,
            key=key,
            values=tuple(None if table is None else table.get(key) for table in tables),
        )
        for key in keys
        if len({repr(table.get(key)) for table in present}) > 1
    ]


def _describe_values(found: ConditionDifference, names: Sequence[str]) -> str:
    """Return the value of each run as text; runs with equal values are grouped."""
    groups: dict[str, tuple[str, list[str]]] = {}
    for name, value in zip(names, found.values, strict=True):
        shown = _show(found, value)
        key = str(value) if isinstance(value, list) else shown
        groups.setdefault(key, (shown, []))[1].append(name)
    parts = [f"{value} of {name_few(who)}" for value, who in groups.values()]
    if (more := len(parts) - _MOST_NAMED) > 0:
        parts = [*parts[:_MOST_NAMED], describe_count(more, "other value")]
    hint = ""
    if found.is_unknown and found.condition == "goal":
        is_of_all = all(value is None for value in found.values)  # as the option applies to all
        option = "--goal X,Y" if is_of_all else "turtlelog convert FILE --goal X,Y -o NEW.mcap"
        hint = f". {option} gives it"
    return f"{found.key}: {', '.join(parts)}{hint}."


def name_few(runs: Sequence[str]) -> str:
    """Return the names of a few runs in a sentence; the number of more runs."""
    return join_words(runs) if len(runs) <= _MOST_NAMED else describe_count(len(runs), "run")


def _show(found: ConditionDifference, value: Any) -> str:
    if value is None:
        return "not known" if found.is_unknown else "none"
    if value == ():
        return "none"
    if isinstance(value, tuple):
        x_m, y_m, heading_rad = value
        turned = "" if heading_rad is None else f" at {math.degrees(heading_rad):.4g} deg"
        return f"({x_m:.5g}, {y_m:.5g}) m{turned}"
    if isinstance(value, list):
        return show_list(value)
    return format_number(value) if isinstance(value, float) else str(value)


def list_metric_units(metrics: Sequence[Metric]) -> list[str]:
    """Return the units of a metric's values; several if loops of the same name differ."""
    valued = [metric.unit for metric in metrics if metric.value is not None]
    return list(dict.fromkeys(valued or [metric.unit for metric in metrics][:1]))


def list_summary_units(summaries: "Sequence[RunSummary]", name: str) -> list[str]:
    """Return the units of a metric in some runs; empty for a parameter."""
    found = [summary.find_metric(name) for summary in summaries]
    return list_metric_units([metric for metric in found if metric is not None])


def mark_metric(
    summaries: "Sequence[RunSummary]", name: str, *, ranking: Ranking | None = None
) -> dict[int, Mark]:
    """Return which runs are the best and the worst in a metric; empty if all print alike.

    The result is also empty if loops of the same name control signals with different units, or if
    runs may not be ranked.

    Args:
        summaries: Runs to mark.
        name: Id of the metric.
        ranking: Whether the runs may be ranked, if already known.
    """
    if not (judge_runs(summaries) if ranking is None else ranking).is_fair:
        return {}
    kind = find_metric_kind(name)
    better = kind.better if kind and len(list_summary_units(summaries, name)) < 2 else None
    found = [summary.find_metric(name) if better else None for summary in summaries]
    values = {row: metric.value for row, metric in enumerate(found) if metric is not None}
    # Values below the floor of a metric are equally good.
    floor = -math.inf if kind is None or kind.floor is None else kind.floor
    known = {row: max(value, floor) for row, value in values.items() if value is not None}
    if not known:
        return {}
    # A loop that never settles is worse than each one that does.
    statuses = [None if metric is None else metric.status for metric in found]
    never = [row for row, status in enumerate(statuses) if status is Status.NOT_REACHED]
    low, high = min(known.values()), max(known.values())
    # Values that the answer prints alike are equally good: nobody reads a difference between them.
    if len({*format_range(low, high, list_summary_units(summaries, name)[0])}) == 1:
        best, worse = [*known], never
    else:
        ends = (low, high) if better == "lower" else (high, low)
        best, worst = ([row for row, one in known.items() if one == end] for end in ends)
        worse = never or worst
    marks: dict[int, Mark] = dict.fromkeys(worse, "worst")
    return marks | dict.fromkeys(best, "best") if worse else {}
