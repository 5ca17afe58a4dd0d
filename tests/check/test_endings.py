"""What is said of the time after a recording's end is known only of a run that had come to its own.

Formulas on traces that were cut: a verdict that is given stands for every way in which the trace
may go on, and it is given wherever the three-valued definitions, word by word, decide.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from hypothesis import given, seed, settings, strategies as st

import turtlelog as tl
from tests.check.formulas import HALF_NS, Column, Definition, formulas, read_number, signals
from tests.check.recordings import simulate
from turtlelog.check import check_formula
from turtlelog.check.formula_trace import RunEnding, find_ending
from turtlelog.expressions import (
    Comparison,
    Logic,
    Node,
    Prefix,
    Temporal,
    Until,
    format_expression,
    parse_expression,
)
from turtlelog.log import ReadChoice, read_as_chosen
from turtlelog.run import Origin, slice_run

Truth = bool | None
Trace = dict[str, Column]

QUARTER_NS: Final = HALF_NS // 2
"""Odd moments stand for the time between the even ones, at which values and windows change."""


def judge_all(truths: Sequence[Truth]) -> Truth:
    return False if False in truths else None if None in truths else True


def judge_any(truths: Sequence[Truth]) -> Truth:
    return True if True in truths else None if None in truths else False


def deny(truth: Truth) -> Truth:
    return None if truth is None else not truth


class CutDefinition:
    """Whether a formula holds at a quarter second, or nobody can tell, by definition."""

    def __init__(self, trace: Trace, end: int, *, is_closed: bool) -> None:
        self.trace, self.end, self.is_closed = trace, end, is_closed
        self.found: dict[tuple[int, int], Truth] = {}

    def at(self, part: Node, time: int) -> Truth:
        if time > self.end:
            return None
        if (id(part), time) not in self.found:
            self.found[id(part), time] = self.compute(part, time)
        return self.found[id(part), time]

    def compute(self, part: Node, time: int) -> Truth:
        if isinstance(part, Comparison):
            sides = (read_number(side, self.trace, time // 2) for side in part.operands)
            return OPERATORS[part.operators[0]](*sides)
        if isinstance(part, Prefix):
            return deny(self.at(part.operand, time))
        if isinstance(part, Logic):
            truths = [self.at(side, time) for side in part.operands]
            if part.operator == "implies":
                truths[0] = deny(truths[0])
            return judge_all(truths) if part.operator == "and" else judge_any(truths)
        assert isinstance(part, Temporal | Until)
        return self.look_ahead(part, time)

    def look_ahead(self, part: Temporal | Until, time: int) -> Truth:
        first = time + int(part.start_s * 4)
        last = self.end + 1 if math.isinf(part.end_s) else time + int(part.end_s * 4)
        if math.isinf(part.end_s) and self.is_closed:
            if first > self.end:
                return None
            last = self.end
        moments = range(min(first, self.end + 1), min(last, self.end + 1) + 1)
        if isinstance(part, Temporal):
            truths = [self.at(part.operand, now) for now in moments]
            return judge_all(truths) if part.operator == "always" else judge_any(truths)
        held = {now: [self.at(part.left, at) for at in range(time, now + 1)] for now in moments}
        return judge_any([judge_all([self.at(part.right, now), *held[now]]) for now in moments])


OPERATORS: dict[str, Callable[[float, float], bool]] = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
}


def cut(trace: Mapping[str, Column], end_ns: int) -> Trace:
    return {
        name: (times[times <= end_ns], values[times <= end_ns])
        for name, (times, values) in trace.items()
    }


def join(trace: Trace, after: Mapping[str, Column], end_ns: int) -> Trace:
    """Let a trace go on as another one does from its end."""
    return {
        name: (
            np.append(times, after[name][0] + end_ns + 1),
            np.append(values, after[name][1]),
        )
        for name, (times, values) in trace.items()
    }


ends = st.integers(0, 40).map(lambda end: end * HALF_NS)


@pytest.mark.thorough
@pytest.mark.everyday("RunEnding.CUT")
@seed(3)
@settings(deadline=None, max_examples=150)
@given(formulas, signals, ends)
@pytest.mark.parametrize("ending", [RunEnding.CUT, RunEnding.LOST, RunEnding.UNDECLARED])
def test_a_verdict_on_a_cut_trace_is_that_of_the_definitions(
    ending: RunEnding, tree: Node, trace: Trace, end_ns: int
) -> None:
    """Hypothesis compares with the definitions, moment by moment."""
    expression, seen = parse_expression(format_expression(tree)), cut(trace, end_ns)
    found = check_formula(seen, expression, window_ns=(0, end_ns), ending=ending)
    is_closed = ending is RunEnding.UNDECLARED
    expected = CutDefinition(seen, end_ns // QUARTER_NS, is_closed=is_closed).at(tree, 0)
    assert found.holds is expected
    assert bool(found.reason) == (found.first_violation_s is None and found.holds is not True)


@pytest.mark.thorough
@seed(4)
@settings(deadline=None, max_examples=120)
@given(formulas, signals, ends, st.lists(signals, min_size=4, max_size=4))
def test_a_verdict_on_a_cut_trace_stands_however_it_goes_on(
    tree: Node, trace: Trace, end_ns: int, futures: list[Trace]
) -> None:
    """Each of Hypothesis' traces goes on in several ways."""
    expression, seen = parse_expression(format_expression(tree)), cut(trace, end_ns)
    found = check_formula(seen, expression, window_ns=(0, end_ns), ending=RunEnding.CUT)
    if found.holds is None:
        return
    whole = Definition(tree, trace, truth=True)(0) > 0
    going_on = [join(seen, future, end_ns) for future in futures]
    verdicts = [check_formula(later, expression, window_ns=(0, 10**11)) for later in going_on]
    assert {found.holds} == {whole, *(verdict.holds for verdict in verdicts)}
    for verdict in verdicts:
        # What follows may show that it was violated earlier than is sure now.
        assert (verdict.first_violation_s or 0.0) <= (found.first_violation_s or 0.0)


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("always(x < 9)", None),
        ("always(x < 3.5)", False),
        ("eventually(x > 3.5)", True),
        ("eventually(x > 9)", None),
        ("not always(x < 9)", None),
        ("not always(x < 3.5)", True),
        ("not eventually(x > 9)", None),
        ("always[0, 4](x < 9)", True),
        ("always[0, 4.5](x < 9)", None),
        ("eventually[0, 4](x > 9)", False),
        ("eventually[0, 4.5](x > 9)", None),
        ("x < 9 until x > 3.5", True),
        ("x < 9 until x > 9", None),
        ("x < 3.5 until x > 9", False),
        ("always(x < 9) or x == 0", True),
        ("always(x < 9) and x == 1", False),
        ("always(x < 9) and x == 0", None),
        ("x == 1 implies always(x < 9)", True),
        ("always(x > 3.5 implies eventually[0, 1](x < 3))", None),
        ("always[0, 3](x > 3.5 implies eventually[0, 1](x < 3))", True),
        ("eventually(always[0, 1](x > 1))", True),
        ("eventually(always[0, 1](x > 2))", None),
        ("eventually(always(x < 9))", None),
        ("always(limit > 3)", True),
    ],
)
def test_what_is_decided_on_a_trace_that_was_cut(text: str, holds: Truth) -> None:
    x = np.arange(5) * 10**9, np.array([0.0, 3.0, 1.0, 4.0, 2.0])
    found = check_formula({"x": x, "limit": 3.5}, parse_expression(text), ending=RunEnding.CUT)
    assert found.holds is holds
    if holds is None:
        reason = "the recording ends before the formula's window does, and the run had not ended"
        assert found.reason.removesuffix(ADVICE) == reason
        is_open = any(word in text for word in ("always(", "eventually(", "until "))
        assert found.reason.endswith(ADVICE) is is_open
        assert (found.margin, found.first_violation_s) == (None, None)


ADVICE = "; a window with an end, such as [0, 4], asks of what it holds"


def test_the_advice_is_a_window_that_can_be_judged() -> None:
    run = slice_run(simulate(), end_ns=4_999_999_999)
    undecided = tl.check.check_run(run, parse_expression("always(distance < 9)"))
    window = undecided.reason.partition("such as ")[2].partition(", asks")[0]
    assert window == f"[0, {(run.end_ns - run.start_ns) / 1e9:g}]"
    assert tl.check.check_run(run, parse_expression(f"always{window}(distance < 9)")).holds is True


STRONG, WEAK = "always(abs(cross_track) <= 0.05)", "always[0, 100](abs(cross_track) <= 0.05)"


def check(run: tl.Run, text: str) -> Truth:
    return tl.check.check_run(run, parse_expression(text)).holds


def test_a_run_that_came_to_its_end_stays_there() -> None:
    assert find_ending(simulate()) is RunEnding.SETTLED
    assert (check(simulate(), STRONG), check(simulate(), WEAK)) == (True, True)


def test_a_cut_run_decides_nothing_about_what_follows() -> None:
    run = simulate()
    cuts = [
        simulate("paper-kp4", max_duration_s=3.0),
        slice_run(run, end_ns=3 * 10**9),
        dataclasses.replace(run, stop_reason="interrupted"),
        dataclasses.replace(run, stop_reason=None),
    ]
    for found in cuts:
        assert find_ending(found) is RunEnding.CUT
        assert (check(found, STRONG), check(found, WEAK)) == (None, None)
        assert check(found, "eventually(phase == 'rotate')") is True
        assert check(found, "always(turn_rate < 0.5)") is False


@pytest.mark.parametrize("note", ["partial", "recovered"])
def test_a_recording_that_lost_something_decides_nothing_about_it(note: str) -> None:
    notes, origin = {note: "9 bytes are lost in 1 place"}, Origin(lost="rows")
    lossy = dataclasses.replace(simulate(), notes=notes, origin=origin)
    assert find_ending(lossy) is RunEnding.LOST
    found = tl.check.check_run(lossy, parse_expression(STRONG))
    assert (found.holds, found.is_covered) == (None, False)
    assert "does, and part of it is lost; a window with an end" in found.reason


def test_a_recording_of_which_the_summary_alone_is_lost_is_whole(tmp_path: Path) -> None:
    tl.write_recording(simulate(), tmp_path / "whole.mcap")
    cut, recovered = tmp_path / "cut.mcap", tmp_path / "recovered.mcap"
    cut.write_bytes((tmp_path / "whole.mcap").read_bytes()[:-2000])
    tl.recover_recording(cut, recovered)
    runs = [read_as_chosen(path, ReadChoice(allow_partial=True)) for path in (cut, recovered)]
    assert [*map(set, (run.notes for run in runs))] == [{"partial"}, {"recovered"}]
    for run in runs:
        assert find_ending(run) is RunEnding.SETTLED
        assert check(run, STRONG) is True
        notes = {name: f"{text}; 3 samples are dropped" for name, text in run.notes.items()}
        rows = dataclasses.replace(run, notes=notes, origin=Origin(lost="rows"))
        assert (run.origin.lost, find_ending(rows)) == ("summary", RunEnding.LOST)


def test_a_bag_of_another_recorder_is_judged_on_what_it_holds() -> None:
    run = simulate()
    none = slice_run(run, end_ns=-1).samples
    absent = ("samples", "stop_reason")
    bag = dataclasses.replace(run, samples=none, stop_reason=None, absent=absent)
    assert find_ending(bag) is RunEnding.UNDECLARED
    assert check(bag, "always(y <= 11)") is True
    assert check(bag, "always[0, 100](y <= 11)") is None
    assert check(bag, "always[0, 2](y <= 11)") is True
    assert check(bag, "always[50, inf](y <= 11)") is None
    assert check(bag, "eventually(y > 11)") is False
    log = dataclasses.replace(run, stop_reason=None, absent=("stop_reason",))
    assert find_ending(log) is RunEnding.CUT  # its controller would have said that it had finished


def test_a_phase_that_another_one_follows_has_come_to_its_end() -> None:
    spans = simulate("paper-kp4", max_duration_s=8.0).find_phase_spans()
    run = simulate("paper-kp4", max_duration_s=8.0)
    formula = parse_expression("always(abs(turn_rate) <= 1)")
    windows = {span.phase: (span.start_ns, span.end_ns) for span in spans}
    assert tl.check.check_run(run, formula, window_ns=windows["rotate"]).holds is True
    assert tl.check.check_run(run, formula, window_ns=windows["translate"]).holds is None
