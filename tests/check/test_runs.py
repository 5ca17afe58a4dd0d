import dataclasses
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from tests.compare.runs import make_run
from turtlelog.check import CheckResult, Verdict, check_runs, parse_spec


def judge(run: tl.Run | None = None, **entry: object) -> CheckResult:
    spec = parse_spec({"checks": {"it": entry}})
    (result,) = check_runs(spec, [("a.mcap", run or simulate())])
    return result


def hold_to(reference: Path, run: tl.Run, **tables: object) -> list[CheckResult]:
    spec = dataclasses.replace(parse_spec(tables), reference=reference)
    return list(check_runs(spec, [("a.mcap", run)]))


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("good") / "good.mcap"
    tl.write_recording(simulate(), path)
    return path


def test_a_bound_that_holds_passes_by_its_margin() -> None:
    result = judge(expect="rotate.overshoot <= 2")
    value = tl.measure_run(simulate())["rotate.overshoot"].value
    assert value is not None
    assert result == CheckResult(
        file="a.mcap",
        check="it",
        verdict=Verdict.PASS,
        expected="rotate.overshoot <= 2",
        value=value,
        limit=2.0,
        margin=2.0 - value,
        unit="%",
        names=("heading_error", "turn_rate"),
    )


@pytest.mark.parametrize("text", ["2 >= rotate.overshoot", "rotate.overshoot <= 2 and 1 < 3"])
def test_value_and_limit_are_found_on_either_side(text: str) -> None:
    result = judge(expect=text)
    assert result.limit == (2.0 if ">=" in text else 3.0 if result.unit == "" else 2.0)


def test_a_chain_reports_the_nearer_limit() -> None:
    result = judge(expect="-1 <= rotate.overshoot <= 0.1")
    assert (result.limit, result.verdict) == (0.1, "PASS")


def test_a_formula_over_time_tells_its_largest_value_and_first_violation() -> None:
    run = simulate("paper-kp10")
    result = judge(run, holds="always(abs(cross_track) <= 0.05)", phase="translate")
    largest = tl.measure_run(run)["translate.cross_track_max"].value
    assert result.verdict is Verdict.FAIL
    assert result.value == pytest.approx(largest)
    assert result.unit == "m"
    assert (
        result.first_violation_s
        == tl.check.check_run(
            run, tl.expressions.parse_expression("always(abs(cross_track) <= 0.05)")
        ).first_violation_s
    )


def test_a_phase_begins_after_the_first_sample_but_times_count_from_there() -> None:
    run = simulate("paper-kp10")
    result = judge(run, holds="always(speed < 0)", phase="translate")
    spans = run.find_phase_spans()
    assert result.first_violation_s == (spans[-1].start_ns - run.start_ns) / 1e9


def test_rotate_covers_its_pause_and_ends_before_the_next_phase() -> None:
    assert judge(holds="always(phase == 'rotate' and speed == 0)", phase="rotate").verdict == "PASS"
    assert judge(holds="eventually(phase == 'translate')", phase="rotate").verdict == "FAIL"
    assert judge(holds="always(speed == 0)", phase="pause").verdict == "PASS"


def test_a_formula_of_one_moment_passes_with_this_reason() -> None:
    said = "judged at 0.000 s alone; always(...) asks of every time"
    assert judge(holds="speed <= 0.5").reason == said
    assert judge(holds="always(speed <= 1)").reason == judge(holds="speed > 0.5").reason == ""


@pytest.mark.parametrize("text", ["rotate.decay_ratio < 9", "not rotate.decay_ratio < 9"])
@pytest.mark.parametrize("other", ["", " or run.duration > 0"])
def test_a_metric_without_a_value_fails_whatever_is_asked(text: str, other: str) -> None:
    result = judge(expect=text + other)
    assert result.verdict is Verdict.FAIL
    assert result.reason.startswith("rotate.decay_ratio: not_reached (the response does not")


def test_a_condition_that_does_not_apply_skips_and_says_why() -> None:
    result = judge(expect="rotate.overshoot < 0", when="law.kp_linear < 2")
    assert result.verdict is Verdict.SKIPPED
    assert result.reason == "only when law.kp_linear < 2; here law.kp_linear = 4.0"


def test_a_condition_that_nobody_can_tell_fails() -> None:
    run = dataclasses.replace(simulate(), parameters={})
    result = judge(run, expect="run.duration > 0", when="law.kp_linear >= 2")
    assert result.verdict is Verdict.FAIL
    assert result.reason == "when: law.kp_linear: the recording does not hold it"


def test_a_phase_that_the_run_does_not_have_fails() -> None:
    run = simulate("textbook", start__heading_rad=2.242)
    rows = dataclasses.replace(run.samples, phase=run.samples.phase * 0 + 2)
    run = dataclasses.replace(run, samples=rows)
    result = judge(run, holds="always(speed <= 1)", phase="rotate")
    assert (result.verdict, result.reason) == ("FAIL", "no_phase (the run has no phase rotate)")


@pytest.mark.parametrize("count", [5, 6])
def test_a_phase_that_takes_no_time_does_not_show_the_values_of_the_next(count: int) -> None:
    run = simulate("paper-kp4")
    assert run.samples.time_ns[4] == run.samples.time_ns[5] < run.samples.time_ns[6]
    phase = np.where(np.arange(len(run.samples)) < count, 0, 2).astype(run.samples.phase.dtype)
    run = dataclasses.replace(run, samples=dataclasses.replace(run.samples, phase=phase))
    result = judge(run, holds="always(phase == 'rotate')", phase="rotate")
    said = "no_phase (the phase rotate takes 0 s: the next phase begins at its time)"
    expected = ("FAIL", False, said) if count == 5 else ("PASS", True, "")
    assert (result.verdict, result.is_decided, result.reason) == expected


def test_a_run_that_was_cut_does_not_pass_what_it_does_not_reach() -> None:
    cut = simulate("paper-kp4", max_duration_s=3.0)
    assert judge(cut, holds="always[0, 9](speed <= 1)").reason.startswith("the recording ends")
    assert judge(cut, holds="always[0, 2](speed <= 1)").verdict == "PASS"
    assert judge(holds="always[0, 99](speed <= 1)").verdict == "PASS"


def test_a_parameter_that_the_law_does_not_have_is_undecided() -> None:
    result = judge(expect="law.kp_linar > 1")
    assert (result.verdict, result.is_decided) == ("FAIL", False)
    assert 'unknown name "law.kp_linar"; did you mean law.kp_linear' in result.reason


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("four", "expected two of a kind"),
        ([4.0], "expected one value, found a list"),
        (None, "the recording does not hold it"),
    ],
)
@pytest.mark.parametrize(
    "check",
    [
        {"expect": "law.kp_linear < 5"},
        {"holds": "always(speed < law.kp_linear)"},
        {"expect": "run.duration > 0", "when": "law.kp_linear < 5"},
    ],
)
def test_a_law_of_other_keys_leaves_the_other_recordings_judged(
    value: str | list[float] | None, reason: str, check: dict[str, str]
) -> None:
    run = simulate()
    parameters = {**run.parameters}
    del parameters["law.kp_linear"]
    if value is not None:
        parameters["law.kp_linear"] = value
    odd = dataclasses.replace(run, parameters=parameters)
    spec = tl.parse_spec({"checks": {"it": check}})
    first, second = tl.check_runs(spec, [("odd", odd), ("sound", run)])
    assert (first.verdict, first.is_decided, second.verdict) == ("FAIL", False, "PASS")
    assert reason in first.reason


def test_kinds_that_never_go_together_are_an_error() -> None:
    with pytest.raises(tl.errors.ExpressionError, match="expected a number, found a text"):
        judge(expect="run.duration + 'x' > 1")


@pytest.mark.parametrize("note", ["partial", "recovered"])
def test_a_recording_that_lost_something_fails_unless_allowed(note: str) -> None:
    notes, origin = {note: "9 bytes are lost"}, tl.run.Origin(lost="rows")
    run = dataclasses.replace(simulate(), notes=notes, origin=origin)
    spec = parse_spec({"checks": {"it": {"expect": "run.duration > 0"}}})
    (result,) = check_runs(spec, [("a.mcap", run)])
    assert (result.check, result.verdict) == ("recording", "FAIL")
    assert result.reason.endswith("is not complete: 9 bytes are lost")
    (result,) = check_runs(spec, [("a.mcap", run)], allow_partial=True)
    assert result.verdict is Verdict.PASS


def test_no_recordings_are_an_error() -> None:
    spec = parse_spec({"checks": {"it": {"expect": "run.duration > 0"}}})
    with pytest.raises(tl.errors.CheckError, match="no recording to check"):
        list(check_runs(spec, []))


def test_tolerances_hold_a_run_to_the_reference(good: Path) -> None:
    tables = {
        "signals": {"x": {"abs": 0.001, "reason": "a"}},
        "metrics": {"run.duration": {"abs": 1.0, "reason": "b"}},
    }
    other = simulate("paper-kp10")
    passed = hold_to(good, simulate(), **tables)
    failed = hold_to(good, other, **tables)
    assert [(result.check, result.verdict) for result in passed] == [
        ("signals.x", "PASS"),
        ("metrics.run.duration", "PASS"),
    ]
    assert [result.verdict for result in failed] == ["FAIL", "FAIL"]
    assert failed[0].first_violation_s is not None
    assert failed[0].margin is not None
    assert failed[0].margin < 0
    assert "where the reference has" in failed[0].reason


def test_a_metric_without_a_value_fails_even_as_the_reference_does(good: Path) -> None:
    tables = {"metrics": {"rotate.decay_ratio": {"abs": 1.0, "reason": "b"}}}
    (result,) = hold_to(good, simulate(), **tables)
    assert result.verdict is Verdict.FAIL
    assert "not_reached" in result.reason


def test_runs_that_do_not_overlap_fail_and_say_so(good: Path) -> None:
    spec = dataclasses.replace(
        parse_spec({"signals": {"x": {"abs": 1, "reason": "a"}}, "alignment": "phase:translate"}),
        reference=good,
    )
    (result,) = check_runs(spec, [("a.mcap", simulate("paper-kp4", max_duration_s=1.0))])
    assert result.verdict is Verdict.FAIL
    assert "expected a phase translate to align at, found rotate" in result.reason


def test_verdicts_join_to_the_worst() -> None:
    results = [
        CheckResult(file="a", check="b", verdict=verdict)
        for verdict in (Verdict.SKIPPED, Verdict.PASS, Verdict.FAIL)
    ]
    assert tl.check.join_verdicts(results) == "FAIL"
    assert tl.check.join_verdicts(results[:2]) == "PASS"
    assert tl.check.join_verdicts(results[:1]) == "SKIPPED"


@pytest.mark.parametrize(("count", "is_judged"), [(100, True), (101, False)])
def test_a_long_recording_is_held_to_as_many_formulas_as_take_seconds(
    count: int, *, is_judged: bool
) -> None:
    """Four parts each: always, x, < and the number. As many as are let through take 2 s."""
    rows = 375_000
    run = make_run(x_m=np.zeros(rows), time_s=np.arange(rows))
    spec = parse_spec({"checks": {f"c{n}": {"holds": "always[0, 9](x < 1)"} for n in range(count)}})
    results = check_runs(spec, [("a.mcap", run)])
    if is_judged:
        assert {result.verdict for result in results} == {Verdict.PASS}
        return
    with pytest.raises(
        tl.errors.CheckError, match=r"404 names, .* 400 are the most .* 375,000 samples"
    ):
        list(results)
