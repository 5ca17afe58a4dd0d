"""A law that is like none of ours goes through every command."""

import csv
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call, read_identified
from tests.strange_law import KIND, simulate_strange

RUN = simulate_strange()
TRUST = "--trust-law"


@pytest.fixture(scope="module")
def strange(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("strange") / "strange.mcap"
    tl.write_recording(RUN, path)
    return path


def list_groups(ids: list[str]) -> set[str]:
    return {name.partition(".")[0] for name in ids}


def test_run_sets_a_parameter_without_a_default_and_shows_the_loops(
    call: Call, tmp_path: Path
) -> None:
    words = ("--set", f"law.kind={KIND}", "--set", "law.gain_a=4", "-o", tmp_path / "s.mcap")
    answer = call("run", "textbook", *words)
    assert answer.code == 0
    lines = answer.out.splitlines()
    assert ["a", "b"] in map(str.split, lines)
    assert {"RMS error", "settling time"} <= {line[:18].strip() for line in lines}
    assert "rotate" not in answer.out
    assert "translate" not in answer.out
    read = tl.read_recording(tmp_path / "s.mcap")
    assert read.declaration == RUN.declaration


def test_run_names_the_parameter_that_must_be_set(call: Call) -> None:
    answer = call("run", "textbook", "--set", f"law.kind={KIND}")
    assert answer.code == 2
    assert "law.gain_a: expected a number, found no value" in answer.err


def test_kp_sets_the_declared_gains(call: Call) -> None:
    words = ("--set", f"law.kind={KIND}", "--set", "law.gain_a=4", "--kp", "2.5")
    out = call("scenario", "textbook", *words).out
    parameters = tl.scenario.flatten_scenario(tl.parse_scenario(out))
    # Values of --set come last.
    assert (parameters["law.gain_a"], parameters["law.gain_b"]) == (4, 2.5)


def test_kp_without_a_declared_gain_is_refused(call: Call, tmp_path: Path) -> None:
    law = tmp_path / "plain.py"
    law.write_text(PLAIN)
    answer = call("run", "textbook", "--set", f"law.kind={law}:Plain", "--kp", "2")
    assert answer.code == 2
    assert "--kp: this law declares no gain" in answer.err


def test_recording_gives_back_what_the_law_declared_and_recorded(strange: Path) -> None:
    read = tl.read_recording(strange)
    assert read.declaration == RUN.declaration
    for name in ("states", "reference_xy_m", "reference_heading_rad", "phase"):
        found, expected = getattr(read.samples, name), getattr(RUN.samples, name)
        assert np.array_equal(found, expected, equal_nan=True), name
    assert read.find_phase_spans() == RUN.find_phase_spans()


def test_info_lists_the_topics_of_states_and_references(call: Call, strange: Path) -> None:
    (answer,) = call("info", strange, "--json").json
    topics = {topic["topic"]: topic for topic in answer["topics"]}
    assert topics["/turtle1/law_state"]["count"] == len(RUN.samples)
    assert 0 < topics["/turtle1/reference"]["count"] < len(RUN.samples)


def test_metrics_are_those_of_the_declared_loops(call: Call, strange: Path) -> None:
    (answer,) = call("metrics", strange, "--json").json
    found = {metric["id"]: metric["value"] for metric in answer["metrics"]}
    assert list_groups(list(found)) == {"a", "b", "final", "run"}
    # The same as of the run itself, and as numpy has it (tests/measure/test_loops.py).
    assert found == {name: metric.value for name, metric in tl.measure_run(RUN).items()}
    samples = RUN.samples
    saturated = np.abs(samples.speed_m_s[samples.phase == 1]) >= 1.0
    assert found["b.saturated_share"] == pytest.approx(saturated.mean())
    out = call("metrics", strange).out
    assert not {"rotate.", "translate."} & {line[:7] for line in out.splitlines()}


def test_metrics_of_two_laws_stand_beside_each_other(call: Call, strange: Path, kp4: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(call("metrics", strange, kp4, "--csv").out)))
    assert rows[0]["rotate.overshoot [%]"] == ""
    assert rows[1]["a.rms_error [deg]"] == ""
    assert float(rows[0]["a.rms_error [deg]"]) > 0.0
    assert float(rows[1]["rotate.overshoot [%]"]) > 0.0


def test_compare_shows_no_column_of_a_loop_that_no_run_has(
    call: Call, strange: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.mcap"
    tl.write_recording(simulate_strange(law__gain_b=2.0, name="faster"), other)
    out = call("compare", strange, other).out
    assert "no_phase" not in out
    assert "rotate" not in out
    answer = call("compare", other, "--reference", strange, "--json").json
    (compared,) = answer["runs"]
    assert "memory" in {signal["signal"] for signal in compared["signals"]}
    assert list_groups([metric["id"] for metric in compared["metrics"]]) <= {
        "a",
        "b",
        "final",
        "run",
    }


def test_check_judges_loops_states_and_phases(call: Call, strange: Path, tmp_path: Path) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text(
        """format = 1
[checks.follows]
expect = "a.rms_error < 30"
[checks.settles]
expect = "0 < b.settling_time < 20"
[checks.remembers]
holds = "always(memory >= 0)"
[checks.turns]
holds = "always(abs(turn_rate) <= 1)"
phase = "one"
[checks.other]
expect = "rotate.overshoot < 1"
"""
    )
    results = {
        found["check"]: found for found in call("check", spec, strange, "--json").json["results"]
    }
    passed = [name for name, found in results.items() if found["verdict"].lower() == "pass"]
    assert passed == ["follows", "settles", "remembers", "turns"]
    assert "declares no loop rotate" in results["other"]["reason"]
    example = call("check", "--init", strange).out
    assert "b.settling_time" in example
    assert "rotate" not in example
    again = tmp_path / "init.toml"
    again.write_text(example)
    assert call("check", again, strange).code == 0


def test_replay_of_the_law_needs_trust_and_differs_in_nothing(call: Call, strange: Path) -> None:
    assert call("replay", strange, "--law").code == 2
    assert call("replay", strange, "--law", TRUST, "--expect-equal").code == 0
    assert call("replay", strange, TRUST, "--expect-equal").code == 0
    assert call("replay", strange, "--plant", "--expect-equal").code == 0


def test_replay_sets_the_declared_gains(call: Call, strange: Path, tmp_path: Path) -> None:
    out = tmp_path / "again.mcap"
    assert call("replay", strange, TRUST, "--kp", "3", "-o", out).code == 0
    parameters = tl.read_recording(out).parameters
    assert (parameters["law.gain_a"], parameters["law.gain_b"]) == (3.0, 3.0)


@pytest.mark.thorough
def test_explain_names_the_effect_that_the_law_declares(call: Call, strange: Path) -> None:
    """All subsets of the effects are simulated with an interpreted law."""
    metric = ("--metric", "run.duration")
    answer = call("explain", strange, TRUST, "--json", *metric).json
    found = answer["attribution"]["contributions"]
    assert {one["cause"]: one["contribution"] for one in found} == {
        "hesitation": pytest.approx(0.16, abs=0.033)
    }
    assert read_identified(answer).get("law.kp_linear") is None
    assert read_identified(answer).get("law.heading_tolerance_rad") is None
    out = call("explain", strange, TRUST, *metric).out
    assert "  hesitation  +0.144 s" in out
    assert "Kp" not in out
    assert "tolerance" not in out


def test_tables_have_columns_of_states_and_references(
    call: Call, strange: Path, tmp_path: Path
) -> None:
    assert call("convert", strange, "-o", tmp_path / "out", "--format", "csv").code == 0
    (table,) = (tmp_path / "out").rglob("*samples.csv")
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert RUN.samples.states is not None
    assert [float(row["memory"]) for row in rows] == RUN.samples.states[:, 0].tolist()
    assert {row["phase"] for row in rows} == {"one", "two"}
    assert float(rows[3]["reference_heading_rad"]) > 0.0


@pytest.mark.thorough
def test_plot_draws_it(call: Call, strange: Path, tmp_path: Path) -> None:
    """All usual figures are drawn."""
    answer = call("plot", strange, "-o", tmp_path / "figures", "--format", "svg")
    assert answer.code == 0
    assert list((tmp_path / "figures").glob("*.svg"))


@pytest.mark.thorough
def test_view_writes_a_recording_of_it(call: Call, strange: Path, tmp_path: Path) -> None:
    assert call("compare", strange, strange, "--rrd", tmp_path / "both.rrd").code == 0
    assert call("explain", strange, TRUST, "--rrd", tmp_path / "why.rrd").code == 0
    tl.write_run_rrd(RUN, tmp_path / "one.rrd")
    assert all((tmp_path / f"{name}.rrd").stat().st_size > 10_000 for name in ("both", "one"))


@pytest.mark.thorough
def test_view_takes_a_picture_from_the_start_of_a_phase(
    call: Call, strange: Path, tmp_path: Path
) -> None:
    """Rerun's viewer starts and draws in software."""
    other = tmp_path / "other.mcap"
    tl.write_recording(simulate_strange(law__gain_b=2.0, name="faster"), other)
    words = ("--at", "1", "--snapshot", tmp_path / "two.png", "--size", "800x500")
    answer = call("view", strange, other, "--timeline", "two_time", *words)
    if "expected a graphics adapter" in answer.err:
        pytest.skip("the viewer has no graphics adapter here")
    assert answer.code == 0
    assert (tmp_path / "two.png").stat().st_size > 10_000
    answer = call("view", strange, other, "--timeline", "rotate_time", *words)
    assert (answer.code, "timeline: expected" in answer.err) == (2, True)


def test_what_came_before_a_law_failed_is_recorded(call: Call, tmp_path: Path) -> None:
    law = tmp_path / "plain.py"
    law.write_text(PLAIN.replace("return", "if time_ns > 300_000_000: 1 / 0\n        return"))
    for words in ((), ("--realtime",)):
        out = tmp_path / f"kept{len(words)}.mcap"
        answer = call("run", "textbook", "--set", f"law.kind={law}:Plain", "-o", out, *words)
        assert answer.code == 2
        assert f"{law}, line 17: ZeroDivisionError: division by zero" in answer.err
        run = tl.read_recording(out)
        assert run.stop_reason == "law_failed"
        assert "ZeroDivisionError" in run.events[-1].text
        assert math.isclose(run.samples.time_ns[-1] / 1e9, 0.288)


def test_what_a_law_prints_does_not_disturb_json(call: Call, tmp_path: Path) -> None:
    law = tmp_path / "plain.py"
    law.write_text(f"print('loaded')\n{PLAIN}".replace("return", "print('hello')\n        return"))
    answer = call("run", "textbook", "--set", f"law.kind={law}:Plain", "--json")
    assert json.loads(answer.out)["samples"] > 0
    assert answer.err.count("hello") == json.loads(answer.out)["samples"]


PLAIN = """from dataclasses import dataclass

from turtlelog.laws import Decision

@dataclass(frozen=True)
class Nothing:
    speed: float = 0.5

class Plain:
    Parameters = Nothing
    def __init__(self, parameters):
        self.parameters = parameters
    def reset(self, start, goal, path):
        pass
    def step(self, time_ns, pose):
        stop = "enough" if time_ns > 1_000_000_000 else None
        return Decision(speed_m_s=0.5, turn_rate_rad_s=0.0, stop_reason=stop)
"""
