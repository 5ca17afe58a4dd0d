from pathlib import Path

import pyarrow.parquet
import pytest

import turtlelog as tl
from tests.cli.conftest import Call

ENDLESS = """
import time
from dataclasses import dataclass
from turtlelog.laws import Decision

@dataclass(frozen=True)
class Gains:
    gain: float = 1.0

class Own:
    Parameters = Gains

    def __init__(self, parameters):
        self.gain = parameters.gain

    def reset(self, start, goal, path):
        pass

    def step(self, time_ns, pose):
        while self.gain > 1.5 and time_ns > 1e8:
            time.sleep(0.01)
        return Decision(speed_m_s=0.1 * self.gain, turn_rate_rad_s=0.0)
"""


@pytest.fixture
def law(tmp_path: Path) -> str:
    (tmp_path / "own.py").write_text(ENDLESS, "utf-8")
    return f"{tmp_path / 'own.py'}:Own"


def test_a_law_without_end_ends_by_itself_with_one_line(law: str, call: Call) -> None:
    answer = call("run", "--law", law, "--set", "law.gain=2", "--step-budget-ms", "1e3")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == (
        f"turtlelog: error: law {law}, sample 7 took more than 1000 ms of a budget of 1000 ms, at"
        " 0.112 s; a slow law needs more: --step-budget-ms 6000, in Python step_budget_s=6\n"
    )


@pytest.mark.parametrize("more", [(), ("--law",)], ids=["loop", "poses"])
def test_a_replay_through_a_law_without_end_ends_with_one_line(
    more: tuple[str, ...], law: str, kp4: Path, call: Call
) -> None:
    way = ["--law", law] if more else ["--set", f"law.kind={law}"]
    answer = call("replay", kp4, *way, "--set", "law.gain=2", "--step-budget-ms", "50")
    assert (answer.code, answer.out) == (2, "")
    assert " took more than 1050 ms of a budget of 50 ms, at 0." in answer.err


@pytest.mark.thorough
def test_a_row_of_a_sweep_without_end_fails_and_the_others_go_on(
    law: str, tmp_path: Path, call: Call
) -> None:
    output = tmp_path / "t.parquet"
    words = ["--law", law, "--set", "max_duration_s=0.5", "--grid", "law.gain=1,2,1.25,1.4"]
    more = ["--jobs", "2", "--metric", "run.path_length", "--step-budget-ms", "1e3"]
    answer = call("sweep", *words, *more, "-o", output)
    assert answer.code == 0
    reasons = pyarrow.parquet.read_table(output).column("failed").to_pylist()
    late = f"law {law}, sample 7 took more than 1000 ms of a budget of 1000 ms, at 0.112 s"
    assert [reason and reason.partition(";")[0] for reason in reasons] == [None, late, None, None]
    assert answer.err.count("Ctrl-C keeps the rows that are done") == 1


def test_a_shorter_budget_goes_on_with_the_rows_that_are_done(law: str) -> None:
    base = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": law})
    plan = tl.sweep.build_plan(["law.gain=1,2"])
    sweeps = [tl.sweep.prepare_sweep(base, plan, step_budget_s=budget) for budget in (10.0, 0.1)]
    assert sweeps[0].list_facts() == sweeps[1].list_facts()


def test_a_candidate_of_tune_without_end_fails_and_the_others_go_on(law: str) -> None:
    base = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": law})
    base = tl.override_scenario(base, {"max_duration_s": 0.3})
    told: list[str] = []
    candidates = tl.sweep.tune_candidates.Candidates(
        base,
        ["law.gain"],
        tl.sweep.tune_candidates.parse_goal("run.path_length", ()),
        jobs=1,
        step_budget_s=0.05,
        tell=told.append,
    )
    found = candidates.evaluate([(1.0,), (2.0,), (1.25,)])
    assert [bool(one.failed) for one in found] == [False, True, False]
    assert told == [f"grid: {found[1].failed}"]
    assert "sample 7 took more than 1050 ms of a budget of 50 ms, at 0.112 s" in told[0]
