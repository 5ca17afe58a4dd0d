import math
from pathlib import Path
from typing import Any

import pytest

from tests.scenario.lines import match_whole
from turtlelog.errors import ScenarioError
from turtlelog.scenario import (
    build_scenario,
    format_scenario,
    get_preset,
    override_scenario,
    parse_scenario,
    resolve_scenario,
)

LAW_TEXT = """
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Gains:
    gain: float
    bias: float = 0.0


class Steady:
    Parameters = Gains

    def __init__(self, parameters):
        self.parameters = parameters

    def reset(self, start, goal):
        pass

    def step(self, time_ns, pose):
        pass
"""


@pytest.fixture
def law_kind(tmp_path: Path) -> str:
    path = tmp_path / "steady.py"
    path.write_text(LAW_TEXT, encoding="utf-8")
    return f"{path}:Steady"


def test_law_of_a_file_round_trips(law_kind: str) -> None:
    values = {"law.kind": law_kind, "law.gain": 2.0}
    scenario = override_scenario(get_preset("textbook"), values)
    assert parse_scenario(format_scenario(scenario)) == scenario


def test_unknown_law_is_named() -> None:
    line = "run.toml: law.kind: expected sequential-p, path.py:Class or package.module:Class"
    with pytest.raises(ScenarioError, match=match_whole(f"{line}, found 'pid'")):
        parse_scenario("law.kind = 'pid'", source="run.toml")


def test_law_of_a_missing_file_is_named() -> None:
    line = "run.toml: law.kind: expected a Python file at nowhere.py, found none"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        resolve_scenario(parse_scenario("law.kind = 'nowhere.py:Law'", source="run.toml"))


def test_law_of_a_file_takes_its_own_parameters(law_kind: str) -> None:
    scenario = resolve_scenario(build_scenario({"law": {"kind": law_kind, "gain": 3}}))
    assert (scenario.law.parameters.gain, scenario.law.parameters.bias) == (3.0, 0.0)


@pytest.mark.parametrize(
    ("law", "line"),
    [
        ({"gain": "a"}, "law.gain: expected a number, found 'a'"),
        ({"gain": 1, "gian": 1}, "law.gian: expected gain, found an unknown key"),
        ({"gain": 1, "kp_linear": 1}, "law.kp_linear: expected gain or bias, found an unknown key"),
        ({"gain": math.nan}, "law.gain: expected a finite number, found nan"),
    ],
)
def test_wrong_parameter_of_a_law_of_a_file_is_named(
    law_kind: str, law: dict[str, Any], line: str
) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"run.toml: {line}")):
        resolve_scenario(build_scenario({"law": {"kind": law_kind, **law}}, source="run.toml"))


def test_missing_parameter_of_a_law_of_a_file_is_named(law_kind: str) -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: law\.gain: expected .*, found none\Z"):
        resolve_scenario(build_scenario({"law": {"kind": law_kind}}, source="run.toml"))
