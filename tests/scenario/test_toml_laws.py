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

    def reset(self, start, goal, path):
        pass

    def step(self, time_ns, pose):
        pass
"""


@pytest.fixture
def law_kind(tmp_path: Path) -> str:
    path = tmp_path / "steady.py"
    path.write_text(LAW_TEXT, encoding="utf-8")
    return f"{path}:Steady"


def resolve(kind: str, **law: Any) -> None:
    tables = {"law": {"kind": kind, **law}}
    resolve_scenario(build_scenario(tables, source="run.toml", trust_law=True))


def test_tables_name_no_law_unless_they_are_trusted(law_kind: str) -> None:
    tables = {"law": {"kind": law_kind, "gain": 3}}
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: law\.kind: .*--trust-law"):
        resolve_scenario(build_scenario(tables, source="run.toml"))
    trusted = resolve_scenario(build_scenario(tables), trust_law=True)
    assert trusted.law.parameters.gain == 3.0


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
    scenario = build_scenario({"law": {"kind": law_kind, "gain": 3}}, trust_law=True)
    scenario = resolve_scenario(scenario)
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
        resolve(law_kind, **law)


def test_missing_parameter_of_a_law_of_a_file_is_named(law_kind: str) -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: law\.gain: expected .*, found none\Z"):
        resolve(law_kind)
