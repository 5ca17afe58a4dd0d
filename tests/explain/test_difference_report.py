"""What the sentences on two runs name, on both sides of each border."""

from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.explain import (
    Change,
    Depth,
    ExplainedDifference,
    Resolution,
    ResolutionReason,
    Side,
    explain_difference,
)
from turtlelog.explain.answers import SEED, Together
from turtlelog.run import PoseColumns, Run
from turtlelog.scenario import get_preset

BRIEF = Depth(shows_effects=False, shows_starts=False)


def make(
    *sizes: float, resolution: float = 0.001, error: float | None = None
) -> ExplainedDifference:
    """Return a difference from 1 m that these contributions make, of changes called a, b, ..."""
    changes = [
        Change(name=name, keys=(f"law.{name}",), contribution=size, standard_error=error)
        for name, size in zip("abcdef", sizes, strict=False)
    ]
    return ExplainedDifference(
        metric="final.position_error",
        unit="m",
        first=Side(name="one", as_logged=1.0, resimulated=1.0, basis="recorded"),
        second=Side(
            name="two", as_logged=1.0 + sum(sizes), resimulated=1.0 + sum(sizes), basis="recorded"
        ),
        difference=sum(sizes),
        contributions=tuple(changes),
        resolution=Resolution(size=resolution, reason=ResolutionReason.COUNT),
    )


def test_three_changes_are_all_named() -> None:
    head = make(1.0, -0.2, 0.01).sentences[0]
    assert head == (
        "final.position_error rose from 1.000 m to 1.810 m: the a adds 1.000 m, the b takes 0.200 m"
        " away and the c adds 0.010 m."
    )


@pytest.mark.parametrize(
    ("size", "told"), [(0.4998, "from 1.000 m by 0.2 mm"), (0.499, "from 1.000 m to 0.999 m")]
)
def test_values_that_print_alike_are_told_by_their_difference(size: float, told: str) -> None:
    assert make(-0.5, size).sentences[0].startswith(f"final.position_error fell {told}: ")


@pytest.mark.parametrize(("part", "is_named"), [(0.0009, False), (0.0011, True)])
def test_of_few_changes_those_that_change_no_digit_are_not_named(
    part: float, *, is_named: bool
) -> None:
    found = make(1.0, -0.2, 1.2 * part / (1.0 - part))
    assert ("the c adds" in found.sentences[0]) is is_named
    assert "other" not in found.sentences[0]
    assert len(found.contributions) == 3


def test_a_notebook_shows_the_answer_and_the_contributions() -> None:
    shown = make(1.0, -0.2)._repr_html_()
    assert "<strong>final.position_error rose from 1.000 m to 1.800 m: the a adds" in shown
    assert ">contribution [m]</th>" in shown
    assert shown.count("<tr>") == 3
    assert "nobody&lt;b&gt;" in replace(make(1.0), metric="nobody<b>")._repr_html_()


@pytest.mark.parametrize(("part", "is_named"), [(0.099, False), (0.101, True)])
def test_of_many_changes_those_above_a_tenth_are_named(part: float, *, is_named: bool) -> None:
    size = 2.0 * part / (1.0 - part)
    head = make(1.0, size, 0.5, 0.3, 0.1, 0.1).sentences[0]
    assert ("the b adds" in head) is is_named
    assert "other changes together add" in head


def test_one_change_is_no_rest() -> None:
    assert "the d adds 0.010 m" in make(1.0, 0.5, 0.4, 0.01).sentences[0]


@pytest.mark.parametrize(("resolution", "is_told"), [(0.99, True), (1.01, False)])
def test_a_change_is_a_reason_above_the_resolution(resolution: float, *, is_told: bool) -> None:
    head = make(1.0, -0.5, resolution=resolution).sentences[0]
    assert ("the a adds" in head) is is_told
    assert ("no change adds more than the resolution" in head) is not is_told


def test_changes_that_cancel_are_told() -> None:
    assert make(1.0, -1.0).sentences[0] == (
        "final.position_error is 1.000 m in both runs: the a adds 1.000 m, the b takes 1.000 m"
        " away."
    )


@pytest.mark.parametrize(("value", "is_told"), [(0.14, False), (0.16, True)])
def test_what_arises_together_is_told_above_a_tenth(value: float, *, is_told: bool) -> None:
    found = replace(make(1.0, 0.5), together=(Together(causes=("a", "b"), value=value),))
    told = "The a and the b act together: "
    assert any(one.startswith(told) for one in found.sentences) is is_told


@pytest.mark.parametrize(("error", "is_chance"), [(0.16, False), (0.17, True)])
def test_what_may_be_chance_is_said(error: float, *, is_chance: bool) -> None:
    assert any("May be chance" in one for one in make(0.5, error=error).sentences) is is_chance


def test_the_seeds_are_told_apart_from_the_means() -> None:
    found = make(0.5, 0.25)
    seed = replace(found.contributions[1], name=SEED)
    found = replace(found, contributions=(found.contributions[0], seed), seeds=32)
    assert found.sentences[0].endswith(
        "in the mean over 32 seeds the a adds 0.500 m; the seeds of these runs add 0.250 m."
    )


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("pause", (34, 33), "the shorter pause"),
        ("pause", (33, 34), "the longer pause"),
        ("pause", (0, 34), "the pause"),
        ("pause", (34, 0), "the missing pause"),
        ("law", ("one", "two"), "the law itself"),
        ("law.kp_linear", (1.0, 2.0), "law.kp_linear"),
        ("gains", (1.0, 2.0), "the gains"),
    ],
)
def test_changes_have_names(name: str, values: tuple[object, object], words: str) -> None:
    change = Change(name=name, keys=("a.b",), first=values[:1], second=values[1:])
    assert tl.explain.name_change(change) == words


def move_end(run: Run, by_m: float) -> Run:
    """Return a run with one more pose, further from the goal, beyond its last sample."""
    poses = run.poses
    assert run.goal_xy_m is not None
    away = poses.xy_m[-1] - run.goal_xy_m
    last = poses.xy_m[-1] + by_m * away / np.hypot(*away)
    longer = PoseColumns(
        time_ns=np.append(poses.time_ns, poses.time_ns[-1] + 16_000_000),
        xy_m=np.vstack([poses.xy_m, last]),
        heading_rad=np.append(poses.heading_rad, poses.heading_rad[-1]),
    )
    return replace(run, poses=longer)


@pytest.mark.parametrize(("part", "is_divided"), [(0.098, True), (0.102, False)])
def test_a_log_that_its_scenario_does_not_give_is_not_divided(
    part: float, *, is_divided: bool
) -> None:
    first, second = (tl.simulate_run(get_preset(f"paper-kp{kp}")) for kp in (2, 10))
    known = explain_difference(first, second, depth=BRIEF).difference
    assert known is not None
    found = explain_difference(first, move_end(second, part * known), depth=BRIEF)
    assert bool(found.contributions) is is_divided
    assert any(text.startswith("Simulated again it is") for text in found.sentences)
