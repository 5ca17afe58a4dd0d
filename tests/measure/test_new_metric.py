"""A metric added to a copy of the package as one function in one file: everything has it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import turtlelog

SECOND = """

@curve_metric("second_error", "{value}", "Error of the {signal} at the second pose.", better=None)
def find_second_error(curve: Response) -> Outcome:
    return curve.error[1], curve.start_s + curve.time_s[1], FOUND


@curve_metric("returns", "1", "Crossings of the {signal}, and one more.", nature="count")
def count_returns(curve: Response) -> Outcome:
    rows = find_crossing_rows(curve.error, 0.0, curve.memory)
    return 1.0 + len(rows), math.nan, FOUND
"""

NAME = "rotate.second_error"


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("metric")
    # With what numba compiled: the loop is the same.
    shutil.copytree(Path(turtlelog.__file__).parent, folder / "turtlelog")
    file = folder / "turtlelog" / "measure" / "metrics" / "loop_metrics.py"
    file.write_text(file.read_text("utf-8") + SECOND, "utf-8")
    ask(folder, "run", "paper-kp4", "-o", "run.mcap")
    return folder


def ask(copy: Path, *words: str) -> Any:
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    command = [sys.executable, "-P", "-m", "turtlelog", *words, "--json"]
    done = subprocess.run(
        command, cwd=copy, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def read_error(copy: Path) -> float:
    (found,) = ask(copy, "metrics", "run.mcap", "--metric", NAME)
    (metric,) = found["metrics"]
    value: float = metric["value"]
    return value


@pytest.mark.thorough
def test_a_new_metric_is_measured_listed_and_checked(copy: Path) -> None:
    """Commands run in processes."""
    error_deg = read_error(copy)
    assert 100.0 < error_deg < 130.0  # the goal is 128.5 deg to the left, and a tick turns 0.9
    assert "second_error" in json.dumps(ask(copy, "list", "metrics"))
    ask(copy, "check", "run.mcap", "--expect", f"{NAME} > {error_deg - 1.0}")


@pytest.mark.thorough
def test_a_new_count_is_explained_to_half_a_count(copy: Path) -> None:
    """What a metric counts is declared beside it, not read off its name."""
    found = ask(copy, "explain", "run.mcap", "--metric", "rotate.returns")
    assert found["metric"]["value"] == 2.0
    assert found["attribution"]["resolution"] == {"size": 0.5, "reason": "half a count"}


@pytest.mark.thorough
def test_a_new_metric_is_a_column_of_a_compiled_sweep(copy: Path) -> None:
    """The measurement is compiled anew."""
    pytest.importorskip("numba")
    code = (
        "from turtlelog.scenario import get_preset\n"
        "from turtlelog.sweep.batch import find_batch, measure_rows\n"
        "base = get_preset('paper-kp4')\n"
        "loops = find_batch(base)\n"
        "loops._loops = loops.load()\n"
        f"rows = measure_rows(base, {{'law.kp_linear': [4.0]}}, ['{NAME}'], threads=1)\n"
        f"print(rows.compiled, rows.values['{NAME}'][0])\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=copy,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["1", str(read_error(copy))]
