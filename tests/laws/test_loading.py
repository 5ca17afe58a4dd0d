import re
import sys
from pathlib import Path
from typing import Any

import pytest

from turtlelog.errors import LawError
from turtlelog.expressions import parse_expression
from turtlelog.expressions.parser import KEYWORDS
from turtlelog.laws import (
    LAWS,
    Goal,
    Pose,
    SequentialP,
    SequentialPID,
    declare_law,
    find_law,
    name_law,
)
from turtlelog.run.loops import ControlLoop, Declaration

LAW_TEXT = """
from dataclasses import dataclass


@dataclass(frozen=True)
class Gains:
    gain: float = 1.0


class Steady:
    Parameters = Gains

    def __init__(self, parameters):
        self.parameters = parameters

    def reset(self, start, goal, path):
        pass

    def step(self, time_ns, pose):
        pass
"""


PROTOCOL = "docs/own-law.md describes what a law is"


def write_law(folder: Path, text: str = LAW_TEXT, name: str = "steady.py") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def match_whole(text: str) -> str:
    return rf"\A{re.escape(text)}\Z"


def test_built_in_law_is_found_by_its_kind() -> None:
    assert find_law("sequential-p") is SequentialP
    assert find_law("sequential-pid") is SequentialPID
    kinds = ["sequential-p", "sequential-pid", "posture", "pure-pursuit", "kanayama", "open-loop"]
    assert list(LAWS) == kinds


def test_law_of_a_module_is_found() -> None:
    assert find_law("turtlelog.laws.sequential_p:SequentialP") is SequentialP


def test_law_of_a_package_on_the_path_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "course_laws").mkdir()
    write_law(tmp_path / "course_laws")
    monkeypatch.syspath_prepend(tmp_path)
    assert find_law("course_laws.steady:Steady").Parameters().gain == 1.0


def test_law_of_a_file_is_found(tmp_path: Path) -> None:
    law = find_law(f"{write_law(tmp_path)}:Steady")
    assert name_law(law) == "Steady"
    assert law.Parameters(gain=2.0).gain == 2.0


def test_law_of_a_file_with_postponed_annotations_is_found(tmp_path: Path) -> None:
    path = write_law(tmp_path, "from __future__ import annotations\n" + LAW_TEXT)
    assert name_law(find_law(f"{path}:Steady")) == "Steady"


def test_files_of_one_name_in_two_folders_are_two_laws(tmp_path: Path) -> None:
    paths = []
    for gain in ("1.0", "9.0"):
        (tmp_path / gain).mkdir()
        paths.append(write_law(tmp_path / gain, LAW_TEXT.replace("1.0", gain)))
    laws = [find_law(f"{path}:Steady") for path in paths]
    assert [law.Parameters().gain for law in laws] == [1.0, 9.0]


def test_edited_law_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A cached bytecode file of the same second and size would hide the edit.
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    kind = f"{write_law(tmp_path)}:Steady"
    find_law(kind)
    write_law(tmp_path, LAW_TEXT.replace("1.0", "9.0"))
    assert find_law(kind).Parameters().gain == 9.0


@pytest.mark.parametrize("kind", ["nosuch", "", ":", "steady.py", "steady.py:", ":Steady"])
def test_kind_of_another_form_is_refused(kind: str) -> None:
    place = "turtlelog list laws. A law of your own is path.py:Class or package.module:Class"
    line = f'no law "{kind}"; list: {place}'
    with pytest.raises(LawError, match=match_whole(line)):
        find_law(kind)


def test_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "nowhere.py"
    with pytest.raises(LawError, match=match_whole(f"no Python file {path}")):
        find_law(f"{path}:Steady")


def test_missing_module_is_named() -> None:
    line = "no_such_package.laws cannot be loaded: ModuleNotFoundError: No module named"
    with pytest.raises(LawError, match=rf"\A{line} 'no_such_package'\Z"):
        find_law("no_such_package.laws:Steady")


def test_missing_class_is_named(tmp_path: Path) -> None:
    path = write_law(tmp_path)
    line = f"{path} has no class Wobbly"
    with pytest.raises(LawError, match=match_whole(line)):
        find_law(f"{path}:Wobbly")


def test_syntax_error_is_told_with_its_line(tmp_path: Path) -> None:
    path = write_law(tmp_path, "x = 1\nclass Steady(:\n")
    line = re.escape(f"{path} cannot be loaded: SyntaxError: ")
    with pytest.raises(LawError, match=rf"\A{line}.*\(steady\.py, line 2\)\Z"):
        find_law(f"{path}:Steady")


@pytest.mark.parametrize(
    "text",
    ["1 / 0", "raise ValueError('two\\nlines')", "raise SystemExit(1)"],
    ids=["error", "error-of-two-lines", "exit"],
)
def test_file_that_fails_is_told_in_one_line(tmp_path: Path, text: str) -> None:
    path = write_law(tmp_path, text)
    with pytest.raises(LawError, match=rf"\A{re.escape(f'{path} cannot be loaded: ')}[^\n]+\Z"):
        find_law(f"{path}:Steady")


def test_class_without_a_step_is_refused(tmp_path: Path) -> None:
    path = write_law(tmp_path, LAW_TEXT.replace("def step(", "def other("))
    line = f"{path}:Steady: a law needs a method step(self, time_ns, pose): {PROTOCOL}"
    with pytest.raises(LawError, match=match_whole(line)):
        find_law(f"{path}:Steady")


def test_class_without_a_reset_is_a_law(tmp_path: Path) -> None:
    path = write_law(tmp_path, LAW_TEXT.replace("def reset(", "def other("))
    law = find_law(f"{path}:Steady")
    assert (name_law(law), law.Parameters().gain) == ("Steady", 1.0)
    law(law.Parameters()).reset(Pose(0.0, 0.0, 0.0), None, None)


def test_class_without_parameters_is_a_law(tmp_path: Path) -> None:
    text = LAW_TEXT.replace("    Parameters =", "    other =")
    path = write_law(tmp_path, text.replace("(self, parameters)", "(self, parameters=None)"))
    law: Any = find_law(f"{path}:Steady")
    assert law(law.Parameters()).parameters is None


def test_function_is_a_law(tmp_path: Path) -> None:
    path = write_law(tmp_path, "def steer(time_ns, pose, goal):\n    return goal.x_m, 0.5\n")
    kind: Any = find_law(f"{path}:steer")
    law = kind(kind.Parameters())
    law.reset(Pose(0.0, 0.0, 0.0), Goal(2.0, 1.0), None)
    assert (name_law(kind), law.step(0, Pose(0.0, 0.0, 0.0))) == ("steer", (2.0, 0.5))


def test_function_of_other_arguments_is_no_law() -> None:
    with pytest.raises(LawError) as caught:
        find_law("json:dumps")
    assert str(caught.value).startswith("json:dumps: expected (time_ns, pose, goal), found (obj, ")
    assert str(caught.value).endswith(f": {PROTOCOL}")


def test_instance_is_no_law(tmp_path: Path) -> None:
    path = write_law(tmp_path, LAW_TEXT + "\nsteady = Steady(Gains())\n")
    expected = "a class, a function or a LawPart"
    line = f"{path}:steady: expected {expected}, found an instance of Steady"
    with pytest.raises(LawError, match=rf"\A{re.escape(line)}\Z"):
        find_law(f"{path}:steady")


@pytest.mark.parametrize(
    "parameters",
    ["int", "Gains()", "dataclass(type('Loose', (), {}))"],
    ids=["no-dataclass", "instance", "not-frozen"],
)
def test_parameters_are_a_frozen_dataclass(tmp_path: Path, parameters: str) -> None:
    text = LAW_TEXT.replace("Parameters = Gains", f"Parameters = {parameters}")
    path = write_law(tmp_path, text)
    line = f"{path}:Steady: expected Parameters to be a frozen dataclass"
    with pytest.raises(LawError, match=rf"\A{re.escape(line)}[^\n]*\Z"):
        find_law(f"{path}:Steady")


@pytest.mark.parametrize("phases", ['{"one": (), "two": ()}', '{"three": ()}'])
def test_law_that_declares_something_else_each_time_is_refused(tmp_path: Path, phases: str) -> None:
    declare = f"""
    asked = []

    @classmethod
    def declare(cls, parameters, goal, path):
        from turtlelog.run.loops import Declaration

        cls.asked.append(goal)
        one_way = {{"two": (), "one": ()}}
        return Declaration(phases={phases} if len(cls.asked) % 2 else one_way)
"""
    law = find_law(f"{write_law(tmp_path, LAW_TEXT + declare)}:Steady")
    expected = "the same Declaration for the same parameters"
    with pytest.raises(LawError, match=f"Steady.declare: must return {expected}"):
        declare_law(law, law.Parameters(), None)


def declare_names(tmp_path: Path, loop: str, state: str) -> Declaration:
    declare = f"""
    @classmethod
    def declare(cls, parameters, goal, path):
        from turtlelog.run.loops import ControlLoop, Declaration

        loop = ControlLoop(
            name="{loop}", signal="heading", command="turn_rate", reference="goal_bearing"
        )
        return Declaration(loops=(loop,), phases={{"one": ("{loop}",)}}, states=("{state}",))
"""
    law = find_law(f"{write_law(tmp_path, LAW_TEXT + declare)}:Steady")
    return declare_law(law, law.Parameters(), None)


@pytest.mark.parametrize("state", sorted(KEYWORDS))
def test_state_that_is_a_word_of_formulas_is_refused(tmp_path: Path, state: str) -> None:
    line = f"Steady.declare: state: expected a name that is no word of formulas, found {state!r}"
    with pytest.raises(LawError, match=rf"\A{re.escape(line)}\Z"):
        declare_names(tmp_path, "turn", state)


def test_loop_whose_name_formulas_read_as_minus_is_refused(tmp_path: Path) -> None:
    line = "Steady.declare: loop: expected a name of letters, digits and _, as - is minus in"
    with pytest.raises(LawError, match=rf"\A{re.escape(line)} formulas, found 'my-loop'\Z"):
        declare_names(tmp_path, "my-loop", "memory")


@pytest.mark.parametrize(
    ("loop", "state"), [("my_loop", "memory"), ("and_", "abs"), ("not", "nots")]
)
def test_every_other_name_is_one_that_formulas_read(tmp_path: Path, loop: str, state: str) -> None:
    declared = declare_names(tmp_path, loop, state)
    names = (f"{declared.loops[0].name}.overshoot", declared.states[0])
    assert parse_expression(f"{names[0]} < {names[1]}").names == names


def test_recorded_declaration_may_have_names_that_are_refused_of_laws() -> None:
    loop = ControlLoop(
        name="my-loop", signal="heading", command="turn_rate", reference="goal_bearing"
    )
    declared = Declaration(loops=(loop,), phases={"one": ("my-loop",)}, states=("not",))
    assert declared.states == ("not",)
