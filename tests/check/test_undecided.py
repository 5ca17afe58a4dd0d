"""What nobody can tell is neither true nor false: neither it nor its negation passes."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from tests.effects_cases import build_case
from turtlelog.check import CheckResult, Recording, Verdict
from turtlelog.check.result import CheckOutcome, find_worst
from turtlelog.errors import UndecidedError
from turtlelog.run import slice_run


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A recording of a run that was cut in its translation."""
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    tl.write_recording(slice_run(simulate(), end_ns=5 * 10**9), path)
    tl.write_recording(simulate("paper-kp4", max_duration_s=1.0), path.with_name("short.mcap"))
    return Recording(path)


UNDECIDED: dict[str, tuple[Callable[[Recording], Any], str]] = {
    "not covered": (
        lambda cut: cut.holds("always[0, 100](abs(cross_track) <= 0.05)"),
        "the recording ends before the formula's window does, and the run had not ended",
    ),
    "open window": (
        lambda cut: cut.holds("always(abs(cross_track) <= 0.05)"),
        "the recording ends before the formula's window does, and the run had not ended",
    ),
    "denied": (
        lambda cut: cut.holds("not always(abs(cross_track) <= 0.05)"),
        "the recording ends before the formula's window does, and the run had not ended",
    ),
    "no value": (lambda cut: cut.holds("translate.overshoot < 9"), "the run was cut in this phase"),
    "largest so far": (
        lambda cut: cut.holds("translate.cross_track_max <= 0.05"),
        "the run was cut in this phase",
    ),
    "no value over time": (
        lambda cut: cut.holds("eventually(1 / (speed - speed) > 0)"),
        "a number has no value",
    ),
    "no phase": (
        lambda cut: Recording(cut.path.with_name("short.mcap")).holds("x < 9", phase="pause"),
        "the run has no phase pause",
    ),
    "metric of a reference": (
        lambda cut: cut.matches(tl.measure_run(simulate(), only=["translate.overshoot"])),
        "too_short (the run was cut in this phase), where the reference has ok",
    ),
}


TRUTHS: dict[str, Callable[[Any], object]] = {
    "bool": bool,
    "not": lambda found: not found,
    "and": lambda found: found and True,
    "or": lambda found: found or True,
    "any": lambda found: any([found, True]),
    "all": lambda found: all([found, False]),
    "true": lambda found: found == True,  # noqa: E712
    "not true": lambda found: found != True,  # noqa: E712
    "false": lambda found: found == False,  # noqa: E712
    "among": lambda found: found in [False],
    "if": lambda found: 1 if found else 0,
}


@pytest.mark.parametrize("truth", TRUTHS)
@pytest.mark.parametrize("asked", UNDECIDED)
def test_what_is_undecided_is_neither_true_nor_false(
    asked: str, truth: str, cut: Recording
) -> None:
    ask, reason = UNDECIDED[asked]
    found = ask(cut)
    with pytest.raises(UndecidedError) as raised:
        TRUTHS[truth](found)
    assert isinstance(raised.value, AssertionError)
    assert ": undecided: " in str(raised.value)
    assert reason in str(raised.value)
    assert repr(found).startswith("<UNDECIDED: ")


def test_what_is_decided_of_a_cut_run_is_true_or_false(cut: Recording) -> None:
    assert cut.holds("eventually(phase == 'translate')")
    assert not cut.holds("always(turn_rate < 0.5)")
    assert cut.holds("always(abs(turn_rate) <= 1)", phase="rotate")


def make_result(verdict: Verdict, *, is_decided: bool = True) -> CheckResult:
    return CheckResult(file="a", check="b", verdict=verdict, is_decided=is_decided, reason="c")


PASSED, FAILED = make_result(Verdict.PASS), make_result(Verdict.FAIL)
OPEN = make_result(Verdict.FAIL, is_decided=False)


def test_one_result_that_fails_decides_whatever_others_are_undecided() -> None:
    assert not CheckOutcome(results=(OPEN, FAILED))
    assert CheckOutcome(results=(OPEN, FAILED)).failures == (FAILED, OPEN)
    assert repr(CheckOutcome(results=(OPEN, FAILED))) == "<FAIL: c (and 1 more)>"
    with pytest.raises(UndecidedError, match=r"^a: undecided: c \(and 1 more\)$"):
        bool(CheckOutcome(results=(PASSED, OPEN, OPEN)))


def test_results_stand_for_their_verdicts() -> None:
    assert PASSED
    assert not FAILED
    for result in (OPEN, make_result(Verdict.SKIPPED)):
        with pytest.raises(UndecidedError, match=r"^a: b: undecided: c$"):
            bool(result)


@pytest.mark.parametrize(("margin", "worst"), [(0.3, "first"), (0.29, "second")])
def test_of_results_of_one_margin_the_first_is_the_worst(margin: float, worst: str) -> None:
    results = [
        CheckResult(file="a", check=check, verdict=Verdict.PASS, margin=spare, unit="m")
        for check, spare in (("first", 0.3), ("second", margin))
    ]
    assert [result.check for result in find_worst(results)] == [worst]


def test_what_fails_with_no_margin_is_worse_than_what_passes_with_none() -> None:
    verdicts = {"closed": Verdict.PASS, "open": Verdict.FAIL}
    results = [
        CheckResult(file="a", check=check, verdict=verdict, margin=0.0, unit="m")
        for check, verdict in verdicts.items()
    ]
    for order in (results, results[::-1]):
        assert [result.check for result in find_worst(order)] == ["open"]
    later = CheckResult(file="a", check="s", verdict=Verdict.PASS, margin=-0.0, unit="s")
    assert [result.check for result in find_worst([later, *results])] == ["open", "s"]


def test_findings_stand_for_what_they_found() -> None:
    run = simulate()
    assert tl.check.check_run(run, tl.expressions.parse_expression("always(speed <= 1)"))
    assert not tl.check.check_run(run, tl.expressions.parse_expression("always(speed <= 0.5)"))
    later = dataclasses.replace(run, stop_reason="interrupted")
    with pytest.raises(UndecidedError, match=r"^always\(speed <= 1\): undecided: the recording"):
        bool(tl.check.check_run(later, tl.expressions.parse_expression("always(speed <= 1)")))


def test_half_a_question_is_no_answer(cut: Recording) -> None:
    halves = [cut.driven_by(), cut.phase("rotate"), tl.check.join_verdicts([FAILED])]
    for half in halves:
        with pytest.raises(tl.errors.CheckError, match=r"assert|expected"):
            bool(half)


def test_a_reference_that_nothing_is_held_to_is_no_answer(cut: Recording) -> None:
    with pytest.raises(tl.errors.CheckError, match="names no signal or metric"):
        cut.matches(cut.run, tolerance=tl.Tolerances())


def test_what_is_undecided_is_not_said_to_be_violated(cut: Recording) -> None:
    undecided = cut.holds("always(abs(cross_track) <= 0.05)").failures
    violated = cut.holds("always(turn_rate < 0.5)").failures
    assert "first violated" not in "".join(cut.describe(*undecided))
    assert "first violated" in "".join(cut.describe(*violated))


def test_a_condition_that_nobody_can_tell_is_undecided() -> None:
    entry = {"expect": "run.duration > 0", "when": "1 / (law.kp_linear - 4) > 0"}
    (result,) = tl.check_runs(tl.parse_spec({"checks": {"it": entry}}), [("a", simulate())])
    assert (result.verdict, result.reason) == ("FAIL", "when: a number has no value")
    assert not result.is_decided


def test_a_signal_that_a_recording_lacks_is_undecided(tmp_path: Path) -> None:
    run = simulate()
    samples = dataclasses.replace(run.samples, wanted_speed_m_s=None)
    bare = dataclasses.replace(run, samples=samples)
    tl.write_recording(run, tmp_path / "whole.mcap")
    tolerances = tl.Tolerances(signals={"wanted_speed": tl.Tolerance(abs=1.0, reason="a")})
    found = Recording(tmp_path / "whole.mcap").matches(bare, tolerance=tolerances)
    with pytest.raises(UndecidedError, match="does not hold it"):
        bool(found)


def test_what_is_sensed_is_judged_where_it_was_and_undecided_where_it_was_not() -> None:
    noisy = tl.simulate_run(build_case("noise", "dropout", max_duration_s=1.0))
    # It turns where it stands, sensed with a noise of 0.01 m.
    away = "abs(sensed_x - 5.5444)"
    assert tl.check_formula(noisy, f"eventually({away} > 0.005)").holds is True
    assert tl.check_formula(noisy, f"always({away} < 0.005)").holds is False
    plain = tl.simulate_run(build_case(max_duration_s=1.0))
    assert tl.check_formula(plain, "eventually(sensed_x > 0)").holds is None
