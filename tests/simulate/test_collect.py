import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.known import known
from tests.sequential import TRANSLATE
from turtlelog.errors import SimulationError
from turtlelog.plants.turtlesim import TICK_NS, WORLD_SIZE_M
from turtlelog.run import Run
from turtlelog.scenario import (
    PRESETS,
    Scenario,
    build_scenario,
    flatten_scenario,
    get_preset,
    override_scenario,
)
from turtlelog.simulate import collect_run, iterate_ticks, simulate_run

LAW_TEXT = """
from dataclasses import dataclass

from turtlelog.laws import Decision


@dataclass(frozen=True)
class Gains:
    fails_at: int = 2


class Failing:
    Parameters = Gains

    def __init__(self, parameters):
        self.parameters = parameters
        self.samples = 0

    def reset(self, start, goal, path):
        pass

    def step(self, time_ns, pose):
        self.samples += 1
        values = dict(speed_m_s=0.5, turn_rate_rad_s=0.0, bearing_rad=0.0,
                      heading_error_rad=0.0, error_x_m=0.0, error_y_m=0.0)
        if self.samples > self.parameters.fails_at:
            FAILURE
        return Decision(**values)
"""

COUNTING_TEXT = """
from dataclasses import dataclass

from turtlelog.laws import Decision
from turtlelog.run.loops import Declaration


@dataclass(frozen=True)
class Nothing:
    pass


class Counting:
    Parameters = Nothing

    @classmethod
    def declare(cls, parameters, goal, path):
        return Declaration(states=("count",))

    def __init__(self, parameters):
        self.states = [0.0]

    def reset(self, start, goal, path):
        self.states[0] = 0.0

    def step(self, time_ns, pose):
        self.states[0] += 1.0
        return Decision(speed_m_s=0.0, turn_rate_rad_s=0.0, states=self.states)
"""


def make_scenario(folder: Path, failure: str = "pass") -> Scenario:
    path = folder / "failing.py"
    path.write_text(LAW_TEXT.replace("FAILURE", failure), encoding="utf-8")
    values = {"law.kind": f"{path}:Failing", "max_duration_s": 0.1}
    return override_scenario(get_preset("textbook"), values)


def list_arrays(run: Run) -> dict[str, Any]:
    tables: dict[str, Any] = {"poses": run.poses, "commands": run.commands, "samples": run.samples}
    return {
        f"{table}.{column.name}": getattr(columns, column.name)
        for table, columns in tables.items()
        for column in dataclasses.fields(columns)
        if getattr(columns, column.name) is not None
    }


@pytest.mark.parametrize("name", PRESETS)
def test_two_simulations_of_one_scenario_are_equal(name: str) -> None:
    first, second = simulate_run(get_preset(name)), simulate_run(get_preset(name))
    other = list_arrays(second)
    assert all(
        values.tobytes() == other[key].tobytes() for key, values in list_arrays(first).items()
    )
    assert first.events == second.events


def test_run_says_where_it_comes_from() -> None:
    scenario = override_scenario(get_preset("paper"), {"goal.heading_rad": 1.0})
    run = simulate_run(scenario)
    assert (run.name, run.source, run.scenario_is_complete) == ("paper", "simulation", True)
    assert (run.goal_xy_m, run.goal_heading_rad) == ((2.0, 10.0), 1.0)
    assert run.parameters == flatten_scenario(scenario)
    assert (run.absent, run.notes) == ((), {})


def test_collected_ticks_are_the_simulated_run() -> None:
    scenario = get_preset("paper-kp4")
    collected = list_arrays(collect_run(scenario, iterate_ticks(scenario)))
    simulated = list_arrays(simulate_run(scenario))
    assert all((values == simulated[key]).all() for key, values in collected.items())


@pytest.mark.parametrize(
    ("max_duration_s", "ticks"), [(1.0, 62), (0.016, 1), (0.0159, 0), (4.64, 290), (68.704, 4294)]
)
def test_run_is_cut_at_its_longest_duration(max_duration_s: float, ticks: int) -> None:
    values = {"max_duration_s": max_duration_s, "law.kp_angular": 0.001}
    run = simulate_run(override_scenario(get_preset("textbook"), values))
    assert run.end_ns == ticks * TICK_NS
    assert (run.stop_reason, run.is_complete) == ("max_duration", False)
    assert run.events[-1].text == "The run ended: max duration."


def test_cut_in_the_pause_leaves_one_sample_unpublished() -> None:
    run = simulate_run(override_scenario(get_preset("paper-kp10"), {"max_duration_s": 2.8}))
    assert len(run.samples) == len(run.commands) + 1
    assert run.stop_reason == "max_duration"


def test_run_that_ends_before_an_answer_is_refused() -> None:
    values = {"max_duration_s": 0.1, "loop.start_backlog": 100}
    line = r"\Apaper: no pose is answered within max_duration_s = 0\.1[^\n]*\Z"
    with pytest.raises(SimulationError, match=line):
        simulate_run(override_scenario(get_preset("paper"), values))


def test_law_of_a_file_drives_the_turtle(tmp_path: Path) -> None:
    run = simulate_run(make_scenario(tmp_path))
    assert run.samples.speed_m_s.tolist() == [0.5] * 7
    assert run.poses.xy_m[-1, 0] == pytest.approx(run.poses.xy_m[0, 0] + 6 * 0.5 * 0.016)


@pytest.mark.parametrize(
    ("failure", "found"),
    [
        ("raise ValueError('no gain')", "ValueError: no gain"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
    ],
)
def test_law_that_fails_is_named_with_its_sample_and_its_line(
    tmp_path: Path, failure: str, found: str
) -> None:
    scenario = make_scenario(tmp_path, failure)
    place = f"{tmp_path / 'failing.py'}, line 27"
    line = re.escape(f"law {scenario.law.kind}, sample 2: {place}: {found}")
    with pytest.raises(SimulationError, match=rf"\A{line}\Z"):
        simulate_run(scenario)


def test_law_that_answers_no_decision_is_named(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=r"sample 2: expected a Decision, .*, found None"):
        simulate_run(make_scenario(tmp_path, "return None"))


@pytest.mark.parametrize("failure", ["1 / 0", "values['speed_m_s'] = float('nan')"])
def test_what_came_before_a_failure_is_kept_with_the_reason(tmp_path: Path, failure: str) -> None:
    with pytest.raises(SimulationError) as caught:
        simulate_run(make_scenario(tmp_path, failure))
    run = caught.value.run
    assert isinstance(run, Run)
    assert (len(run.samples), len(run.poses)) == (2, 3)
    assert (run.stop_reason, run.is_complete) == ("law_failed", False)
    assert run.events[-1].text == f"The run ended: law failed: {caught.value}."


def test_what_a_law_prints_goes_to_stderr(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulate_run(make_scenario(tmp_path, "print('hello')"))
    assert capsys.readouterr() == ("", "hello\n" * 5)


@pytest.mark.parametrize(
    "failure",
    [
        "values['speed_m_s'] = float('nan')",
        "values['turn_rate_rad_s'] = float('inf')",
        "values['speed_m_s'] = None",
        "values['heading_error_rad'] = float('nan')",
        "values['error_x_m'] = 'far'",
        "values['states'] = (1.0,)",
        "values['reference'] = 3",
        "values['world_v_x_m_s'] = 'fast'",
        "values['phase'] = 7",
        "values['phase'] = []",
        "values['blocks_ticks'] = 'long'",
        "values['blocks_ticks'] = 1.5",
        "values['blocks_ticks'] = 2**31",
        "values['stop_reason'] = ''",
        "values['stop_reason'] = 'two\\nlines'",
        "values['stop_reason'] = 'a\\udc80'",
        "values['speed_m_s'] = __import__('numpy').array([0.5])",
        "values['speed_m_s'] = 10**400",
        "values['speed_m_s'] = '0.5'",
        "values['states'] = 1.0",
        "values |= dict(error_x_m=1.3e308, error_y_m=-1.3e308)",
        "raise BaseException('strange')",
        "raise GeneratorExit",
        "raise type('Mute', (Exception,), {'__str__': lambda self: 1 / 0})",
        "raise ValueError('two\\nlines')",
        "raise ValueError",
    ],
)
def test_law_that_answers_nonsense_is_named_in_one_line(tmp_path: Path, failure: str) -> None:
    scenario = make_scenario(tmp_path, failure)
    line = re.escape(f"law {scenario.law.kind}, sample 2: ")
    with pytest.raises(SimulationError, match=rf"\A{line}[^\n]*[^\s:]\Z"):
        simulate_run(scenario)


@pytest.mark.parametrize(
    "number",
    [
        "__import__('decimal').Decimal('0.5')",
        "__import__('fractions').Fraction(1, 2)",
        "__import__('numpy').float32(0.5)",
        "__import__('numpy').array(0.5)",
    ],
)
def test_a_command_is_a_number_of_any_kind(tmp_path: Path, number: str) -> None:
    as_float = "values |= dict(speed_m_s=0.5, turn_rate_rad_s=0.1)"
    plain = simulate_run(make_scenario(tmp_path, as_float))
    run = simulate_run(make_scenario(tmp_path, f"{as_float}; values['speed_m_s'] = {number}"))
    for name, values in list_arrays(plain).items():
        assert list_arrays(run)[name].tobytes() == values.tobytes(), name


def test_states_that_the_law_goes_on_changing_are_kept_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "counting.py"
    path.write_text(COUNTING_TEXT, encoding="utf-8")
    values = {"law.kind": f"{path}:Counting", "max_duration_s": 0.1, "loop.start_backlog": 4}
    run = simulate_run(override_scenario(get_preset("textbook"), values))
    assert run.samples.time_ns[3] == run.samples.time_ns[0]  # the backlog is answered at once
    assert run.samples.states is not None
    assert run.samples.states[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]


def test_law_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path)
    path = tmp_path / "failing.py"
    path.write_text(LAW_TEXT.replace("self.samples = 0", "1 / 0"), encoding="utf-8")
    with pytest.raises(SimulationError, match=re.escape(f"law {scenario.law.kind}")):
        simulate_run(scenario)


coordinate = st.floats(0.0, WORLD_SIZE_M)
gain = st.floats(0.05, 50.0)
limit = st.one_of(st.floats(0.05, 5.0), st.just(math.inf))
scenario_tables = st.fixed_dictionaries(
    {
        "max_duration_s": st.floats(2.0, 12.0),
        "start": st.fixed_dictionaries(
            {"x_m": coordinate, "y_m": coordinate, "heading_rad": st.floats(-6.2, 6.2)}
        ),
        "goal": st.fixed_dictionaries({"x_m": coordinate, "y_m": coordinate}),
        "law": st.fixed_dictionaries(
            {
                "kp_angular": gain,
                "kp_linear": gain,
                "projection": st.sampled_from(["bearing", "heading"]),
                "wrap_error": st.booleans(),
                "pause_ticks": st.integers(0, 80),
            }
        ),
        "limits": st.fixed_dictionaries({"speed_m_s": limit, "turn_rate_rad_s": limit}),
        "loop": st.fixed_dictionaries(
            {
                "period_ticks": st.integers(1, 5),
                "start_backlog": st.integers(1, 12),
                "pose_queue": st.integers(1, 12),
                "command_queue": st.integers(1, 8),
                "queue_policy": st.sampled_from(["one-per-tick", "newest"]),
                "transport_delay_ticks": st.integers(0, 6),
                "pose_precision": st.sampled_from(["float32", "float64"]),
            }
        ),
    }
)
simulations = scenario_tables.map(build_scenario).map(
    lambda scenario: (scenario, simulate_run(scenario))
)
simulate_some = settings(deadline=None, max_examples=40)


@simulate_some
@given(simulations)
def test_every_simulation_has_one_pose_per_tick(simulation: tuple[Scenario, Run]) -> None:
    scenario, run = simulation
    assert run.poses.time_ns.tolist() == [TICK_NS * tick for tick in range(len(run.poses))]
    assert run.end_ns == run.poses.time_ns[-1] <= round(scenario.max_duration_s * 1e9)


@simulate_some
@given(simulations)
def test_every_simulation_keeps_its_limits(simulation: tuple[Scenario, Run]) -> None:
    scenario, run = simulation
    for columns in (run.samples, run.commands):
        assert np.abs(columns.speed_m_s).max(initial=0.0) <= scenario.limits.speed_m_s
        assert np.abs(columns.turn_rate_rad_s).max(initial=0.0) <= scenario.limits.turn_rate_rad_s


@simulate_some
@given(simulations)
def test_every_pose_lies_in_the_world(simulation: tuple[Scenario, Run]) -> None:
    poses = simulation[1].poses
    assert ((poses.xy_m >= 0.0) & (poses.xy_m <= WORLD_SIZE_M)).all()
    assert (np.abs(poses.heading_rad) <= np.float32(math.pi)).all()


@simulate_some
@given(simulations)
def test_position_stays_put_while_rotating(simulation: tuple[Scenario, Run]) -> None:
    _, run = simulation
    translating = np.flatnonzero(run.samples.phase == TRANSLATE)
    until_ns = run.samples.time_ns[translating[0]] if len(translating) else run.end_ns
    xy_m = run.poses.xy_m[run.poses.time_ns <= until_ns]
    assert (xy_m == xy_m[0]).all()


@simulate_some
@given(simulations)
def test_every_sample_is_published_unless_the_run_is_cut(
    simulation: tuple[Scenario, Run],
) -> None:
    _, run = simulation
    published = len(run.commands)
    assert published == len(run.samples) if run.is_complete else published <= len(run.samples)
    assert len(run.samples) - published <= 1
    assert (run.commands.speed_m_s == run.samples.speed_m_s[:published]).all()
    assert (run.commands.turn_rate_rad_s == run.samples.turn_rate_rad_s[:published]).all()
    assert (run.commands.time_ns >= run.samples.time_ns[:published]).all()


@simulate_some
@given(simulations)
def test_samples_answer_poses_of_the_past_in_order(simulation: tuple[Scenario, Run]) -> None:
    scenario, run = simulation
    samples = run.samples
    assert (np.diff(samples.pose_sequence) > 0).all()
    assert (run.poses.time_ns[samples.pose_sequence] <= samples.time_ns).all()
    assert (samples.pose_sequence % scenario.loop.period_ticks == 0).all()
    assert samples.sequence.tolist() == list(range(len(samples)))


@simulate_some
@given(simulations)
def test_samples_hold_what_their_pose_says(simulation: tuple[Scenario, Run]) -> None:
    scenario, run = simulation
    goal_m = np.array([scenario.goal.x_m, scenario.goal.y_m])
    error_m = goal_m - run.poses.xy_m[run.samples.pose_sequence]
    assert (known(run.samples.error_xy_m) == error_m).all()
    assert known(run.samples.distance_m) == pytest.approx(np.hypot(*error_m.T))
    assert set(known(run.samples.bearing_rad)) == {math.atan2(error_m[0, 1], error_m[0, 0])}


@simulate_some
@given(simulations)
def test_every_simulation_can_be_repeated(simulation: tuple[Scenario, Run]) -> None:
    scenario, run = simulation
    again = list_arrays(simulate_run(scenario))
    assert all(values.tobytes() == again[key].tobytes() for key, values in list_arrays(run).items())
