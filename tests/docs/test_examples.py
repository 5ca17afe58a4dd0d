"""The scripts of examples/ run as they stand, and find what the pages say that they find."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
FINDINGS = {
    "first_run": ["without queue and pause: final.position_error = 0.0051 m"],
    "best_gain": [
        "Fastest of 5 with final.position_error < 0.01: paper 4",
        "Fastest of 7 with final.position_error < 0.01: textbook 10",
    ],
    "explain_run": [
        "loop.start_backlog = 5 (exact: reproduces all 770 samples)",
        "final.position_error is 0.1067 m, in the log and re-simulated.",
        "queue +0.05108 m and pause +0.05057 m",
        "final.heading_error is 1.074 deg, in the log and re-simulated.",
        "queue +0.514 deg and pause +0.5088 deg",
    ],
    "what_if": [
        "as recorded         0.1067 m",
        "without the queue   0.0268 m",
        "without the pause   0.0274 m",
        "without both        0.0051 m",
    ],
    "theory_and_measured": [
        "   1    4.00     4.35      4.08    5 ticks",
        "  10    0.40     2.22      2.21    4 ticks",
    ],
}


def run_script(script: Path, *words: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.everyday("first_run", "theory_and_measured")
@pytest.mark.parametrize("name", FINDINGS)
def test_example_scripts_find_what_they_are_shown_for(name: str, tmp_path: Path) -> None:
    """A script runs as a reader runs it; one explains a run."""
    printed = run_script(EXAMPLES / f"{name}.py", folder=tmp_path)
    assert [found for found in FINDINGS[name] if found not in printed] == []


@pytest.mark.everyday("what_if")
@pytest.mark.parametrize("name", ["explain_run", "what_if"])
def test_example_scripts_take_a_recording(name: str, tmp_path: Path) -> None:
    """A script runs as a reader runs it; one explains a run."""
    recording = ROOT / "recordings" / "paper" / "kp1.mcap"
    printed = run_script(EXAMPLES / f"{name}.py", str(recording), folder=tmp_path)
    assert "0.0025 m" in printed or "0.002521 m" in printed


def test_every_script_is_run() -> None:
    scripts = {path.stem for path in EXAMPLES.glob("*.py") if not path.stem.startswith("test_")}
    assert scripts == {*FINDINGS, "turn_and_drive"}
