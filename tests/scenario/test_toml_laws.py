import math
import re
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

PLACES = "path.py:Class or package.module:Class"

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
    line = 'run.toml: law.kind: no law "nosuch"; list: turtlelog list laws. A law of your own is'
    with pytest.raises(ScenarioError, match=match_whole(f"{line} {PLACES}")):
        parse_scenario("law.kind = 'nosuch'", source="run.toml")


def test_law_of_a_missing_file_is_named() -> None:
    line = "run.toml: law.kind: no Python file nowhere.py"
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
        ({"gain": 1, "gian": 1}, "law.gian: unknown key; did you mean gain?"),
        ({"gain": 1, "kp_linear": 1}, "law.kp_linear: unknown key; there are gain or bias"),
        ({"gain": math.nan}, "law.gain: expected a finite number, found nan"),
    ],
)
def test_wrong_parameter_of_a_law_of_a_file_is_named(
    law_kind: str, law: dict[str, Any], line: str
) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"run.toml: {line}")):
        resolve(law_kind, **law)


def test_missing_parameter_of_a_law_of_a_file_is_named(law_kind: str) -> None:
    with pytest.raises(
        ScenarioError, match=r"\Arun\.toml: law\.gain: expected .*, found no value\Z"
    ):
        resolve(law_kind)


PARAMETERS_TEXT = """
import enum
import sys
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Part:
    side: float
    turns: int = 1


@dataclass(frozen=True, kw_only=True)
class Odd:
    BODY


class Steady:
    Parameters = Odd
    reset = lambda self, start, goal, path: None
    step = lambda self, time_ns, pose: None
"""


def write_parameters(folder: Path, body: str) -> str:
    path = folder / "odd.py"
    path.write_text(PARAMETERS_TEXT.replace("BODY", body), encoding="utf-8")
    return f"{path}:Steady"


@pytest.mark.parametrize(
    ("body", "law", "line"),
    [
        ("x: tuple[float, ...] = ()", {"x": [1, "a"]}, "law.x[1]: expected float, found str"),
        ("x: tuple[float, float] = (1, 2)", {"x": [1]}, "law.x: expected a list of 2, found [1]"),
        (
            "x: dict[str, float] = field(default_factory=dict)",
            {"x": {"a": "b"}},
            "law.x[...]: expected float, found str",
        ),
        (
            "x: Part | None = None",
            {"x": {"turns": 2}},
            "law.x.side: expected a number, found no value",
        ),
        ("x: 'Nowhere' = None", {}, "law: NameError: name 'Nowhere' is not defined"),
        ("x: complex = 1j", {}, "law.x: expected a number, .*, found 1j"),
        ("x: Any = (1, {2})", {}, "law.x: expected a number, .*, found \\{2\\}"),
        ("x: Any = enum.Enum('E', 'a').a", {}, "law.x: expected a number, .*"),
        ("x: float = 'far'", {}, "law.x: expected a number, found 'far'"),
        ("x: float = float('nan')", {}, "law.x: expected a finite number, found nan"),
        ("x: float = 1.0", {"x": math.inf}, "law.x: expected a finite number, found inf"),
        ("__post_init__ = lambda self: 1 / 0", {}, "law: .*odd.py, line 16: ZeroDivisionError: .*"),
        ("__post_init__ = lambda self: sys.exit(4)", {}, "law: .*, line 16: SystemExit: 4"),
        ("__post_init__ = lambda self: int('a')", {}, "law: ValueError: invalid literal .*"),
        ("kind: str = 'x'", {}, "law.kind: .*: expected another name of a parameter than kind.*"),
    ],
)
def test_parameters_that_no_file_can_hold_are_refused_in_one_line(
    tmp_path: Path, body: str, law: dict[str, Any], line: str
) -> None:
    pattern = line if ".*" in line else re.escape(line)
    with pytest.raises(ScenarioError, match=rf"\Arun\.toml: {pattern}\Z"):
        resolve(write_parameters(tmp_path, body), **law)


@pytest.mark.parametrize(
    "body",
    [
        "x: float = float('inf')",
        "x: float = __import__('numpy').float64(2.0)",
        "x: tuple[Part, ...] = (Part(1.0),)",
        "x: float | None = None",
    ],
)
def test_parameters_of_any_kind_that_a_file_can_hold_round_trip(tmp_path: Path, body: str) -> None:
    values = {"law.kind": write_parameters(tmp_path, body)}
    scenario = resolve_scenario(override_scenario(get_preset("textbook"), values))
    again = resolve_scenario(parse_scenario(format_scenario(scenario)), trust_law=True)
    assert again.law.parameters == scenario.law.parameters


def test_what_parameters_print_goes_to_stderr(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    resolve(write_parameters(tmp_path, "__post_init__ = lambda self: print('made')"))
    out, err = capsys.readouterr()
    assert out == ""
    assert "made" in err
