"""Laws of a user's own that are parts: compiled, and plain where numba does not take them."""

import subprocess
import sys
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from tests.simulate.run_values import list_values
from turtlelog.errors import LawError
from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import ManyRuns, many, simulate_many, simulate_run
from turtlelog.simulate.many import describe_compiled_difference

EXAMPLE: Final = Path(__file__).parents[2] / "examples" / "laws" / "compiled_p.py"
ANSWER: Final = "    return speed, settings.law.kp * error_rad\n"
SHORT: Final = """
import dataclasses

from turtlelog.laws import SequentialP

def step(settings, pose):
    while settings.law.kp_linear > 5.0:
        pass
    return 0.5, -0.2 * settings.law.kp_linear * pose[2]

def turn(time_ns, pose, goal):
    return 0.5, -0.2 * pose.heading_rad

P = dataclasses.replace(SequentialP, name="{name}", step=step)
"""
SIMULATE_SHORT: Final = """
import sys

from tests.simulate.run_values import list_values
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import many, simulate_many, simulate_run

many.find_saving = lambda _: 1.0
base = override_scenario(get_preset("textbook"), {"law.kind": sys.argv[1], "max_duration_s": 2.0})
scenarios = [override_scenario(base, {"law.kp_linear": gain}) for gain in (1.0, 2.0, 9.0, 3.0)]
runs = simulate_many(scenarios, threads=1, step_budget_s=0.3)
first, compiled, late, last = runs
print(list_values(compiled) == list_values(simulate_run(scenarios[1])))
print(late)
print(runs.compiled, runs.interpreted, last.stop_reason)
print(*runs.notes, sep="\\n")
"""
CLIP: Final = """
def clip(value: float, most: float = 9.0) -> float:
    return min(value, most)
"""


@pytest.fixture(autouse=True)
def saving(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a compiled loop save so much that the first run makes it worth compiling."""
    pytest.importorskip("numba")
    monkeypatch.setattr(many, "find_saving", lambda _: 1.0)


def write_law(folder: Path, answer: str) -> str:
    text = EXAMPLE.read_text("utf-8")
    changes = {ANSWER: answer, "compiled-p": folder.name, "ARRIVED = 1": f"{CLIP}\n\nARRIVED = 1"}
    for before, after in changes.items():
        assert text.count(before) >= 1
        text = text.replace(before, after, 1)
    (folder / "law.py").write_text(text, "utf-8")
    return f"{folder / 'law.py'}:P"


def simulate_three(kind: str) -> tuple[ManyRuns, list[object], Scenario]:
    scenario = override_scenario(get_preset("textbook"), {"law.kind": kind, "max_duration_s": 2.0})
    found = simulate_many([scenario] * 3, threads=1)
    return found, [*found], scenario


def test_a_law_of_ones_own_is_compiled_after_its_first_run() -> None:
    """Takes 10 s, once: its loop is compiled."""
    found, runs, scenario = simulate_three(f"{EXAMPLE}:P")
    plain = list_values(simulate_run(scenario))
    assert [isinstance(run, Run) and list_values(run) == plain for run in runs] == [True] * 3
    assert (found.compiled, found.interpreted, found.notes) == (2, 1, [])


@pytest.mark.everyday("default")
@pytest.mark.parametrize(
    ("answer", "found"),
    [
        ("{1: error_rad}[1]", "return speed"),
        ("[error_rad][0]", "return speed"),
        ("clip(settings.law.kp * error_rad)", "def clip"),
    ],
    ids=["dict", "list", "default"],
)
def test_a_law_that_numba_does_not_take_runs_plain_with_a_note_of_the_line(
    tmp_path: Path, answer: str, found: str
) -> None:
    """Takes 10 s: numba compiles the loop up to the line."""
    kind = write_law(tmp_path, f"    return speed, {answer}\n")
    lines = (tmp_path / "law.py").read_text("utf-8").splitlines()
    (line,) = [number for number, text in enumerate(lines, 1) if text.strip().startswith(found)]
    many_runs, runs, _ = simulate_three(kind)
    assert [type(run) for run in runs] == [Run] * 3
    assert (many_runs.compiled, many_runs.interpreted) == (0, 3)
    (note,) = many_runs.notes
    assert note.startswith(f"law {kind} runs plain: {tmp_path / 'law.py'}, line {line}: ")
    assert note.endswith("functions of turtlelog.arithmetic and of its own file")


def write_short(folder: Path) -> Path:
    path = folder / "short.py"
    path.write_text(SHORT.format(name=folder.name), "utf-8")
    return path


def test_a_part_that_returns_a_command_alone_records_what_such_a_function_does(
    tmp_path: Path,
) -> None:
    path = write_short(tmp_path)
    changes = {"max_duration_s": 2.0, "start.heading_rad": 1.0}
    part, function = (
        simulate_run(override_scenario(get_preset("textbook"), {"law.kind": kind, **changes}))
        for kind in (f"{path}:P", f"{path}:turn")
    )
    for name in ("bearing_rad", "heading_error_rad", "error_xy_m", "distance_m"):
        found = getattr(part.samples, name)
        assert found is not None
        assert found.tobytes() == getattr(function.samples, name).tobytes()


@pytest.mark.thorough
def test_a_step_that_never_returns_ends_its_row_also_when_compiled(tmp_path: Path) -> None:
    """Takes 15 s: a loop is compiled, in a process whose end ends the step as well."""
    kind = f"{write_short(tmp_path)}:P"
    command = [sys.executable, "-c", SIMULATE_SHORT, kind]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    is_equal, late, counts, note = done.stdout.splitlines()
    assert is_equal == "True"
    assert late.startswith(f"law {kind}, sample 0 took more than 1300 ms of a budget of 300 ms")
    assert counts == "1 3 max_duration"
    assert note == (
        f"law {kind} runs plain: when compiled, one step took more than 1300 ms of a budget of"
        " 300 ms"
    )


def test_a_step_that_asks_for_what_the_loop_has_not_is_told_what_there_is(tmp_path: Path) -> None:
    path = write_short(tmp_path)
    path.write_text(path.read_text("utf-8").replace("(settings, pose)", "(settings, place)"))
    with pytest.raises(LawError, match=r"short\.py, line 6: step: .*, pose, found place$"):
        simulate_run(override_scenario(get_preset("textbook"), {"law.kind": f"{path}:P"}))


def test_a_first_run_that_differs_when_compiled_is_told_with_by_how_much() -> None:
    base = override_scenario(get_preset("textbook"), {"max_duration_s": 1.0})
    plain, other, longer = (
        simulate_run(override_scenario(base, {key: value}))
        for key, value in (("seed", 0), ("law.kp_angular", 1.25), ("max_duration_s", 2.0))
    )
    one, two = (np.asarray(run.samples.wanted_turn_rate_rad_s, float) for run in (plain, other))
    assert [*describe_compiled_difference("own", plain, plain)] == []
    assert [*describe_compiled_difference("own", plain, other)] == [
        "law own: commands of its first run differ by up to 0 m/s and"
        f" {np.abs(one - two).max():.4g} rad/s when compiled"
    ]
    assert [*describe_compiled_difference("own", plain, longer)] == [
        "law own: its first run has 126 samples instead of 63 when compiled"
    ]
