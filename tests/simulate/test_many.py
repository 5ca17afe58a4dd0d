import dataclasses
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
import pytest

from tests.effects_cases import EFFECTS
from tests.simulate.random_scenarios import (
    DRAWN_EFFECTS,
    OTHER_LAWS,
    build_limits,
    build_other,
    build_random,
    build_robot,
)
from tests.simulate.run_values import list_values
from turtlelog.errors import SimulationError
from turtlelog.laws import find_law
from turtlelog.plants import TURTLESIM, Plant
from turtlelog.run import Run
from turtlelog.scenario import (
    Scenario,
    get_preset,
    override_scenario,
    resolve_scenario,
)
from turtlelog.simulate import declare_scenario, simulate_many, simulate_run
from turtlelog.simulate.compiled_loop import CompiledRunner
from turtlelog.simulate.compiled_twins import Twins, build_dtype
from turtlelog.simulate.loop_parts import build_settings
from turtlelog.simulate.many import COST_S, CompiledCode, find_loop, find_saving

PRESETS: Final = ("paper", "textbook")


@pytest.fixture(scope="module", autouse=True)
def has_numba() -> None:
    pytest.importorskip("numba")


def find_loops(scenario: Scenario, plant: Plant | None = None) -> CompiledCode:
    scenario = resolve_scenario(scenario)
    found = find_loop(scenario, scenario.plant.facts if plant is None else plant)
    assert found is not None
    return found


@cache
def load_loop(loops: CompiledCode) -> Any:
    found = loops.load()
    assert found is not None
    return found


def require_same(scenario: Scenario, plant: Plant | None = None) -> None:
    scenario = resolve_scenario(scenario)
    plant = scenario.plant.facts if plant is None else plant
    loop = load_loop(find_loops(scenario, plant))
    run = CompiledRunner().simulate(loop, scenario, plant)
    try:
        again = simulate_run(scenario, plant)
    except SimulationError:
        assert run is None
        return
    assert run is not None
    left, right = list_values(run), list_values(again)
    assert [key for key in right if left[key] != right[key]] == []


@pytest.mark.everyday("0", "1", "2", "3")
@pytest.mark.parametrize("block", range(10))
def test_compiled_loop_is_the_plain_one_bit_for_bit(block: int) -> None:
    for seed in range(block * 20, block * 20 + 20):
        require_same(build_random(seed))


@pytest.mark.parametrize("effect", DRAWN_EFFECTS)
@pytest.mark.parametrize("preset", PRESETS)
def test_compiled_loop_has_every_effect(preset: str, effect: str) -> None:
    changes = {"max_duration_s": 8.0, "loop.period_ticks": 1, **EFFECTS[effect]}
    require_same(override_scenario(get_preset(preset), changes))


@pytest.mark.everyday("pure-pursuit-turtlesim")
@pytest.mark.parametrize("plant", ["turtlesim", "lagged"])
@pytest.mark.parametrize("kind", OTHER_LAWS)
def test_compiled_loop_has_every_law(kind: str, plant: str) -> None:
    changes = EFFECTS["lagged"] if plant == "lagged" else {}
    scenarios = [override_scenario(build_other(kind, seed), changes) for seed in range(12)]
    found = [one for one in scenarios if one.plant.kind == plant]
    assert len(found) > 8
    for scenario in found:
        require_same(scenario)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["kanayama", "pure-pursuit"])
@pytest.mark.parametrize("corners", [3, 4, 6])
def test_compiled_loop_drives_on_into_the_next_lap(kind: str, corners: int) -> None:
    turns = [2.0 * math.pi * number / corners for number in range(corners)]
    points = tuple((5.0 + math.cos(turn), 5.0 + math.sin(turn)) for turn in turns)
    changes = {"path.kind": "polygon", "path.points": points, "law.kind": kind}
    start = {"start.x_m": 5.0 + math.cos(math.pi / corners), "start.y_m": 5.4}
    scenario = override_scenario(get_preset("textbook"), changes | start)
    assert simulate_run(scenario).stop_reason == "path_end"
    require_same(scenario)


@pytest.mark.parametrize("effect", DRAWN_EFFECTS)
def test_compiled_robot_is_the_plain_one_with_every_effect(effect: str) -> None:
    draw = random.Random(effect)
    for preset in PRESETS:
        changes: dict[str, Any] = {"max_duration_s": 8.0, **EFFECTS["lagged"], **EFFECTS[effect]}
        changes |= {**build_robot(draw), **build_limits(draw), "loop.period_ticks": 1}
        changes["loop.queue_policy"] = draw.choice(["one-per-tick", "newest"])
        require_same(override_scenario(get_preset(preset), changes))


@pytest.mark.parametrize("kind", ["sequential-p", "sequential-pid"])
def test_compiled_robot_with_limits_is_the_plain_one_bit_for_bit(kind: str) -> None:
    draw = random.Random(f"limits {kind}")
    for _ in range(40):
        changes: dict[str, Any] = {"max_duration_s": 8.0, **EFFECTS["lagged"], "law.kind": kind}
        changes |= {**build_robot(draw), **build_limits(draw)}
        changes["start.heading_rad"] = draw.uniform(-3.0, 3.0)
        changes["disturbance.turn_rate_rad_s"] = draw.choice([0.0, 0.1])
        changes["loop.transport_delay_s"] = draw.choice([0.0, 0.03])
        require_same(override_scenario(get_preset("textbook"), changes))


def test_compiled_robot_is_pushed_on_every_edge() -> None:
    for from_s, to_s in ((0.05, 0.1), (0.06, 0.07), (0.0, math.inf), (0.11, 0.2)):
        changes = {"disturbance.speed_m_s": 0.3, "disturbance.turn_rate_rad_s": 0.2}
        changes |= {"disturbance.from_s": from_s, "disturbance.to_s": to_s, "max_duration_s": 1.0}
        robot = {**EFFECTS["lagged"], "disturbance.noise_speed": 0.01}
        require_same(override_scenario(get_preset("textbook"), {**robot, **changes}))


def test_compiled_loop_has_the_events_of_walls_and_pauses() -> None:
    wall = override_scenario(
        get_preset("paper"),
        {"goal.x_m": 11.0, "goal.y_m": 11.0, "disturbance.speed_m_s": 2.0, "max_duration_s": 20.0},
    )
    assert {event.kind for event in simulate_run(wall).events} >= {"wall_hit", "poses_dropped"}
    require_same(wall)


def test_compiled_loop_runs_on_a_finer_clock() -> None:
    require_same(get_preset("paper"), TURTLESIM.refine(8))


def test_what_the_compiled_loop_cannot_end_runs_plain() -> None:
    unanswered = override_scenario(
        get_preset("paper"), {"loop.start_backlog": 9, "max_duration_s": 0.1}
    )
    require_same(unanswered)
    blown = override_scenario(
        get_preset("textbook"),
        {"law.kp_linear": 1e308, "law.kp_angular": 1e308, "limits.turn_rate_rad_s": math.inf},
    )
    with pytest.raises(SimulationError):
        simulate_run(blown)
    require_same(blown)


def test_hypotenuse_is_that_of_cpython() -> None:
    draw = np.random.default_rng(1)
    sides = draw.normal(size=(2, 1_000_000)) * 10.0 ** draw.integers(-9, 9, size=(2, 1_000_000))
    sides[:, :500_000] = draw.uniform(-11.1, 11.1, size=(2, 500_000))
    sides[:, :250_000] = sides[:, :250_000].astype(np.float32)
    found = map_compiled_pairs(Twins().compile(math.hypot), *sides)
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
    return draw.normal(size=200_000) * 10.0 ** draw.integers(-6, 3, size=200_000)


@pytest.mark.everyday("sin", "expm1", "rint")
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


READ_BEFORE: Final = {
    *("name", "max_duration_s", "seed", "plant.kind"),
    *("start.x_m", "start.y_m", "start.heading_rad", "start.precision"),
}
"""Keys of which the scene, the first state and the random numbers are made."""

OF_PATHS: Final = {
    *("path.kind", "path.points", "path.closed"),
    *("path.center_x_m", "path.center_y_m", "path.size_m"),
}
"""Those of which the pieces of a path are made."""

OF_LAWS: Final = {
    "sequential-p": {"law.schedule"},
    "sequential-pid": {"law.schedule"},
    "posture": set(),
    "kanayama": OF_PATHS,
    "pure-pursuit": OF_PATHS,
    "open-loop": {
        *("law.signal", "law.axis", "law.start_s", "law.duration_s", "law.width_s"),
        *("law.order", "law.register", "law.bit_s"),
        *("law.time_s", "law.speed_m_s", "law.turn_rate_rad_s"),
    },
}
"""Those of which a law makes numbers of its own, and a table."""


@pytest.mark.parametrize("kind", OF_LAWS)
def test_every_key_of_a_scenario_is_a_number_of_the_loop(kind: str) -> None:
    scenario = build_other(kind, 1) if kind in OTHER_LAWS else build_random(1)
    changes = {"law.kind": kind, **EFFECTS["lagged"]}
    scenario = resolve_scenario(override_scenario(scenario, changes))
    shape, _, _ = build_settings(
        scenario, find_law(kind), declare_scenario(scenario), scenario.plant.facts
    )
    names = build_dtype(shape.Settings)
    numbers = {f"{one}.{name}" for one in names.names or () for name in names[one].names or ()}
    # A scenario without a path has no keys of one; the open loop has a number of the same name.
    wanted = {*list_keys(scenario)} - {"path", "law.kind"}
    assert wanted - numbers == READ_BEFORE | OF_LAWS[kind]


@pytest.mark.parametrize(
    "changes",
    [
        {"law.kind": "tests/strange_law.py:StrangeLaw", "law.gain_a": 1.0},
        {"max_duration_s": 20_000.0},
    ],
    ids=["own law", "long"],
)
def test_scenario_that_is_not_covered_runs_plain(changes: Mapping[str, Any]) -> None:
    scenario = resolve_scenario(override_scenario(get_preset("textbook"), changes))
    assert find_loop(scenario, scenario.plant.facts) is None


def load(monkeypatch: pytest.MonkeyPatch, scenarios: Sequence[Scenario], *, found: bool) -> None:
    """Have the compiled loops of scenarios at hand, or not to be had."""
    for loops in map(find_loops, scenarios):
        monkeypatch.setattr(loops, "_loops", load_loop(loops) if found else None)
        monkeypatch.setattr(loops, "_saved_s", 1e9)


@pytest.mark.parametrize("threads", [1, 3])
def test_many_runs_come_in_order_and_are_those_of_single_runs(
    monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    lagged = override_scenario(get_preset("textbook"), EFFECTS["lagged"])
    scenarios = [build_random(3), lagged, *map(build_random, range(4, 12))]
    load(monkeypatch, scenarios, found=True)
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
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    load(monkeypatch, [get_preset("paper")], found=True)
    failing = override_scenario(
        get_preset("paper"), {"loop.start_backlog": 9, "max_duration_s": 0.1}
    )
    found = simulate_many([failing, get_preset("paper")], threads=2)
    assert [type(one) for one in found] == [SimulationError, Run]
    assert (found.compiled, found.interpreted) == (1, 1)


def test_without_numba_many_runs_are_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    load(monkeypatch, [get_preset("paper")], found=False)
    found = simulate_many([get_preset("paper")] * 2)
    assert [type(run) for run in found] == [Run, Run]
    assert (found.compiled, found.interpreted) == (0, 2)


def test_compiled_loop_is_loaded_where_it_saves_what_it_costs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loads: list[None] = []
    scenario = get_preset("paper")
    loops = find_loops(scenario)
    monkeypatch.setattr(loops, "_loops", None)
    monkeypatch.setattr(loops, "load", lambda: loads.append(None))
    monkeypatch.setitem(loops.__dict__, "cost_s", COST_S)
    saved_s = len(simulate_run(scenario).samples) * find_saving(scenario)
    for runs, expected in ((int(COST_S / saved_s) - 1, 0), (int(COST_S / saved_s) + 1, 1)):
        monkeypatch.setattr(loops, "_saved_s", 0.0)
        next(simulate_many([scenario] * runs))
        assert len(loads) == expected


def test_many_runs_need_a_thread() -> None:
    with pytest.raises(SimulationError, match="threads: expected at least 1, found 0"):
        simulate_many([], threads=0)
