"""Hold today's simulation to recorded runs, within the tolerances of a specification.

Run: pytest examples/test_tolerances.py
"""

from pathlib import Path

import pytest

import turtlelog as tl

HERE = Path(__file__).parent
RECORDINGS = sorted((HERE.parent / "recordings" / "paper").glob("*.mcap"))
TOLERANCES = tl.check.load_tolerances(HERE / "tolerances.toml")


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_todays_simulation_is_within_the_tolerances(path: Path) -> None:
    recording = tl.read_run(path)
    today = tl.simulate_run(tl.load_scenario(recording.name))
    results = tl.check.match_run(today, recording, TOLERANCES)
    assert [result for result in results if not result] == []


def test_a_shorter_pause_is_not() -> None:
    recording = tl.read_run(RECORDINGS[0])
    scenario = tl.override_scenario(tl.load_scenario(recording.name), {"law.pause_ticks": 20})
    results = tl.check.match_run(tl.simulate_run(scenario), recording, TOLERANCES)
    assert tl.check.join_verdicts(results) == "FAIL"
