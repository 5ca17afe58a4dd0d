"""Checks of a law that is like none of ours, and of ours by what only that one has."""

import dataclasses
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from tests.strange_law import StrangeLaw, StrangeParameters, simulate_strange
from turtlelog.check import CheckResult, Recording, check_runs, parse_spec
from turtlelog.check.failure_report import describe_failure
from turtlelog.check.formula_trace import find_window
from turtlelog.check.result import find_metric_violation
from turtlelog.check.spec_templates import build_schema, format_first_spec
from turtlelog.errors import CheckError, ExpressionError, UndecidedError
from turtlelog.laws.sequential_pid import SequentialPID, SequentialPIDParameters
from turtlelog.scenario import LawChoice, get_preset

RUN = simulate_strange()
PAPER = simulate()
METRICS = tl.measure_run(RUN)


def judge(run: tl.Run, **table: str) -> CheckResult:
    spec = parse_spec({"checks": {"it": table}})
    (result,) = check_runs(spec, [("a.mcap", run)])
    return result


def read_memory() -> np.ndarray:
    assert RUN.samples.states is not None
    return RUN.samples.states[:, 0]


@pytest.mark.parametrize(
    ("name", "unit"), [("a.rms_error", "deg"), ("b.settling_time", "s"), ("b.rms_error", "m")]
)
def test_metrics_of_its_loops_are_held_to_limits_in_their_units(name: str, unit: str) -> None:
    value = METRICS[name].value
    assert value is not None
    limits = (value * 1.01, value * 0.99)
    good, bad = (judge(RUN, expect=f"{name} <= {limit!r}") for limit in limits)
    assert (good.verdict, good.value, good.unit) == ("PASS", value, unit)
    assert (bad.verdict, bad.is_decided, bad.unit) == ("FAIL", True, unit)


def test_a_state_stands_in_formulas_over_time() -> None:
    largest = float(read_memory().max())
    good, bad = (
        judge(RUN, holds=f"always(memory <= {limit!r})") for limit in (largest, largest - 1)
    )
    assert (good.verdict, good.value, good.names) == ("PASS", largest, ("memory",))
    row = int((read_memory() > largest - 1).argmax())
    assert bad.first_violation_s == RUN.samples.time_ns[row] / 1e9
    lines = describe_failure(RUN, bad)
    assert any(re.search(r"t \[s\]\s+memory$", line) for line in lines)
    assert "  gains           law.gain_a = 4.0, law.gain_b = 1.0" in lines


def test_a_phase_is_looked_at_with_the_pause_after_it() -> None:
    one, pause, two = RUN.find_phase_spans()
    assert find_window(RUN, "one") == (one.start_ns, pause.end_ns - 1)
    assert find_window(RUN, "pause") == (pause.start_ns, pause.end_ns - 1)
    assert find_window(RUN, "two") == (two.start_ns, RUN.end_ns)
    holds = "always(phase == 'one' and speed == 0)"
    assert judge(RUN, holds=holds, phase="two").verdict == "FAIL"
    assert judge(RUN, holds="always(phase == 'one')", phase="one").verdict == "PASS"
    # The first sample of the next phase shares its time with the end of the pause.
    span_ns = (one.start_ns, pause.end_ns)
    assert not tl.check_formula(RUN, "always(phase == 'one')", window_ns=span_ns)


def test_the_windows_of_the_papers_law_are_as_ever() -> None:
    rotate, pause, translate = PAPER.find_phase_spans()
    assert find_window(PAPER, "rotate") == (rotate.start_ns, pause.end_ns - 1)
    assert find_window(PAPER, "pause") == (pause.start_ns, pause.end_ns - 1)
    assert find_window(PAPER, "translate") == (translate.start_ns, PAPER.end_ns)


UNDECIDED: Mapping[str, tuple[dict[str, str], str]] = {
    "loop": (
        {"expect": "rotate.overshoot <= 5"},
        "rotate.overshoot: no_phase (the run declares no loop rotate (it declares a, b))",
    ),
    "kind": (
        {"expect": "not a.overshoot > 5"},
        "a.overshoot: no_phase (a loop of heading with the reference recorded has no overshoot)",
    ),
    "when": (
        {"expect": "run.duration < 99", "when": "rotate.overshoot < 1"},
        "when: rotate.overshoot: no_phase (the run declares no loop rotate (it declares a, b))",
    ),
    "phase": (
        {"holds": "always(x < 99)", "phase": "rotate"},
        "no_phase (the law of this run has no phase rotate; it has one, two, pause)",
    ),
    "state": (
        {"holds": "not always(integral > 0)"},
        'unknown name "integral"; there are x, y, heading, speed, turn_rate, wanted_speed,'
        " wanted_turn_rate, shaped_speed, ... (the law of this run has memory)",
    ),
    "typo": (
        {"holds": "always(cros_track < 1)"},
        'unknown name "cros_track"; did you mean cross_track',
    ),
}


@pytest.mark.parametrize("case", UNDECIDED)
def test_what_only_other_laws_have_is_undecided_and_says_why(case: str) -> None:
    table, reason = UNDECIDED[case]
    result = judge(RUN, **table)
    assert (result.verdict, result.is_decided) == ("FAIL", False)
    assert reason in result.reason
    with pytest.raises(UndecidedError):
        bool(result)


def test_checks_beside_one_that_is_undecided_are_still_judged() -> None:
    checks = {"a": {"holds": "always(memory > -99)"}, "b": {"expect": "run.duration < 99"}}
    spec = parse_spec({"checks": checks})
    found = list(check_runs(spec, [("paper.mcap", PAPER), ("strange.mcap", RUN)]))
    assert [result.verdict for result in found] == ["FAIL", "PASS", "PASS", "PASS"]


def test_a_parameter_that_is_called_like_a_metric_is_the_parameter() -> None:
    run = dataclasses.replace(RUN, parameters={**RUN.parameters, "law.dead_time": 3.0})
    assert judge(run, expect="law.dead_time == 3").verdict == "PASS"


def test_a_misspelled_metric_of_any_loop_is_refused_with_the_nearest() -> None:
    with pytest.raises(ExpressionError, match=r'"a\.rms_eror"; did you mean a\.rms_error\?'):
        parse_spec({"checks": {"it": {"expect": "a.rms_eror < 1"}}})
    with pytest.raises(ExpressionError, match=r'unknown name "run\.rms_error"'):
        parse_spec({"checks": {"it": {"expect": "run.rms_error < 1"}}})


def test_what_is_awaited_and_what_grows_is_late_at_its_moment() -> None:
    two = RUN.find_phase_spans()[2]
    awaited = find_metric_violation(RUN, METRICS["b.settling_time"], "<=", 2.0)
    assert awaited == two.start_ns / 1e9 + 2.0
    value = METRICS["b.iae"].value
    assert value is not None
    grown = find_metric_violation(RUN, METRICS["b.iae"], "<=", value / 2)
    assert grown is not None
    assert two.start_ns / 1e9 < grown < RUN.end_ns / 1e9


def test_the_first_specification_is_of_all_its_loops_and_it_passes() -> None:
    text = format_first_spec(RUN, reference="good.mcap")
    checks = tomllib.loads(text)["checks"]
    of_loops = ["a.largest_error", "a.rms_error", "a.saturated_share"]
    of_loops += ["b.settling_time", "b.saturated_share"]
    assert list(checks)[: len(of_loops)] == of_loops
    assert not any(name.startswith(("rotate", "translate")) for name in checks)
    results = list(check_runs(parse_spec({"checks": checks}), [("a.mcap", RUN)]))
    assert {result.verdict for result in results} == {"PASS"}


def test_of_a_loop_that_no_formula_can_name_the_first_specification_says_so() -> None:
    loop, other = RUN.declaration.loops
    dashed = dataclasses.replace(loop, name="my-loop")
    declared = dataclasses.replace(
        RUN.declaration, loops=(dashed, other), phases={"one": ("my-loop",), "two": ("b",)}
    )
    text = format_first_spec(dataclasses.replace(RUN, declaration=declared), reference="good.mcap")
    assert "# my-loop.rms_error: no formula can name it: - stands for minus" in text
    assert '[checks."my-loop' not in text
    assert '[checks."b.settling_time"]' in text


def test_a_run_matches_a_reference_of_its_law_and_differs_from_one_of_another(
    tmp_path: Path,
) -> None:
    tl.write_recording(RUN, tmp_path / "a.mcap")
    recording = Recording(tmp_path / "a.mcap")
    same = recording.matches(RUN)
    assert same
    assert "signals.memory" in [result.check for result in same.results]
    failed = [result.check for result in recording.matches(PAPER).failures]
    assert {"signals.memory", "signals.phase"} <= {*failed}
    assert recording.matches({name: METRICS[name] for name in ("a.rms_error", "b.iae")})


def test_its_law_answers_the_recorded_poses_as_was_recorded(tmp_path: Path) -> None:
    tl.write_recording(RUN, tmp_path / "a.mcap")
    recording = Recording(tmp_path / "a.mcap", trust_law=True)
    outcome = recording.driven_by().matches(recording)
    assert outcome
    assert "law.memory" in [result.check for result in outcome.results]
    other: Any = StrangeLaw(StrangeParameters(gain_a=5.0))
    failures = recording.driven_by(other).matches(recording).failures
    assert "law.turn_rate" in [result.check for result in failures]


def test_a_driven_law_is_named_and_declares_by_the_parameters_it_was_made_with(
    tmp_path: Path,
) -> None:
    keys = {"law.kind": "sequential-pid", "law.reorient": True, "goal.heading_rad": 1.0}
    scenario = tl.override_scenario(get_preset("textbook"), keys)
    tl.write_recording(tl.simulate_run(scenario), tmp_path / "a.mcap")
    recording = Recording(tmp_path / "a.mcap")
    parameters = SequentialPIDParameters(reorient=True)
    driven = recording.driven_by(SequentialPID(parameters))
    assert driven.matches(recording)
    assert driven.replay().scenario.law == LawChoice(kind="sequential-pid", parameters=parameters)


@pytest.mark.parametrize(
    ("law", "found"),
    [
        (SequentialPID, "sequential-pid"),
        (StrangeLaw, "<class .*StrangeLaw'>"),
        ("my_law.py:MyLaw", "'my_law.py:MyLaw'"),
    ],
    ids=["part", "class", "name"],
)
def test_a_recording_is_driven_by_no_law_without_parameters(
    law: Any, found: str, tmp_path: Path
) -> None:
    tl.write_recording(RUN, tmp_path / "a.mcap")
    with pytest.raises(CheckError, match=f"driven_by: expected a law .*, found {found}$"):
        Recording(tmp_path / "a.mcap").driven_by(law)


def test_a_recording_offers_the_metrics_of_its_loops(tmp_path: Path) -> None:
    tl.write_recording(RUN, tmp_path / "a.mcap")
    recording = Recording(tmp_path / "a.mcap")
    assert recording.phase("a").rms_error < 10.0
    with pytest.raises(
        CheckError, match=r'phase: unknown name "rotate"; there are a, b, final, run\Z'
    ):
        recording.phase("rotate")
    with pytest.raises(
        CheckError, match=r'metric of a: unknown name "overshoot"; there are duration, .*'
    ):
        recording.phase("a").overshoot  # noqa: B018
    with pytest.raises(UndecidedError, match="declares no loop rotate"):
        bool(recording.metric("rotate.overshoot") < 5.0)
    assert recording.holds("always(memory > -99)", phase="one")
    with pytest.raises(UndecidedError, match="it has one, two, pause"):
        bool(recording.holds("x < 99", phase="rotate"))
    with pytest.raises(CheckError, match=r'phase: unknown name "onee"; did you mean one\?'):
        recording.holds("x < 99", phase="onee")


def find_schema(kind: str, name: str) -> bool:
    """Return whether an editor that reads the schema admits a name."""
    schema = build_schema()["properties"][kind]
    patterns = schema["patternProperties"]
    return name in schema["properties"] or any(re.search(found, name) for found in patterns)


@pytest.mark.parametrize("name", METRICS)
def test_the_schema_admits_the_metrics_of_any_loop(name: str) -> None:
    assert find_schema("metrics", name)


@pytest.mark.parametrize(
    "name", ["a.rms_eror", "run.rms_error", "pause.duration", ".duration", "a.b.duration"]
)
def test_the_schema_admits_no_other_metrics(name: str) -> None:
    assert not find_schema("metrics", name)


def test_the_schema_admits_states_phases_and_alignments_of_any_law() -> None:
    assert find_schema("signals", "memory")
    assert find_schema("signals", "cross_track")
    assert not find_schema("signals", "Memory")
    properties = build_schema()["properties"]
    phase = properties["checks"]["additionalProperties"]["properties"]["phase"]["pattern"]
    assert [bool(re.search(phase, name)) for name in ("one", "pause", "done", "donee")] == [
        *(True, True, False, True)
    ]
    alignment = properties["alignment"]["pattern"]
    good, bad = ("first_sample", "phase:one", "recorded", "sample"), ("phase:", "phase", "samples")
    assert all(re.search(alignment, text) for text in good)
    assert not any(re.search(alignment, text) for text in bad)
