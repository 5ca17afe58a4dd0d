import dataclasses
import math
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from tests.effects_cases import EFFECTS
from tests.simulate.random_scenarios import DRAWN_EFFECTS, build_other, build_random
from turtlelog.errors import SimulationError, SweepError, TurtlelogError
from turtlelog.measure import measure_run
from turtlelog.measure.metric import Status
from turtlelog.scenario import Scenario, get_preset, override_scenario, resolve_scenario
from turtlelog.simulate import declare_scenario, simulate_run
from turtlelog.simulate.many import COST_S, CompiledCode
from turtlelog.sweep import batch
from turtlelog.sweep.batch import MeasuredRows, measure_rows
from turtlelog.sweep.batch_arrays import COURSES, CURVES, FREE_KEYS, STATUSES, prepare_rows
from turtlelog.sweep.sweep_plan import build_row_scenario
from turtlelog.sweep.sweep_rows import list_row_metrics

LOOPS: Final = ("rotate", "translate", "reorient")
METRICS: Final = (*(f"{loop}.{name}" for loop in LOOPS for name in CURVES), *COURSES)
OF_PATHS: Final = (*(f"{loop}.{name}" for loop in ("along", "cross") for name in CURVES), *COURSES)
PAPER: Final = get_preset("paper")
TRACKING: Final = get_preset("track-square")
OPEN: Final = get_preset("plant-step")


@cache
def load(loops: CompiledCode) -> Any:
    found = loops.load()
    assert found is not None
    return found


@pytest.fixture(autouse=True)
def loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the batch of every law and plant at hand."""
    pytest.importorskip("numba")
    monkeypatch.setattr(CompiledCode, "find", load)


def require_row(
    rows: MeasuredRows, row: int, scenario: Scenario, metrics: tuple[str, ...] = METRICS
) -> None:
    """Hold a row to the metrics of a single run, values bit for bit."""
    try:
        run = simulate_run(scenario)
    except SimulationError as err:
        # The row's scenario has a name of its own.
        require_reason(rows.failed[row], str(err).partition(":")[2])
        return
    assert rows.failed[row] is None
    assert (rows.stop_reasons[row], rows.samples[row]) == (run.stop_reason, len(run.samples))
    found = {
        name: (STATUSES[rows.statuses[name][row]], rows.values[name][row].hex()) for name in metrics
    }
    wanted = {
        name: (metric.status, (math.nan if metric.value is None else metric.value).hex())
        for name, metric in measure_run(run, only=metrics).items()
    }
    assert {name: found[name] for name in wanted if found[name] != wanted[name]} == {}


def require_reason(failed: str | None, reason: str) -> None:
    assert failed is not None
    assert failed.endswith(reason)


@pytest.mark.everyday("0")
@pytest.mark.parametrize("block", range(10))
def test_batch_measures_what_a_single_run_measures(block: int) -> None:
    for seed in range(1000 + block * 20, 1020 + block * 20):
        base = build_random(seed)
        gains = [0.3, base.law.parameters.kp_linear, 30.0]
        rows = measure_rows(base, {"law.kp_linear": gains}, METRICS, threads=1)
        assert rows.compiled + rows.interpreted == 3
        for row, gain in enumerate(gains):
            require_row(rows, row, override_scenario(base, {"law.kp_linear": gain}))


@pytest.mark.thorough
def test_a_law_with_one_phase_and_two_loops_is_measured_as_in_a_single_run() -> None:
    metrics = (*(f"{loop}.{name}" for loop in ("approach", "align") for name in CURVES), *COURSES)
    for seed in range(3):
        base = build_other("posture", seed)
        limits = [0.7, 1.5]
        rows = measure_rows(base, {"limits.turn_rate_rad_s": limits}, metrics, threads=1)
        assert rows.compiled == 2
        for row, limit in enumerate(limits):
            changed = override_scenario(base, {"limits.turn_rate_rad_s": limit})
            require_row(rows, row, changed, metrics)


@pytest.mark.thorough
def test_a_heading_beyond_half_a_turn_ends_as_in_a_single_run() -> None:
    """The turtle ends at -pi, where it turned past pi."""
    posture = get_preset("posture")
    columns = {"start.heading_rad": [3.1, 2.1], "goal.heading_rad": [-3.1, -2.1]}
    rows = measure_rows(posture, columns, ["final.heading_error"], threads=1)
    assert rows.compiled == 2
    for row in range(2):
        changed = override_scenario(posture, {key: column[row] for key, column in columns.items()})
        require_row(rows, row, changed, ("final.heading_error",))


@pytest.mark.everyday("0-pure-pursuit")
@pytest.mark.parametrize("law", ["pure-pursuit", "kanayama"])
@pytest.mark.parametrize("block", range(5))
def test_laws_along_paths_are_measured_as_in_a_single_run(law: str, block: int) -> None:
    key = "law.lookahead_m" if law == "pure-pursuit" else "law.ky"
    for seed in range(block * 12, block * 12 + 12):
        base = build_other(law, seed)
        if base.plant.kind == "lagged" and block == 0:
            continue  # its loop is not compiled every day
        rows = measure_rows(base, {key: [0.25, 3.0]}, OF_PATHS, threads=1)
        assert (rows.compiled, rows.interpreted) == (2, 0)
        for row, gain in enumerate((0.25, 3.0)):
            require_row(rows, row, override_scenario(base, {key: gain}), OF_PATHS)


def set_path_speed(scenario: Scenario, speed_m_s: float | None) -> Scenario:
    assert scenario.path is not None
    path = dataclasses.replace(scenario.path, speed_m_s=speed_m_s)
    return dataclasses.replace(scenario, path=path)


@pytest.mark.parametrize(("speed_m_s", "start_x_m"), [(None, 5.5), (0.5, 3.0)])
def test_every_essential_metric_of_a_lap_is_measured_in_the_batch(
    speed_m_s: float | None, start_x_m: float
) -> None:
    base = set_path_speed(override_scenario(TRACKING, {"start.x_m": start_x_m}), speed_m_s)
    essential = list_row_metrics(declare_scenario(resolve_scenario(base)), None)
    assert {*essential} <= {*OF_PATHS}
    ahead_m = [0.15, 1.0]
    rows = measure_rows(base, {"law.lookahead_m": ahead_m}, OF_PATHS, threads=2)
    assert (rows.compiled, rows.interpreted) == (2, 0)
    has_value = {name: STATUSES[rows.statuses[name][1]] is Status.OK for name in essential}
    assert has_value["cross.corner_overshoot"]
    assert has_value["along.lag"] == (speed_m_s is not None)
    for row, ahead in enumerate(ahead_m):
        require_row(rows, row, override_scenario(base, {"law.lookahead_m": ahead}), OF_PATHS)


def test_rows_with_another_path_take_the_path_of_a_run() -> None:
    base = override_scenario(TRACKING, {"max_duration_s": 3.0})
    rows = measure_rows(base, {"path.speed_m_s": [0.4, 0.4, 0.5]}, OF_PATHS, threads=1)
    assert (rows.compiled, rows.interpreted) == (2, 1)
    for row, speed_m_s in enumerate((0.4, 0.4, 0.5)):
        require_row(rows, row, override_scenario(base, {"path.speed_m_s": speed_m_s}), OF_PATHS)


OWN_TRACKER: Final = """
import dataclasses
from turtlelog.laws.pure_pursuit import PART as PurePursuit
from turtlelog.run.loops import ControlLoop, Declaration


def declare(parameters, goal, path):
    loops = PurePursuit.declare(parameters, goal, path).loops
    turn = ControlLoop(name="turn", signal="heading", command="turn_rate", reference="path")
    phases = {"track": ("along", "cross", "turn")}
    return Declaration(loops=(*loops, turn), phases=phases, uses_goal=False)


P = dataclasses.replace(PurePursuit, declare=declare)
"""


@pytest.mark.thorough
def test_a_law_of_the_users_own_may_follow_the_direction_of_a_path(tmp_path: Path) -> None:
    """Its loop is compiled."""
    path = tmp_path / "own.py"
    path.write_text(OWN_TRACKER, "utf-8")
    metrics = (*OF_PATHS, *(f"turn.{name}" for name in CURVES))
    own = override_scenario(TRACKING, {"law.kind": f"{path}:P"}, trust_law=True)
    for speed_m_s in (None, 0.5):
        own = set_path_speed(own, speed_m_s)
        rows = measure_rows(own, {"law.lookahead_m": [0.3, 1.0]}, metrics, threads=1)
        assert (rows.compiled, rows.interpreted, rows.notes) == (2, 0, ())
        for row, ahead_m in enumerate((0.3, 1.0)):
            changed = override_scenario(own, {"law.lookahead_m": ahead_m})
            require_row(rows, row, changed, metrics)


@pytest.mark.everyday("sensing_jitter", "transport_delay", "noise", "quantum", "lagged", "timer")
@pytest.mark.parametrize("effect", DRAWN_EFFECTS)
def test_batch_has_every_effect_and_falls_back_nowhere(effect: str) -> None:
    base = override_scenario(PAPER, {"max_duration_s": 8.0, **EFFECTS[effect]})
    columns: dict[str, list[Any]] = {"seed": [1, 1, 2**63 + 5], "law.kp_angular": [1.0, 4.0, 4.0]}
    rows = measure_rows(base, columns, METRICS, threads=2)
    assert (rows.compiled, rows.interpreted) == (3, 0)
    for row in range(3):
        changes = {key: column[row] for key, column in columns.items()}
        require_row(rows, row, override_scenario(base, changes))


@pytest.mark.parametrize("preset", ["paper", "lagged"])
def test_metric_is_the_same_asked_for_alone_and_with_all_others(preset: str) -> None:
    base = override_scenario(get_preset(preset), {"max_duration_s": 8.0})
    if preset == "paper":
        base = override_scenario(base, {"law.reorient": True, "goal.heading_rad": 1.0})
    columns = {"loop.transport_delay_ticks": [0, 6]}
    rows = measure_rows(base, columns, METRICS, threads=1)
    for name in METRICS:
        alone = measure_rows(base, columns, [name], threads=1)
        assert alone.compiled == rows.compiled
        assert alone.values[name].tobytes() == rows.values[name].tobytes()
        assert alone.statuses[name].tobytes() == rows.statuses[name].tobytes()


@pytest.mark.thorough
def test_batch_that_another_process_compiled_runs_from_the_cache() -> None:
    code = (
        "from turtlelog.scenario import get_preset\n"
        "from turtlelog.sweep.batch import find_batch, measure_rows\n"
        "loops = find_batch(get_preset('paper'))\n"
        "loops._loops = loops.load()\n"
        "keys = {'law.kp_linear': [2.0, 4.0]}\n"
        "rows = measure_rows(get_preset('paper'), keys, ['run.path_length'], threads=1)\n"
        "is_new = not loops.find().loop.run.stats.cache_hits\n"
        "found = loops.cost_s, is_new, rows.compiled\n"
        "print(*found, *(value.hex() for value in rows.values['run.path_length']))"
    )
    loops = batch.find_batch(PAPER)
    assert loops is not None
    load(loops)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    rows = measure_rows(PAPER, {"law.kp_linear": [2.0, 4.0]}, ["run.path_length"], threads=1)
    lengths_m = rows.values["run.path_length"]
    assert done.stdout.split() == [str(COST_S), "False", "2", *(value.hex() for value in lengths_m)]


def test_line_to_the_goal_begins_where_a_pushed_robot_is_read_first() -> None:
    push = {"disturbance.speed_m_s": 0.3, "loop.start_backlog": 40, "max_duration_s": 8.0}
    base = override_scenario(PAPER, push)
    rows = measure_rows(base, {"law.kp_linear": [1.0, 4.0]}, METRICS, threads=1)
    assert (rows.compiled, rows.interpreted) == (2, 0)
    for row, gain in enumerate((1.0, 4.0)):
        require_row(rows, row, override_scenario(base, {"law.kp_linear": gain}))


def test_full_turns_between_poses_are_counted_as_in_a_single_run() -> None:
    """A new loop is compiled."""
    fast = {
        "plant.period_s": 1.0,
        "plant.turn_dead_time_s": 0.0,
        "limits.turn_rate_rad_s": math.inf,
    }
    base = override_scenario(get_preset("lagged"), {**fast, "law.kp_angular": 1.99})
    lags_s = [0.0, 0.3]
    rows = measure_rows(base, {"plant.turn_lag_s": lags_s}, METRICS)
    assert (rows.compiled, rows.interpreted) == (2, 0)
    for row, lag_s in enumerate(lags_s):
        require_row(rows, row, override_scenario(base, {"plant.turn_lag_s": lag_s}))


def test_rows_are_the_same_on_one_thread_and_on_two() -> None:
    columns = {"law.kp_linear": np.linspace(0.5, 12.0, 80).tolist()}
    one, two = (measure_rows(PAPER, columns, METRICS, threads=count) for count in (1, 2))
    for name in METRICS:
        assert one.values[name].tobytes() == two.values[name].tobytes()
        assert one.statuses[name].tobytes() == two.statuses[name].tobytes()
    assert one.stop_reasons == two.stop_reasons


FREE_VALUES: Final[dict[str, Any]] = {
    "law.kp_angular": 2,
    "law.kp_linear": 3.5,
    "law.ki_angular": 0.2,
    "law.ki_linear": 0.0,
    "law.kd_angular": 0.0,
    "law.kd_linear": 0.1,
    "law.pause_ticks": 7,
    "law.heading_tolerance_rad": 0.01,
    "law.position_tolerance_m": 0.02,
    "law.timeout_s": math.inf,
    "law.settled_within_m": 0.02,
    "law.settled_for_s": 2,
    "law.standstill_samples": 30,
    "law.standstill_below": 0.01,
    "law.derivative_filter_s": 0.05,
    "law.tracking_time_s": 0.3,
    "plant.speed_gain": 0.8,
    "plant.turn_gain": 1.2,
    "plant.speed_lag_s": 0.3,
    "plant.turn_lag_s": 0,
    "seed": 11,
}


def test_settings_of_free_keys_are_those_of_their_scenarios() -> None:
    assert FREE_VALUES.keys() == FREE_KEYS
    robot = {"law.kind": "sequential-pid", **EFFECTS["lagged"]}
    base = override_scenario(PAPER, robot)
    columns = {key: [value] for key, value in FREE_VALUES.items()}
    joint = prepare_rows(override_scenario(base, FREE_VALUES), {"name": ["any"]}, [0])
    free = prepare_rows(base, columns, [0])
    assert (free.others, joint.others) == ([], [])
    for name in ("settings", "starts", "states", "table", "lines"):
        # By their texts, which tell each number: between the numbers of a record is room for any.
        assert repr(getattr(free, name).tolist()) == repr(getattr(joint, name).tolist())
    assert free.seeds.tolist() == joint.seeds.tolist()


@pytest.mark.parametrize(
    ("key", "column", "others"),
    [
        ("law.kp_linear", [1.0, 2.0, 3.0], []),
        ("law.kp_linear", [1.0, 0.0, 3.0], [1]),
        ("law.kp_linear", [1.0, math.nan, 3.0], [1]),
        ("law.kp_linear", [math.nan, 2.0, 3.0], [0]),
        ("law.kp_linear", [1.0, 2.0, math.inf], [2]),
        ("law.kp_linear", [1, 2.5, True], [2]),
        ("law.kp_linear", [1.0, "2", 3.0], [1]),
        ("law.pause_ticks", [0, 3, 1_000_001], [2]),
        ("law.pause_ticks", [0.5, 3.0, 4.0], [0, 1, 2]),
        ("seed", [3, -1, 2**63 + 1], [1]),
        ("law.tracking_time_s", [1.0, 2.0, 3.0], [0, 1, 2]),
    ],
)
def test_every_value_of_a_column_is_judged(key: str, column: list[Any], others: list[int]) -> None:
    found = prepare_rows(PAPER, {key: column}, range(3))
    for row, value in enumerate(column):
        try:
            resolve_scenario(build_row_scenario(PAPER, [key], [value], row))
        except TurtlelogError:
            assert row in others
    assert found.others == others


def test_rows_that_are_no_scenario_say_why() -> None:
    columns: dict[str, list[Any]] = {
        "law.kp_linear": [1.0, -1.0, 2.0],
        "loop.start_backlog": [5, 5, -5],
    }
    rows = measure_rows(PAPER, columns, ["run.duration"], threads=1)
    assert rows.failed[0] is None
    assert rows.failed[1] is not None
    assert "law.kp_linear" in rows.failed[1]
    assert rows.failed[2] is not None
    assert "loop.start_backlog" in rows.failed[2]
    assert rows.statuses["run.duration"].tolist() == [0, -1, -1]
    assert (rows.compiled, rows.interpreted) == (1, 2)


def test_metric_or_law_that_is_not_compiled_takes_the_path_of_a_run() -> None:
    columns = {"law.kp_linear": [1.0, 2.0]}
    rows = measure_rows(PAPER, columns, ["run.iae", "run.duration"])
    assert (rows.compiled, rows.interpreted) == (0, 2)
    scenario = build_row_scenario(PAPER, ["law.kp_linear"], [2.0], 1)
    wanted = measure_run(simulate_run(scenario), only=["run.iae"])["run.iae"]
    assert rows.values["run.iae"][1] == wanted.value
    other = measure_rows(OPEN, {"max_duration_s": [3.0, 4.0]}, ["run.duration"])
    assert (other.compiled, other.interpreted) == (0, 2)


@pytest.mark.parametrize(
    ("column", "compiled"),
    [
        (["lagged", "lagged"], 0),
        (["lagged", "turtlesim"], 1),
        (["turtlesim", "lagged"], 1),
    ],
    ids=["none", "last", "first"],
)
def test_rows_of_another_plant_than_the_base_take_the_path_of_a_run(
    column: list[str], compiled: int
) -> None:
    rows = measure_rows(PAPER, {"plant.kind": column}, METRICS, threads=1)
    assert (rows.compiled, rows.interpreted) == (compiled, 2 - compiled)
    for row, kind in enumerate(column):
        require_row(rows, row, override_scenario(PAPER, {"plant.kind": kind}))


OWN: Final = """
import dataclasses
import math
from turtlelog.laws import SequentialP


def step(settings, state, row, pose):
    row.phase = min(state.samples // 200, 1)
    ahead_m, left_m = settings.goal.x_m - pose[0], settings.goal.y_m - pose[1]
    row.heading_error_rad = error = math.atan2(left_m, ahead_m) - pose[2]
    state.samples += 1
    angle = settings.law.kp_linear
    while state.samples > 100 and angle > 5.0:
        angle = math.sin(angle) + 7.0
    if state.samples > 500:
        row.stop = 1
    return 0.3, 2.0 * error


@dataclasses.dataclass(slots=True)
class State:
    samples: int = 0


P = dataclasses.replace(SequentialP, step=step, State=State)
"""


def test_no_batch_is_found_for_laws_that_it_does_not_take(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(OWN, "utf-8")
    own = override_scenario(PAPER, {"law.kind": f"{path}:P"})
    found = [batch.find_batch(one) for one in (PAPER, own, TRACKING, OPEN)]
    assert [one is not None for one in found] == [True, True, True, False]


@pytest.mark.thorough
def test_rows_of_a_law_of_the_users_own_are_compiled_and_watched(tmp_path: Path) -> None:
    """Its loop is compiled."""
    path = tmp_path / "own.py"
    path.write_text(OWN, "utf-8")
    own = override_scenario(PAPER, {"law.kind": f"{path}:P"}, trust_law=True)
    gains = [1.0, 2.0, 4.0]
    rows = measure_rows(own, {"law.kp_linear": gains}, METRICS, threads=2)
    assert (rows.compiled, rows.interpreted, rows.notes) == (3, 0, ())
    for row, gain in enumerate(gains):
        require_row(rows, row, override_scenario(own, {"law.kp_linear": gain}))
    columns = {"law.kp_linear": [1.0, 9.0]}
    rows = measure_rows(own, columns, ["run.duration"], threads=1, step_budget_s=0.1)
    assert (rows.compiled, rows.interpreted) == (0, 2)
    assert "runs plain: when compiled, one step took more than" in rows.notes[0]
    require_reason((rows.failed[1] or "").partition(" took")[0], "sample 100")


def test_columns_of_different_lengths_are_refused() -> None:
    with pytest.raises(SweepError, match="columns of one length"):
        measure_rows(PAPER, {"law.kp_linear": [1.0], "seed": [1, 2]}, METRICS)


def test_every_status_of_the_batch_is_met() -> None:
    cut = override_scenario(PAPER, {"max_duration_s": 3.0})
    there = override_scenario(PAPER, {"goal.y_m": 5.5444446, "goal.x_m": 9.0})
    met = set()
    for base in (PAPER, cut, there):
        rows = measure_rows(base, {"law.kp_linear": [1.0, 0.1]}, METRICS)
        met |= {STATUSES[code] for column in rows.statuses.values() for code in column}
    wanted = {Status.OK, Status.NOT_REACHED, Status.NO_STEP, Status.NO_PHASE, Status.TOO_SHORT}
    assert met == wanted | {Status.ABSENT}


def test_the_page_says_which_metrics_are_compiled() -> None:
    page = (Path(__file__).parents[2] / "docs" / "sweep.md").read_text("utf-8")
    told = page.partition("## How fast")[2].partition("##")[0]
    assert [name for name in (*CURVES, *COURSES) if f"`{name}`" not in told] == []


ROBOTS = {
    "dynamics": {
        "plant.turn_lag_s": [0.0, 0.1, 0.1, 0.6],
        "plant.speed_gain": [1.0, 0.9, 0.9, 0.9],
        "plant.period_s": [0.05, 0.05, 0.1, 0.1],
    },
    "limits": {
        "plant.turn_acceleration": [0.5, 2.0, 2.0, math.inf],
        "plant.turn_deadband": [0.0, 0.0, 0.05, 0.05],
        "plant.turn_reverse_gain": [0.5, 1.1, 0.9, 0.9],
        "plant.speed_bound": [0.4, 0.4, 1.0, 0.4],
    },
}


@pytest.mark.parametrize("numbers", ROBOTS)
def test_numbers_of_a_robot_vary_in_the_batch(numbers: str) -> None:
    base = override_scenario(get_preset("textbook"), {**EFFECTS["lagged"], "max_duration_s": 8.0})
    columns = ROBOTS[numbers]
    rows = measure_rows(base, columns, METRICS, threads=2)
    assert (rows.compiled, rows.interpreted) == (4, 0)
    for row in range(4):
        changes = {key: column[row] for key, column in columns.items()}
        require_row(rows, row, override_scenario(base, changes))


def test_rows_with_schedules_of_their_own_take_the_path_of_a_run() -> None:
    table = {"over": "distance", "at": [0.0, 1.0], "kp_linear": [1.0, 2.0]}
    columns = {"law.schedule": [table, {**table, "kp_linear": [1.0, 3.0]}]}
    rows = measure_rows(PAPER, columns, METRICS, threads=1)
    assert (rows.compiled, rows.interpreted) == (0, 2)
    for row, schedule in enumerate(columns["law.schedule"]):
        require_row(rows, row, override_scenario(PAPER, {"law.schedule": schedule}))
