"""Every metric under every operator: a run that is changed to violate a bound fails that check,
and only that one; the run that it was changed from passes."""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from tests.measure.driven import make_driven_run, publish, respond
from turtlelog.check import CheckResult, check_runs, parse_spec
from turtlelog.measure import list_metrics

LEAST = 100
NAMES = tuple(list_metrics(simulate().declaration))
"""Metrics that two runs have at least in common: some have no value in one of them."""

LAGGING = {"loop__transport_delay_ticks": 6, "max_duration_s": 40.0}


def get_bearing(run: tl.Run) -> float:
    assert run.goal_line is not None
    return run.goal_line.bearing_rad


def dip(run: tl.Run, *, heading_rad: float, along_m: float) -> tl.Run:
    """Let the turtle begin each phase in the wrong direction."""
    rows = np.arange(len(run.poses))
    starts_ns = [span.start_ns for span in run.find_phase_spans() if span.phase != "pause"]
    first, second = (int(np.searchsorted(run.poses.time_ns, at_ns)) for at_ns in starts_ns)
    turned = (rows > first) & (rows < first + 9)
    moved = (rows > second) & (rows < second + 9)
    bearing = get_bearing(run)
    step_m = along_m * np.array([np.cos(bearing), np.sin(bearing)])
    poses = replace(
        run.poses,
        heading_rad=run.poses.heading_rad - heading_rad * turned,
        xy_m=run.poses.xy_m - step_m * moved[:, None],
    )
    return replace(run, poses=poses)


def lose_pose(run: tl.Run) -> tl.Run:
    """Lose a pose that no sample has read."""
    unread = np.setdiff1d(np.arange(1, len(run.poses)), run.samples.pose_sequence)
    if not len(unread):
        raise AssertionError("expected a pose that no sample reads")
    kept = np.arange(len(run.poses)) != unread[0]
    taken = {
        name: getattr(run.poses, name)[kept]
        for name in ("time_ns", "xy_m", "heading_rad", "speed_m_s", "turn_rate_rad_s")
    }
    read = run.samples.pose_sequence
    samples = replace(run.samples, pose_sequence=read - (read > unread[0]))
    return replace(run, poses=replace(run.poses, **taken), samples=samples)


def lose_sample(run: tl.Run) -> tl.Run:
    """Lose a sample and keep the numbers of the others."""
    kept = np.arange(len(run.samples)) != 100
    columns = {
        field.name: values[kept]
        for field in fields(run.samples)
        if (values := getattr(run.samples, field.name)) is not None
    }
    return replace(run, samples=replace(run.samples, **columns))


def climb(run: tl.Run, *, height_m: float, tilt_rad: float) -> tl.Run:
    """Let the turtle climb to a height, leaning."""
    poses = replace(
        run.poses,
        height_m=np.linspace(0.0, height_m, len(run.poses)),
        tilt_rad=np.full(len(run.poses), tilt_rad),
    )
    return replace(run, poses=poses)


def follow_steps(axis: str, *, lag_s: float, steps: int, bump: float = 0.0) -> tl.Run:
    """Return a robot that answers steps of a command, further than asked at first."""
    time_s = np.arange(0.0, 4.0 * steps, 0.02)
    asked = [(4.0 * number, 0.4 * (number % 2)) for number in range(steps)]
    slow, fast = (respond(time_s, asked, lag) for lag in (2.0 * lag_s, lag_s))
    rate, way = (quick + bump * (quick - late) for quick, late in zip(fast, slow, strict=True))
    at_s, published = publish(asked, 4.0 * steps)
    none = np.zeros(len(at_s))
    if axis == "speed":
        return make_driven_run(time_s, speed=(rate, way), commands=(at_s, published, none))
    return make_driven_run(time_s, turn=(rate, way), commands=(at_s, none, published))


CHANGES: Mapping[str, Callable[[], tl.Run]] = {
    "gain": lambda: simulate("paper-kp10"),
    "goal": lambda: simulate(goal__x_m=9.0, goal__y_m=2.0, goal__heading_rad=1.0),
    "goal heading": lambda: simulate(goal__heading_rad=0.5),
    "lag": lambda: simulate("paper-kp10", law__kp_angular=8.0, law__kp_linear=12.0, **LAGGING),
    "less lag": lambda: simulate("paper-kp10", law__kp_angular=7.0, law__kp_linear=12.0, **LAGGING),
    "swinging turn": lambda: simulate("textbook", law__kp_angular=15.5, **LAGGING),
    "slow loop": lambda: simulate(loop__period_ticks=5),
    "no limits": lambda: simulate(limits__speed_m_s=2.0, limits__turn_rate_rad_s=3.0),
    "textbook": lambda: simulate("textbook"),
    "wrong direction": lambda: dip(simulate(), heading_rad=0.01, along_m=0.2),
    "lost sample": lambda: lose_sample(simulate()),
    "lost pose": lambda: lose_pose(simulate(loop__period_ticks=5)),
    "sorted": lambda: replace(
        simulate(), origin=tl.run.Origin(dropped_duplicates=3, sorted_rows=2)
    ),
    "climb": lambda: climb(simulate(), height_m=1.0, tilt_rad=0.2),
    "steep climb": lambda: climb(simulate(), height_m=3.0, tilt_rad=0.5),
    "pause": lambda: simulate(law__pause_ticks=60),
    "steps": lambda: follow_steps("speed", lag_s=0.3, steps=5),
    "overshooting steps": lambda: follow_steps("speed", lag_s=0.2, steps=6, bump=2.0),
    "turns": lambda: follow_steps("turn_rate", lag_s=0.3, steps=5),
    "overshooting turns": lambda: follow_steps("turn_rate", lag_s=0.2, steps=6, bump=2.0),
}


@cache
def build(change: str) -> tl.Run:
    return CHANGES[change]() if change else simulate()


@cache
def measure(change: str) -> Mapping[str, tl.Metric]:
    return tl.measure_run(build(change))


@cache
def list_known(change: str) -> set[str]:
    return {name for name, metric in measure(change).items() if metric.value is not None}


@cache
def choose_pair(name: str) -> tuple[str, str]:
    """Return two runs with different values of a metric, the smaller one first.

    Of all such, two that have values of as many metrics as can be.
    """
    runs = [change for change in ("", *CHANGES) if name in list_known(change)]
    values = {change: measure(change)[name].value or 0.0 for change in runs}
    pairs = [(a, b) for a in runs for b in runs if values[a] < values[b] - 1e-9]
    return max(pairs, key=lambda pair: len(list_known(pair[0]) & list_known(pair[1])))


def bound(name: str, pair: tuple[str, str]) -> tuple[float, float, float]:
    low, high = (measure(change)[name].value or 0.0 for change in pair)
    return low, (low + high) / 2, high


def part(name: str, pair: tuple[str, str]) -> list[str]:
    """Return eight checks that part two runs.

    The large run violates the first four of these, one for each operator, the small run the others.
    """
    low, middle, high = bound(name, pair)
    first = {"<": middle, "<=": low, "==": low, "!=": high}
    second = {">": middle, ">=": high, "==": high, "!=": low}
    operators = (*first.items(), *second.items())
    return [f"{name} {operator} {limit!r}" for operator, limit in operators]


def keep(pair: tuple[str, str]) -> list[str]:
    """Return two checks of every metric that both runs keep to, as tight as can be."""
    both = sorted(list_known(pair[0]) & list_known(pair[1]))
    # Of runs without samples there are fewer metrics.
    assert len(both) >= (LEAST if all(len(build(one).samples) for one in pair) else LEAST // 3)
    texts = []
    for name in both:
        low, high = sorted(measure(change)[name].value or 0.0 for change in pair)
        texts += [f"{name} <= {high!r}", f"{low!r} <= {name}"]
    return texts


@cache
def judge(pair: tuple[str, str]) -> list[dict[str, CheckResult]]:
    """Judge two runs once for all metrics whose checks part them."""
    parted = [name for name in NAMES if choose_pair(name) == pair]
    texts = [*keep(pair), *(text for name in parted for text in part(name, pair))]
    spec = parse_spec({"checks": {text: {"expect": text} for text in texts}})
    judged = (check_runs(spec, [(change, build(change))]) for change in pair)
    return [{result.check: result for result in results} for results in judged]


@pytest.mark.everyday("rotate.overshoot", "run.duplicates", "run.turn_rate_steps")
@pytest.mark.parametrize("name", NAMES)
def test_a_run_changed_to_violate_the_bounds_on_a_metric_fails_these_and_no_other(
    name: str,
) -> None:
    pair = choose_pair(name)
    parting = part(name, pair)
    for found, expected in zip(judge(pair), (parting[4:], parting[:4]), strict=True):
        results = [found[text] for text in (*parting, *keep(pair))]
        failed = [result for result in results if result.verdict == "FAIL"]
        assert [result.check for result in failed] == expected
        for result in failed:
            assert result.margin is not None
            assert result.margin < 0 or (" != " in result.check and result.margin == 0)


@pytest.mark.parametrize("name", NAMES)
def test_a_test_sees_the_same_as_a_spec(name: str) -> None:
    from turtlelog.check.result import watch_metric

    pair = choose_pair(name)
    low, middle, high = bound(name, pair)
    noted: list[CheckResult] = []
    small, large = (watch_metric(build(change), change, name, noted.append) for change in pair)
    passed = [small < middle, small <= low, large > middle, large >= high]
    passed += [small == low, large != low]
    failed = [large < middle, large <= low, small > middle, small >= high]
    failed += [large == low, small != low]
    assert (all(passed), any(failed)) == (True, False)
    assert [result.verdict for result in noted] == ["PASS"] * 6 + ["FAIL"] * 6


FORMULAS = {
    "always": "always(abs(cross_track) <= 0.05)",
    "eventually": "eventually[0, 12](distance <= 0.01)",
    "until": "(speed == 0 or phase == 'translate') until phase == 'translate'",
    "not": "not eventually(turn_rate < -0.5)",
    "and": "always(abs(speed) <= 1 and abs(turn_rate) <= 1)",
    "or": "always(phase == 'rotate' or abs(turn_rate) < 0.9)",
    "implies": "always(phase == 'translate' implies speed > -0.1)",
}
TURNING, DRIVING = 50, 300


def step_aside(run: tl.Run) -> tl.Run:
    """Move the turtle 10 cm to the left of its line for one pose."""
    row, bearing = run.samples.pose_sequence[DRIVING], get_bearing(run)
    xy_m = run.poses.xy_m.copy()
    xy_m[row] += 0.1 * np.array([-np.sin(bearing), np.cos(bearing)])
    return replace(run, poses=replace(run.poses, xy_m=xy_m))


def command(column: str, row: int, value: float) -> tl.Run:
    """Change one command of one sample."""
    run = simulate()
    values = getattr(run.samples, column).copy()
    values[row] = value
    return replace(run, samples=replace(run.samples, **{column: values}))


VIOLATIONS: Mapping[str, Callable[[], tl.Run]] = {
    "always": lambda: step_aside(simulate()),
    "eventually": lambda: build("slow loop"),
    "until": lambda: command("speed_m_s", TURNING, 0.5),
    "not": lambda: command("turn_rate_rad_s", TURNING, -0.6),
    "and": lambda: command("speed_m_s", DRIVING, 1.5),
    "or": lambda: command("turn_rate_rad_s", DRIVING, 0.95),
    "implies": lambda: command("speed_m_s", DRIVING, -0.5),
}


@pytest.mark.parametrize("operator", FORMULAS)
def test_a_run_changed_to_violate_a_formula_fails_it_and_no_other(operator: str) -> None:
    spec = parse_spec({"checks": {name: {"holds": text} for name, text in FORMULAS.items()}})
    run = simulate()
    phases = [run.phase_names[row] for row in run.samples.phase[[TURNING, DRIVING]]]
    assert phases == ["rotate", "translate"]
    assert {result.verdict for result in check_runs(spec, [("good", run)])} == {"PASS"}
    results = check_runs(spec, [("bad", VIOLATIONS[operator]())])
    (failed,) = [result for result in results if result.verdict == "FAIL"]
    assert failed.check == operator
    assert failed.first_violation_s is not None
