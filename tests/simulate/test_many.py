import dataclasses
import math
import random
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import pytest

from tests.effects_cases import EFFECTS
from turtlelog.compiled_loops import CompiledLoops
from turtlelog.errors import SimulationError
from turtlelog.plants import TURTLESIM, Plant
from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario, resolve_scenario
from turtlelog.simulate import simulate_many, simulate_run
from turtlelog.simulate.compiled.fields import (
    AXIS_KEYS,
    CHOICES,
    DERIVED,
    DERIVED_REAL,
    READ_ELSEWHERE,
    REAL,
    ROBOT_KEYS,
    WHOLE,
    WITHOUT_EFFECT,
    is_compiled,
)
from turtlelog.simulate.compiled.law_fields import PLAIN_KEYS, SIGNAL_KEYS, TABLE_KEYS
from turtlelog.simulate.compiled.runner import KernelRunner
from turtlelog.simulate.many import ANY_LOOP, COST_S, LOOP, find_loop, find_saving

COMPILED_EFFECTS: Final = tuple(sorted(EFFECTS))
PRESETS: Final = ("paper", "textbook")

Kernels = Mapping[CompiledLoops, Any]


@pytest.fixture(scope="module")
def kernels() -> Mapping[CompiledLoops, Any]:
    pytest.importorskip("numba")
    found = {loop: loop.load() for loop in (LOOP, ANY_LOOP)}
    assert None not in found.values()
    return found


def build_random(seed: int) -> Scenario:
    """Return a scenario of a sequential law with some effects, drawn by a seed."""
    draw = random.Random(seed)
    changes: dict[str, Any] = {
        "max_duration_s": draw.choice([1.2, 6.0, 25.0]),
        "seed": draw.randrange(2**40),
        "start.x_m": draw.uniform(0.0, 11.0),
        "start.y_m": draw.uniform(0.0, 11.0),
        "start.heading_rad": draw.uniform(-3.2, 3.2),
        "goal.x_m": draw.uniform(0.0, 11.0),
        "goal.y_m": draw.uniform(0.0, 11.0),
        "goal.heading_rad": draw.uniform(-3.2, 3.2),
        "law.kp_angular": draw.choice([0.8, 4.0, 20.0]),
        "law.kp_linear": draw.choice([0.8, 4.0, 20.0]),
        "law.pause_ticks": draw.choice([0, 7, 34]),
        "law.projection": draw.choice(["bearing", "heading"]),
        "law.wrap_error": draw.random() < 0.5,
        "law.reorient": draw.random() < 0.4,
        "law.timeout_s": draw.choice([3.0, 30.0, math.inf]),
        "law.settled_for_s": draw.choice([0.1, 5.0]),
        "law.standstill_samples": draw.choice([3, 100]),
        "law.heading_tolerance_rad": draw.choice([0.001, 0.05]),
        "law.position_tolerance_m": draw.choice([0.001, 0.05]),
        "limits.speed_m_s": draw.choice([0.5, 1.0, math.inf]),
        "limits.turn_rate_rad_s": draw.choice([0.5, 1.0, math.inf]),
        "loop.period_ticks": draw.choice([1, 1, 3]),
        "loop.start_backlog": draw.choice([1, 5]),
        "loop.pose_queue": draw.choice([1, 5, 10]),
        "loop.command_queue": draw.choice([1, 3, 7]),
        "loop.queue_policy": draw.choice(["one-per-tick", "newest"]),
        "loop.transport_delay_ticks": draw.choice([0, 0, 4]),
        "loop.pose_precision": draw.choice(["float32", "float64"]),
        "start.precision": draw.choice(["float32", "float64"]),
    }
    if has_pid := draw.random() < 0.6:
        changes |= build_pid(draw)
    if draw.random() < 0.3:
        changes["law.schedule"] = build_schedule(draw, has_pid=has_pid)
    for effect in draw.sample(COMPILED_EFFECTS, draw.choice([0, 1, 2, 5])):
        changes |= EFFECTS[effect]
    if "plant.kind" in changes:
        changes |= build_robot(draw)
    if "loop.period_s" in changes:
        changes["loop.period_ticks"] = 1
    return override_scenario(get_preset(draw.choice(PRESETS)), changes)


def build_pid(draw: random.Random) -> Mapping[str, Any]:
    return {
        "law.kind": "sequential-pid",
        "law.ki_angular": draw.choice([0.0, 0.3]),
        "law.kd_angular": draw.choice([0.0, 0.1]),
        "law.ki_linear": draw.choice([0.0, 0.3]),
        "law.kd_linear": draw.choice([0.0, 0.1]),
        "law.derivative_filter_s": draw.choice([0.0, 0.05]),
        "law.anti_windup": draw.choice(["none", "clamping", "back-calculation"]),
        "law.tracking_time_s": draw.choice([0.001, 1.0]),
    }


def build_schedule(draw: random.Random, *, has_pid: bool) -> Mapping[str, Any]:
    """Return a table of one gain or more."""
    at = sorted({draw.choice([0.0, draw.uniform(0.0, 9.0)]) for _ in range(6)} | {1.0, 0.5})
    gains = ["kp_angular", "kp_linear"]
    if has_pid:
        gains += ["ki_angular", "kd_angular", "ki_linear", "kd_linear"]
    chosen = draw.sample(gains, draw.randint(1, len(gains)))
    table = {gain: [draw.uniform(0.01, 3.0) for _ in at] for gain in chosen}
    return {"over": draw.choice(["distance", "heading_error"]), "at": at, **table}


def build_robot(draw: random.Random) -> Mapping[str, Any]:
    return {
        "plant.period_s": draw.choice([0.016, 0.05, 0.21]),
        "plant.speed_gain": draw.choice([0.9, 1.0]),
        "plant.speed_dead_time_s": draw.choice([0.0, 0.033, 0.3]),
        "plant.speed_lag_s": draw.choice([0.0, 1e-9, 0.002, 0.1, 2.0]),
        "plant.turn_gain": draw.choice([1.1, 1.0]),
        "plant.turn_dead_time_s": draw.choice([0.0, 0.05, 0.3]),
        "plant.turn_lag_s": draw.choice([0.0, 1e-9, 0.002, 0.15, 2.0]),
    }


def list_values(run: Run) -> dict[str, Any]:
    """Return all that a run holds, its arrays as bytes."""
    found: dict[str, Any] = {
        field.name: getattr(run, field.name)
        for field in dataclasses.fields(run)
        if field.name not in {"poses", "commands", "samples"}
    }
    for part in ("poses", "commands", "samples"):
        for field in dataclasses.fields(getattr(run, part)):
            value = getattr(getattr(run, part), field.name)
            found[f"{part}.{field.name}"] = value if value is None else describe(value)
    return found


def describe(value: np.ndarray[Any, Any]) -> tuple[Any, ...]:
    return value.shape, value.dtype.str, value.flags.c_contiguous, value.tobytes()


def require_same(kernels: Kernels, scenario: Scenario, plant: Plant | None = None) -> None:
    scenario = resolve_scenario(scenario)
    plant = scenario.plant.facts if plant is None else plant
    loop = find_loop(scenario, plant)
    assert loop is not None
    run = KernelRunner().simulate(kernels[loop], scenario, plant)
    try:
        again = simulate_run(scenario, plant)
    except SimulationError:
        assert run is None
        return
    assert run is not None
    left, right = list_values(run), list_values(again)
    assert [key for key in right if left[key] != right[key]] == []


@pytest.mark.parametrize("block", range(10))
def test_compiled_loop_is_the_interpreted_one_bit_for_bit(kernels: Kernels, block: int) -> None:
    for seed in range(block * 20, block * 20 + 20):
        require_same(kernels, build_random(seed))


@pytest.mark.parametrize("effect", COMPILED_EFFECTS)
@pytest.mark.parametrize("preset", PRESETS)
def test_compiled_loop_has_every_effect(kernels: Kernels, preset: str, effect: str) -> None:
    changes = {"max_duration_s": 8.0, "loop.period_ticks": 1, **EFFECTS[effect]}
    require_same(kernels, override_scenario(get_preset(preset), changes))


OTHER_LAWS: Final = ("posture", "kanayama", "pure-pursuit", "open-loop")


def build_law(draw: random.Random, kind: str) -> Mapping[str, Any]:
    """Return a law that is no sequential one, with numbers of its own."""
    builders = {"posture": build_posture, "open-loop": build_open_loop}
    if kind in builders:
        return {"law.kind": kind, **builders[kind](draw)}
    changes = {
        "law.speed_m_s": draw.choice([0.5, 2.0]),
        "law.end_tolerance_m": draw.choice([0.01, 0.3]),
        **build_path(draw),
    }
    if kind == "kanayama":
        changes |= {"law.kx": draw.uniform(0.5, 10.0), "law.ky": draw.uniform(1.0, 64.0)}
        changes["law.ktheta"] = draw.uniform(1.0, 16.0)
    else:
        changes |= {"law.lookahead_m": draw.choice([0.1, 0.3, 1.5, 20.0])}
        changes["law.kp_along"] = draw.choice([0.0, 1.0])
    return {"law.kind": kind, **changes}


def build_posture(draw: random.Random) -> Mapping[str, Any]:
    return {
        "law.gamma": draw.uniform(0.3, 2.0),
        "law.k": draw.uniform(1.0, 6.0),
        "law.h": draw.uniform(0.5, 5.0),
        "law.timeout_s": draw.choice([3.0, math.inf]),
        "law.position_tolerance_m": draw.choice([0.001, 0.05]),
    }


def build_open_loop(draw: random.Random) -> Mapping[str, Any]:
    signal = draw.choice(["impulse", "step", "ramp", "prbs", "sequence"])
    if signal == "sequence":
        times = sorted({round(draw.uniform(0.0, 4.0), 3) for _ in range(8)})
        found: dict[str, Any] = {"law.time_s": times}
        if draw.random() < 0.7:
            found["law.speed_m_s"] = [draw.uniform(-2.0, 2.0) for _ in times]
        if draw.random() < 0.7:
            found["law.turn_rate_rad_s"] = [draw.uniform(-2.0, 2.0) for _ in times]
        return {"law.signal": signal, **found}
    found = {"law.axis": draw.choice(["turn_rate", "speed", "both"])}
    found |= {"law.amplitude": draw.uniform(-1.0, 1.0), "law.start_s": draw.choice([0.0, 0.5])}
    found["law.duration_s"] = draw.choice([0.7, 3.0])
    if signal == "prbs":
        found |= {"law.order": draw.choice([2, 7, 9]), "law.register": draw.randint(1, 3)}
        found["law.bit_s"] = draw.choice([0.032, 0.1])
    if signal == "impulse":
        found["law.width_s"] = draw.choice([0.016, 0.1])
    return {"law.signal": signal, **found}


def build_path(draw: random.Random) -> Mapping[str, Any]:
    kind = draw.choice(["line", "polygon", "waypoints", "circle", "figure-eight"])
    path: dict[str, Any] = {"path.kind": kind}
    if draw.random() < 0.5:
        path["path.speed_m_s"] = draw.choice([0.4, 1.5])
    if kind in {"circle", "figure-eight"}:
        center = {"path.center_x_m": draw.uniform(3.0, 8.0), "path.center_y_m": 5.5}
        return {**path, **center, "path.size_m": draw.choice([0.05, 0.4, 1.5])}
    count = {"line": 2, "polygon": draw.randint(3, 5)}.get(kind, draw.randint(2, 6))
    points = [(draw.uniform(2.0, 9.0), draw.uniform(2.0, 9.0)) for _ in range(count)]
    if kind == "waypoints" and draw.random() < 0.4:
        path["path.closed"] = count > 2
    return {**path, "path.points": points}


def build_other(kind: str, seed: int) -> Scenario:
    """Return a scenario of such a law with some effects, on a turtle or a robot."""
    draw = random.Random(f"{kind} {seed}")
    changes: dict[str, Any] = {
        "max_duration_s": draw.choice([2.0, 12.0]),
        "seed": draw.randrange(2**40),
        "start.x_m": draw.uniform(1.0, 10.0),
        "start.y_m": draw.uniform(1.0, 10.0),
        "start.heading_rad": draw.uniform(-3.2, 3.2),
        "goal.x_m": draw.uniform(1.0, 10.0),
        "goal.y_m": draw.uniform(1.0, 10.0),
        "limits.speed_m_s": draw.choice([1.0, math.inf]),
        "limits.turn_rate_rad_s": draw.choice([1.0, math.inf]),
        "loop.pose_precision": draw.choice(["float32", "float64"]),
    }
    if draw.random() < 0.5:
        changes["goal.heading_rad"] = draw.uniform(-4.0, 4.0)
    for effect in draw.sample(COMPILED_EFFECTS, draw.choice([0, 1, 3])):
        changes |= EFFECTS[effect]
    if "plant.kind" in changes:
        changes |= build_robot(draw)
    return override_scenario(get_preset("textbook"), changes | {**build_law(draw, kind)})


@pytest.mark.parametrize("block", range(4))
@pytest.mark.parametrize("kind", OTHER_LAWS)
def test_compiled_loop_has_every_law(kernels: Kernels, kind: str, block: int) -> None:
    for seed in range(block * 10, block * 10 + 10):
        require_same(kernels, build_other(kind, seed))


@pytest.mark.parametrize("kind", ["kanayama", "pure-pursuit"])
@pytest.mark.parametrize("corners", [3, 4, 6])
def test_compiled_loop_drives_on_into_the_next_lap(
    kernels: Kernels, kind: str, corners: int
) -> None:
    turns = [2.0 * math.pi * number / corners for number in range(corners)]
    points = tuple((5.0 + math.cos(turn), 5.0 + math.sin(turn)) for turn in turns)
    changes = {"path.kind": "polygon", "path.points": points, "law.kind": kind}
    start = {"start.x_m": 5.0 + math.cos(math.pi / corners), "start.y_m": 5.4}
    scenario = override_scenario(get_preset("textbook"), changes | start)
    assert simulate_run(scenario).stop_reason == "path_end"
    require_same(kernels, scenario)


@pytest.mark.parametrize("effect", COMPILED_EFFECTS)
def test_compiled_robot_is_the_interpreted_one_with_every_effect(
    kernels: Kernels, effect: str
) -> None:
    draw = random.Random(effect)
    for preset in PRESETS:
        changes: dict[str, Any] = {"max_duration_s": 8.0, **EFFECTS["lagged"], **EFFECTS[effect]}
        changes |= {**build_robot(draw), "loop.period_ticks": 1}
        changes["loop.queue_policy"] = draw.choice(["one-per-tick", "newest"])
        require_same(kernels, override_scenario(get_preset(preset), changes))


def test_compiled_robot_is_pushed_on_every_edge(kernels: Kernels) -> None:
    for from_s, to_s in ((0.05, 0.1), (0.06, 0.07), (0.0, math.inf), (0.11, 0.2)):
        changes = {"disturbance.speed_m_s": 0.3, "disturbance.turn_rate_rad_s": 0.2}
        changes |= {"disturbance.from_s": from_s, "disturbance.to_s": to_s, "max_duration_s": 1.0}
        robot = {**EFFECTS["lagged"], "disturbance.noise_speed": 0.01}
        require_same(kernels, override_scenario(get_preset("textbook"), {**robot, **changes}))


def test_compiled_loop_has_the_events_of_walls_and_pauses(kernels: Kernels) -> None:
    wall = override_scenario(
        get_preset("paper"),
        {"goal.x_m": 11.0, "goal.y_m": 11.0, "disturbance.speed_m_s": 2.0, "max_duration_s": 20.0},
    )
    assert {event.kind for event in simulate_run(wall).events} >= {"wall_hit", "poses_dropped"}
    require_same(kernels, wall)


def test_compiled_loop_runs_on_a_finer_clock(kernels: Kernels) -> None:
    require_same(kernels, get_preset("paper"), TURTLESIM.refine(8))


def test_what_the_compiled_loop_cannot_end_is_interpreted(kernels: Kernels) -> None:
    unanswered = override_scenario(
        get_preset("paper"), {"loop.start_backlog": 9, "max_duration_s": 0.1}
    )
    require_same(kernels, unanswered)
    blown = override_scenario(
        get_preset("textbook"),
        {"law.kp_linear": 1e308, "law.kp_angular": 1e308, "limits.turn_rate_rad_s": math.inf},
    )
    with pytest.raises(SimulationError):
        simulate_run(blown)
    require_same(kernels, blown)


def test_hypotenuse_is_that_of_cpython() -> None:
    functions = pytest.importorskip("turtlelog.simulate.compiled.functions", exc_type=ImportError)
    draw = np.random.default_rng(1)
    sides = draw.normal(size=(2, 1_000_000)) * 10.0 ** draw.integers(-9, 9, size=(2, 1_000_000))
    sides[:, :500_000] = draw.uniform(-11.1, 11.1, size=(2, 500_000))
    sides[:, :250_000] = sides[:, :250_000].astype(np.float32)
    found = map_compiled_pairs(functions.find_hypot, *sides)
    expected = np.array([*map(math.hypot, *sides.tolist())])
    assert np.flatnonzero(found != expected).tolist() == []
    # The libm's differs: of this test another hypotenuse would fail.
    assert (np.hypot(*sides) != expected).any()


FUNCTIONS: Final = {
    "sin": math.sin,
    "cos": math.cos,
    "exp": math.exp,
    "expm1": math.expm1,
    "acos": math.acos,
    "sqrt": math.sqrt,
    "floor": np.floor,
    "ceil": np.ceil,
    "rint": np.rint,
}
"""Functions of one number as the kernel calls them."""

FUNCTIONS_OF_TWO: Final = {"atan2": math.atan2, "fmod": np.fmod, "copysign": math.copysign}

OF_PYTHON: Final[Mapping[str, Any]] = {"rint": round}
"""Those that are named otherwise in the interpreted loop."""


def draw_numbers(seed: int) -> np.ndarray[Any, Any]:
    draw = np.random.default_rng(seed)
    return draw.normal(size=1_000_000) * 10.0 ** draw.integers(-6, 3, size=1_000_000)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_compiled_function_is_that_of_python(name: str) -> None:
    values = draw_numbers(1).clip(-700.0, 700.0)
    values = np.abs(values) if name == "sqrt" else values
    values = np.sin(values) if name == "acos" else values
    interpreted = OF_PYTHON.get(name) or getattr(math, name)
    found = map_compiled(FUNCTIONS[name], values)
    assert np.flatnonzero(found != [*map(interpreted, values.tolist())]).tolist() == []


@pytest.mark.parametrize("name", FUNCTIONS_OF_TWO)
def test_compiled_function_of_two_is_that_of_python(name: str) -> None:
    first, second = draw_numbers(1), draw_numbers(2)
    found = map_compiled_pairs(FUNCTIONS_OF_TWO[name], first, second)
    expected = [*map(getattr(math, name), first.tolist(), second.tolist())]
    assert np.flatnonzero(found != expected).tolist() == []


def map_compiled(function: Any, values: np.ndarray[Any, Any]) -> Any:
    numba = pytest.importorskip("numba")
    call = numba.njit(lambda value: function(value))

    @numba.njit  # type: ignore[untyped-decorator]
    def apply(values: Any) -> Any:
        found = np.empty(len(values))
        for row in range(len(values)):
            found[row] = call(values[row])
        return found

    return apply(values)


def map_compiled_pairs(function: Any, first: Any, second: Any) -> Any:
    numba = pytest.importorskip("numba")
    call = numba.njit(lambda left, right: function(left, right))

    @numba.njit  # type: ignore[untyped-decorator]
    def apply(first: Any, second: Any) -> Any:
        found = np.empty(len(first))
        for row in range(len(first)):
            found[row] = call(first[row], second[row])
        return found

    return apply(first, second)


def list_keys(value: Any, prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys of a dataclass and of those within."""
    for field in dataclasses.fields(value):
        inner = getattr(value, field.name)
        if dataclasses.is_dataclass(inner) and prefix + field.name != "law.parameters":
            yield from list_keys(inner, f"{prefix}{field.name}.")
        elif field.name == "parameters":
            yield from list_keys(inner, prefix)
        else:
            yield prefix + field.name


KNOWN_KEYS: Final = {
    *CHOICES,
    *WHOLE,
    *REAL,
    *(key for pair in AXIS_KEYS.values() for key in pair),
    *ROBOT_KEYS,
    *(key for keys in (*DERIVED.values(), *DERIVED_REAL.values()) for key in keys),
    *PLAIN_KEYS,
    *SIGNAL_KEYS,
    *TABLE_KEYS,
    *READ_ELSEWHERE,
    *WITHOUT_EFFECT,
}


@pytest.mark.parametrize("kind", ["sequential-p", "sequential-pid", *OTHER_LAWS])
def test_every_key_of_a_scenario_is_compiled(kind: str) -> None:
    scenario = build_other(kind, 1) if kind in OTHER_LAWS else build_random(1)
    scenario = override_scenario(scenario, {"law.kind": kind})
    assert {*list_keys(scenario)} - KNOWN_KEYS == set()


def test_every_key_that_the_compiled_loop_knows_is_one_of_a_scenario() -> None:
    laws = ["sequential-p", "sequential-pid", *OTHER_LAWS]
    scenarios = [build_other(kind, 1) if kind in OTHER_LAWS else build_random(1) for kind in laws]
    scenarios.append(build_other("kanayama", 1))
    keys = {key for one in scenarios for key in list_keys(one)}
    keys |= {*list_keys(override_scenario(get_preset("textbook"), {"law.kind": "sequential-pid"}))}
    assert KNOWN_KEYS - keys == set()


@pytest.mark.parametrize(
    "changes",
    [
        {"law.kind": "tests/strange_law.py:StrangeLaw", "law.gain_a": 1.0},
        {"max_duration_s": 20_000.0},
    ],
    ids=["own law", "long"],
)
def test_scenario_that_is_not_covered_is_interpreted(changes: Mapping[str, Any]) -> None:
    scenario = resolve_scenario(override_scenario(get_preset("textbook"), changes))
    assert not is_compiled(scenario, scenario.plant.facts)


def load(monkeypatch: pytest.MonkeyPatch, kernels: Kernels) -> None:
    for loop in (LOOP, ANY_LOOP):
        monkeypatch.setattr(loop, "_loops", kernels.get(loop))
        monkeypatch.setattr(loop, "_saved_s", 1e9)


@pytest.mark.parametrize("threads", [1, 3])
def test_many_runs_come_in_order_and_are_those_of_single_runs(
    monkeypatch: pytest.MonkeyPatch, kernels: Kernels, threads: int
) -> None:
    load(monkeypatch, kernels)
    lagged = override_scenario(get_preset("textbook"), EFFECTS["lagged"])
    scenarios = [build_random(3), lagged, *map(build_random, range(4, 12))]
    found = simulate_many(scenarios, threads=threads)
    for run, scenario in zip(found, scenarios, strict=True):
        assert isinstance(run, Run)
        assert list_values(run) == list_values(simulate_run(scenario))
    assert (found.compiled, found.interpreted) == (10, 0)


def test_many_runs_give_the_error_of_one_in_its_place() -> None:
    failing = override_scenario(
        get_preset("paper"), {"loop.start_backlog": 9, "max_duration_s": 0.1}
    )
    error, run = simulate_many([failing, get_preset("paper")], threads=1)
    assert isinstance(error, SimulationError)
    assert "start_backlog = 9" in str(error)
    assert isinstance(run, Run)


def test_run_that_the_compiled_loop_cannot_end_counts_as_interpreted(
    monkeypatch: pytest.MonkeyPatch, kernels: Kernels
) -> None:
    load(monkeypatch, kernels)
    failing = override_scenario(
        get_preset("paper"), {"loop.start_backlog": 9, "max_duration_s": 0.1}
    )
    found = simulate_many([failing, get_preset("paper")], threads=2)
    assert [type(one) for one in found] == [SimulationError, Run]
    assert (found.compiled, found.interpreted) == (1, 1)


def test_without_numba_many_runs_are_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    load(monkeypatch, {})
    found = simulate_many([get_preset("paper")] * 2)
    assert [type(run) for run in found] == [Run, Run]
    assert (found.compiled, found.interpreted) == (0, 2)


def test_compiled_loop_is_loaded_where_it_saves_what_it_costs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loads: list[None] = []
    monkeypatch.setattr(LOOP, "_loops", None)
    monkeypatch.setattr(LOOP, "load", lambda: loads.append(None))
    monkeypatch.setitem(LOOP.__dict__, "cost_s", COST_S)
    scenario = get_preset("paper")
    saved_s = len(simulate_run(scenario).samples) * find_saving(scenario)
    for runs, expected in ((int(COST_S / saved_s) - 1, 0), (int(COST_S / saved_s) + 1, 1)):
        monkeypatch.setattr(LOOP, "_saved_s", 0.0)
        next(simulate_many([scenario] * runs))
        assert len(loads) == expected


def test_many_runs_need_a_thread() -> None:
    with pytest.raises(SimulationError, match="threads: expected at least 1, found 0"):
        simulate_many([], threads=0)
