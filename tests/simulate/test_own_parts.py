"""Laws of a user's own that are parts: compiled, and plain where numba does not take them.

The first takes 10 s, once: its loop is compiled.
"""

from pathlib import Path
from typing import Final

import numpy as np
import pytest

from tests.simulate.run_values import list_values
from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import ManyRuns, many, simulate_many, simulate_run
from turtlelog.simulate.many import describe_difference

EXAMPLE: Final = Path(__file__).parents[2] / "examples" / "laws" / "compiled_p.py"
ANSWER: Final = "    return speed, settings.law.kp * error_rad\n"
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
    found, runs, scenario = simulate_three(f"{EXAMPLE}:P")
    plain = list_values(simulate_run(scenario))
    assert [isinstance(run, Run) and list_values(run) == plain for run in runs] == [True] * 3
    assert (found.compiled, found.interpreted, found.notes) == (2, 1, [])


@pytest.mark.parametrize(
    ("answer", "found"),
    [
        ("{1: error_rad}[1]", "return speed"),
        ("clip(settings.law.kp * error_rad)", "def clip"),
    ],
    ids=["dict", "default"],
)
def test_a_law_that_numba_does_not_take_runs_plain_with_a_note_of_the_line(
    tmp_path: Path, answer: str, found: str
) -> None:
    kind = write_law(tmp_path, f"    return speed, {answer}\n")
    lines = (tmp_path / "law.py").read_text("utf-8").splitlines()
    (line,) = [number for number, text in enumerate(lines, 1) if text.strip().startswith(found)]
    many_runs, runs, _ = simulate_three(kind)
    assert [type(run) for run in runs] == [Run] * 3
    assert (many_runs.compiled, many_runs.interpreted) == (0, 3)
    (note,) = many_runs.notes
    assert note.startswith(f"law {kind} runs plain: {tmp_path / 'law.py'}, line {line}: ")
    assert note.endswith("functions of turtlelog.arithmetic and of its own file")


def test_a_law_that_numba_refuses_without_a_line_runs_plain_with_its_reason(tmp_path: Path) -> None:
    kind = write_law(tmp_path, "    return speed, [settings.law.kp * error_rad][0]\n")
    many_runs, runs, _ = simulate_three(kind)
    assert [type(run) for run in runs] == [Run] * 3
    (note,) = many_runs.notes
    assert note.startswith(f"law {kind} runs plain: ")
    assert note.endswith("functions of turtlelog.arithmetic and of its own file")


def test_a_first_run_that_differs_when_compiled_is_told_with_by_how_much() -> None:
    base = override_scenario(get_preset("textbook"), {"max_duration_s": 1.0})
    plain, other, longer = (
        simulate_run(override_scenario(base, {key: value}))
        for key, value in (("seed", 0), ("law.kp_angular", 1.25), ("max_duration_s", 2.0))
    )
    one, two = (np.asarray(run.samples.wanted_turn_rate_rad_s, float) for run in (plain, other))
    assert [*describe_difference("own", plain, plain)] == []
    assert [*describe_difference("own", plain, other)] == [
        "law own: commands of its first run differ by up to 0 m/s and"
        f" {np.abs(one - two).max():.4g} rad/s when compiled"
    ]
    assert [*describe_difference("own", plain, longer)] == [
        "law own: its first run has 126 samples instead of 63 when compiled"
    ]
