"""Laws that are objects of a notebook: simulated, swept in processes, recorded as text."""

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

import turtlelog as tl
from turtlelog.laws import (
    LAWS,
    find_law,
    is_given,
    list_sample_counters,
    list_unused_keys,
    name_given_law,
)
from turtlelog.laws.sequential_p import PART

SHORT = {"max_duration_s": 2.0}


def make_steering(gain: float) -> Callable[..., Any]:
    def steer(time_ns: int, pose: tl.Pose, goal: tl.Goal) -> tuple[float, float]:
        """Head for the goal."""
        del time_ns
        bearing = math.atan2(goal.y_m - pose.y_m, goal.x_m - pose.x_m)
        return 0.5, gain * math.remainder(bearing - pose.heading_rad, math.tau)

    return steer


@dataclass(frozen=True)
class Gain:
    gain: float = 3.0


class ByClass:
    Parameters: ClassVar[type[Any]] = Gain

    def __init__(self, parameters: Gain) -> None:
        self._steer = make_steering(parameters.gain)

    def reset(self, start: tl.Pose, goal: tl.Goal | None, path: Any) -> None:
        del start, path
        self._goal = goal

    def step(self, time_ns: int, pose: tl.Pose) -> Any:
        return self._steer(time_ns, pose, self._goal)


class Counting:
    """Has no parameters, and remembers how often it was asked."""

    def __init__(self) -> None:
        self.asked = 0

    def step(self, time_ns: int, pose: tl.Pose) -> tuple[float, float]:
        del time_ns, pose
        self.asked += 1
        return 0.01 * self.asked, 0.0


def make_local_class() -> type[Any]:
    class Local(ByClass):
        pass

    return Local


def test_class_object_and_function_drive_alike() -> None:
    laws = (make_steering(3.0), ByClass, make_local_class(), ByClass(Gain()))
    runs = [tl.simulate_run("textbook", law=law, changes=SHORT) for law in laws]
    assert [run.poses.xy_m.tolist() for run in runs] == [runs[0].poses.xy_m.tolist()] * 4
    assert [is_given(run.parameters["law.kind"]) for run in runs] == [True, False, True, True]


def test_an_object_is_not_changed_by_the_runs_that_it_drives() -> None:
    law = Counting()
    first, second = (tl.simulate_run("textbook", law=law, changes=SHORT) for _ in range(2))
    assert law.asked == 0
    assert first.equals(second)


def test_an_object_says_what_it_counts_and_leaves_unused() -> None:
    class Plain(Counting):
        counts_samples = ()

        @staticmethod
        def list_unused(parameters: object) -> tuple[str, ...]:
            del parameters
            return ("goal.heading_rad",)

    for given in (Plain, Plain()):
        law = find_law(name_given_law(given))
        assert list_sample_counters(law) == ()
        assert list_unused_keys(law, law.Parameters()) == ("goal.heading_rad",)


@pytest.mark.parametrize("kind", ["sequential-p", "posture"])
def test_a_built_in_law_with_its_parameters_drives_as_its_scenario_does(kind: str) -> None:
    gains = {"sequential-p": {"kp_linear": 2.5}, "posture": {"gamma": 0.5}}[kind]
    law: Any = LAWS[kind](LAWS[kind].Parameters(**gains))
    keys = {"law.kind": kind, **{f"law.{name}": value for name, value in gains.items()}}
    run = tl.simulate_run("textbook", law=law, changes=SHORT)
    assert run.equals(tl.simulate_run("textbook", changes={**keys, **SHORT}))


def test_an_object_that_inherits_from_a_built_in_law_declares_its_own_parameters() -> None:
    kind: Any = LAWS["sequential-p"]

    class Slower(kind):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(kind.Parameters(kp_linear=0.5))

    run, built_in = (
        tl.simulate_run("textbook", law=law, changes=SHORT)
        for law in (Slower(), kind(kind.Parameters(kp_linear=0.5)))
    )
    assert run.declaration == built_in.declaration
    assert run.commands.speed_m_s.tolist() == built_in.commands.speed_m_s.tolist()


def test_the_same_law_has_the_same_name_and_another_one_another() -> None:
    first, second = make_steering(1.0), make_steering(2.0)
    names = [name_given_law(law) for law in (first, second, first)]
    assert names[0] == names[2] != names[1]
    assert all(name.startswith("session:steer") for name in names)
    assert name_given_law(PART) == "sequential-p"


@pytest.mark.parametrize(
    ("law", "error", "match"),
    [
        (3, tl.errors.LawError, "law: expected a class, a function of .* found 3"),
        (SimpleNamespace(step=None), tl.errors.LawError, "or an object with step"),
        (dict, tl.errors.ScenarioError, "law: law.kind: builtins:dict: a law needs a method step"),
        (lambda pose: (0.0, 0.0), tl.errors.ScenarioError, r"expected \(time_ns, pose, goal\)"),
        ("nothing.py:Law", tl.errors.ScenarioError, "no Python file nothing.py"),
    ],
    ids=["number", "no step", "no law", "arguments", "no file"],
)
def test_what_is_no_law_is_refused_by_the_name_of_the_argument(
    law: Any, error: type[Exception], match: str
) -> None:
    with pytest.raises(error, match=match):
        tl.simulate_run("textbook", law=law)


def test_a_recording_has_the_source_as_text_that_nothing_runs(tmp_path: Path) -> None:
    run = tl.simulate_run("textbook", law=make_steering(3.0), changes=SHORT)
    tl.write_recording(run, tmp_path / "run.mcap")
    read = tl.read_run(tmp_path / "run.mcap")
    assert '"""Head for the goal."""' in read.notes["law_source"]
    assert read.equals(run)
    with pytest.raises(tl.errors.ScenarioError, match="expected a built-in law, or --trust-law"):
        tl.replay_law(read)
    assert tl.replay_law(read, law=ByClass(Gain())).first_difference is None


def test_another_process_does_not_run_it_even_where_it_is_trusted(tmp_path: Path) -> None:
    """Starts a Python of its own, which has another session: 2 s."""
    run = tl.simulate_run("textbook", law=make_steering(3.0), changes=SHORT)
    tl.write_recording(run, tmp_path / "run.mcap")
    code = "import sys, turtlelog as tl; tl.replay_law(tl.read_run(sys.argv[1]), trust_law=True)"
    words = [sys.executable, "-c", code, str(tmp_path / "run.mcap")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert "is a law of another Python session; write it to a file" in done.stderr


@pytest.mark.thorough
def test_processes_find_a_law_of_this_session(tmp_path: Path) -> None:
    """Simulates enough rows that each of two processes gets some: 5 s."""
    del tmp_path
    grid = {"goal.x_m": [1.0 + 0.25 * number for number in range(24)]}
    law, metrics = make_steering(3.0), ["final.position_error"]
    one, two = (
        tl.sweep_scenario("textbook", grid, law=law, metrics=metrics, jobs=jobs) for jobs in (1, 2)
    )
    assert one.failed == two.failed == 0
    assert one.to_arrow().equals(two.to_arrow())
