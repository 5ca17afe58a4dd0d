from pathlib import Path

import pytest

from tests.cli.conftest import Call
from tests.laws.test_law_files import write_law


@pytest.fixture
def recording(tmp_path: Path, call: Call) -> tuple[str, Path]:
    """Return the kind of a law with helpers and a recording of it."""
    kind, path = write_law(tmp_path / "laws", 0.5), tmp_path / "mine.mcap"
    answer = call("run", "--law", kind, "--set", "max_duration_s=0.5", "-o", path)
    assert answer.code == 0
    return kind, path


def test_replay_runs_a_law_with_a_helper(recording: tuple[str, Path], call: Call) -> None:
    kind, path = recording
    answer = call("replay", path, "--law", kind, "--expect-equal")
    assert (answer.code, answer.err) == (0, "")


@pytest.mark.thorough
def test_explain_runs_a_trusted_law_with_a_helper(recording: tuple[str, Path], call: Call) -> None:
    _, path = recording
    answer = call("explain", path, "--trust-law", "--metric", "run.path_length")
    assert (answer.code, answer.err) == (0, "")


def test_tune_runs_a_law_with_a_helper(tmp_path: Path, call: Call) -> None:
    kind = write_law(tmp_path, 0.5)
    words = ["--law", kind, "--set", "max_duration_s=0.2", "--grid", "start.heading_rad=0:1"]
    answer = call("tune", *words, "--minimise", "run.path_length", "--evaluations", "8")
    assert (answer.code, answer.err) == (0, "")
