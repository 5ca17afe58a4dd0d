"""What the values of a scenario must be to each other, whatever their types allow."""

from collections.abc import Iterator

from turtlelog.errors import ScenarioError
from turtlelog.scenario.model import Scenario


def require_consistent(scenario: Scenario, source: str) -> None:
    """Refuse a scenario whose values contradict each other; of its law nothing is judged.

    Raises:
        ScenarioError: `source: key: expected ..., found ...`, for the first key that is wrong.
    """
    judges = (_judge_places, _judge_path, _judge_timer, _judge_delays, _judge_chances)
    for judge in (*judges, _judge_shaping):
        for key, expected, found in judge(scenario):
            raise ScenarioError(f"{source}: {key}: expected {expected}, found {found}")


Complaints = Iterator[tuple[str, str, str]]
"""Keys that are wrong, what was expected there, and what was found."""


def _judge_places(scenario: Scenario) -> Complaints:
    """Start and goal lie in the plant's world."""
    low_m, high_m = scenario.plant.facts.low_m, scenario.plant.facts.high_m
    expected = f"a number from {low_m:.10g} to {high_m:.10g}"
    for table in ("start", "goal"):
        for name in ("x_m", "y_m"):
            value = getattr(getattr(scenario, table), name)
            if not low_m <= value <= high_m:
                yield f"{table}.{name}", expected, f"{value:.10g}"


def _judge_path(scenario: Scenario) -> Complaints:
    if scenario.path is None:
        return
    low_m, high_m = scenario.plant.facts.low_m, scenario.plant.facts.high_m
    bounds_m = scenario.path.bounds_m
    for name, least_m, most_m in (("x", *bounds_m[:2]), ("y", *bounds_m[2:])):
        if least_m < low_m or most_m > high_m:
            within = f"{name} from {low_m:.10g} to {high_m:.10g} m"
            yield "path", within, f"{least_m:.10g} to {most_m:.10g} m"


def _judge_timer(scenario: Scenario) -> Complaints:
    loop = scenario.loop
    if loop.trigger == "timer":
        if loop.period_s is None:
            yield "loop.period_s", "a period, for loop.trigger is timer", "none"
        if loop.period_ticks != 1:
            yield "loop.period_ticks", "1, for loop.trigger is timer", repr(loop.period_ticks)
    elif loop.period_s is not None:
        yield "loop.period_s", "none, for loop.trigger is pose", repr(loop.period_s)


def _judge_delays(scenario: Scenario) -> Complaints:
    """What takes longer than the run would have no effect but that nothing happens."""
    most_s = scenario.max_duration_s
    loop, period_s = scenario.loop, scenario.plant.facts.period_s
    ticks_s = loop.transport_delay_ticks * period_s
    delays = {
        "loop.transport_delay_ticks": ticks_s,
        "loop.transport_delay_s": ticks_s + loop.transport_delay_s,
        "loop.jitter_s": loop.jitter_s,
        "loop.late_s": loop.late_s,
        "sensing.delay_s": scenario.sensing.delay_s,
        "sensing.jitter_s": scenario.sensing.jitter_s,
        "plant.speed_dead_time_s": scenario.plant.speed_dead_time_s or 0.0,
        "plant.turn_dead_time_s": scenario.plant.turn_dead_time_s or 0.0,
        "disturbance.from_s": scenario.disturbance.from_s,
    }
    for key, delay_s in delays.items():
        if delay_s > most_s:
            yield key, f"no longer than max_duration_s = {most_s:g} s", f"{delay_s:g} s"
    push = scenario.disturbance
    if push.to_s <= push.from_s:
        yield "disturbance.to_s", f"a time after from_s = {push.from_s:g}", repr(push.to_s)


def _judge_chances(scenario: Scenario) -> Complaints:
    """What may happen has a size."""
    loop, sensing = scenario.loop, scenario.sensing
    if loop.late_probability and not loop.late_s:
        yield "loop.late_s", "a time above 0 beside late_probability", repr(loop.late_s)
    if sensing.outlier_probability and not (sensing.outlier_m or sensing.outlier_rad):
        sizes = "outlier_m or outlier_rad above 0"
        yield "sensing.outlier_probability", f"{sizes} beside it", "neither"


def _judge_shaping(scenario: Scenario) -> Complaints:
    """Some command comes through."""
    shaping, limits = scenario.shaping, scenario.limits
    for name in ("speed_m_s", "turn_rate_rad_s"):
        limit = getattr(limits, name)
        for kind in ("dead_zone", "quantum"):
            value = getattr(shaping, f"{kind}_{name}")
            if value > limit:
                most = f"no more than limits.{name} = {limit:g}"
                yield f"shaping.{kind}_{name}", most, repr(value)
