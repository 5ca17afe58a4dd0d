import math
import re
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.laws.sequential_runs import build_run
from turtlelog.errors import LawError, SimulationError
from turtlelog.laws import find_law
from turtlelog.scenario import override_scenario

LAW_TEXT = """
from dataclasses import dataclass

from turtlelog.laws import Decision
from turtlelog.run.loops import Declaration


@dataclass(frozen=True)
class Nothing:
    pass


class Asks:
    Parameters = Nothing

    def __init__(self, parameters):
        self.calls = []

    @classmethod
    def declare(cls, parameters, goal, path):
        return Declaration(states=("limit_speed", "limit_turn", "calls"))

    def take_limits(self, speed_m_s, turn_rate_rad_s):
        self.calls.append("limits")
        self.limits = speed_m_s, turn_rate_rad_s

    def reset(self, start, goal, path):
        self.calls.append("reset")

    def step(self, time_ns, pose):
        assert self.calls == ["limits", "reset"]
        return Decision(speed_m_s=0.0, turn_rate_rad_s=0.0, states=(*self.limits, 1.0))
"""


def write_law(folder: Path, old: str = "", new: str = "") -> str:
    path = folder / "asks.py"
    path.write_text(LAW_TEXT.replace(old, new), encoding="utf-8")
    return f"{path}:Asks"


def build_scenario(kind: str, **limits: float) -> tl.Scenario:
    values = {"law.kind": kind, "max_duration_s": 0.1}
    values |= {f"limits.{key}": value for key, value in limits.items()}
    return override_scenario(tl.load_scenario("textbook"), values)


def test_law_is_told_the_limits_once_before_reset(tmp_path: Path) -> None:
    scenario = build_scenario(write_law(tmp_path), speed_m_s=0.25, turn_rate_rad_s=3.0)
    run = tl.simulate_run(scenario)
    assert run.stop_reason == "max_duration"
    assert run.samples.states is not None
    assert np.unique(run.samples.states, axis=0).tolist() == [[0.25, 3.0, 1.0]]
    replayed = tl.replay_law(run, scenario, trust_law=True)
    assert replayed.first_difference is None


def test_no_limit_is_inf(tmp_path: Path) -> None:
    kind = write_law(
        tmp_path, "(*self.limits, 1.0)", "tuple(x == float('inf') for x in (*self.limits, 0))"
    )
    run = tl.simulate_run(build_scenario(kind, speed_m_s=math.inf, turn_rate_rad_s=math.inf))
    assert run.samples.states is not None
    assert run.samples.states[0].tolist() == [1.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("new", "found"),
    [
        ("def take_limits(self, speed_m_s):", "expected (self, speed_m_s, turn_rate_rad_s)"),
        ("def take_limits(self, a, b, c):", "expected (self, speed_m_s, turn_rate_rad_s)"),
        ("take_limits = None\n    def other(self, a, b):", "expected a method, found None"),
    ],
)
def test_method_that_cannot_take_them_is_refused(tmp_path: Path, new: str, found: str) -> None:
    old = "def take_limits(self, speed_m_s, turn_rate_rad_s):"
    kind = write_law(tmp_path, old, new)
    with pytest.raises(LawError, match=re.escape(f"{kind}: take_limits: {found}")):
        find_law(kind)


def test_error_in_it_is_an_error_of_the_law(tmp_path: Path) -> None:
    kind = write_law(tmp_path, 'self.calls.append("limits")', "1 / 0")
    line = rf"\Alaw {re.escape(kind)}, sample 0: .*asks\.py, line 24: ZeroDivisionError: [^\n]+\Z"
    with pytest.raises(SimulationError, match=line):
        tl.simulate_run(build_scenario(kind))


@pytest.mark.parametrize("rule", ["clamping", "back-calculation"])
def test_replays_clip_as_the_run_did(rule: str, tmp_path: Path) -> None:
    scenario = build_run("paper-kp2", ki_angular=1.0, ki_linear=1.0, anti_windup=rule)
    run = tl.simulate_run(scenario)
    tl.write_recording(run, tmp_path / "run.mcap")
    again = tl.read_run(tmp_path / "run.mcap")
    assert tl.replay_law(again).first_difference is None
    wider = override_scenario(scenario, {"limits.speed_m_s": math.inf})
    assert tl.replay_law(again, wider).first_difference is not None
