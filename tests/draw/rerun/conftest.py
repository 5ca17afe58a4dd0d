from pathlib import Path

import pytest

from tests.draw.laws import KINDS, simulate_law, simulate_tracker
from tests.draw.rerun.rrds import make_attribution, simulate_preset
from turtlelog.draw import (
    write_comparison_rrd,
    write_explanation_rrd,
    write_run_rrd,
    write_violation_rrd,
)
from turtlelog.draw.rerun import viewer
from turtlelog.scenario import PAPER_RUNS

DOCUMENTS = {"Table 1": "| Kp |\n| --- |\n| 10 |\n", "Läufer / notes": "# Notes"}


@pytest.fixture(autouse=True)
def no_viewer_without_its_mark(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is without the mark must not depend on the drivers of graphics."""

    def refuse() -> Path:
        pytest.fail("expected the mark `viewer` on a test that starts one")

    if request.node.get_closest_marker("viewer") is None:
        monkeypatch.setattr(viewer, "find_viewer", refuse)


@pytest.fixture(scope="session")
def run_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.rrd"
    write_run_rrd(simulate_preset("paper-kp10"), path, documents=DOCUMENTS)
    return path


@pytest.fixture(scope="session")
def comparison_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("comparison") / "comparison.rrd"
    runs = [simulate_preset(name) for name in PAPER_RUNS]
    write_comparison_rrd(runs, path, documents=DOCUMENTS)
    return path


@pytest.fixture(scope="session")
def explanation_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explanation") / "explanation.rrd"
    without = {"pause": simulate_preset("paper-kp4"), "queue": simulate_preset("textbook")}
    run = simulate_preset("paper-kp10")
    found = make_attribution(run, {"pause": 0.05, "queue": -0.01})
    write_explanation_rrd(run, found, without, path, documents={"Notes": "# Notes"})
    return path


@pytest.fixture(scope="session")
def follower_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("follower") / "follower.rrd"
    write_run_rrd(simulate_law("Follower"), path, documents=DOCUMENTS)
    return path


@pytest.fixture(scope="session")
def strange_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("strange") / "strange.rrd"
    write_run_rrd(simulate_law("strange"), path, documents=DOCUMENTS)
    return path


@pytest.fixture(scope="session")
def tracker_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tracker") / "tracker.rrd"
    write_run_rrd(simulate_tracker("kanayama"), path, documents=DOCUMENTS)
    return path


@pytest.fixture(scope="session")
def laws_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Several laws beside each other."""
    path = tmp_path_factory.mktemp("laws") / "laws.rrd"
    runs = [simulate_preset("paper-kp10"), *map(simulate_law, KINDS)]
    write_comparison_rrd(runs, path)
    return path


@pytest.fixture(scope="session")
def violation_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("violation") / "violation.rrd"
    run, message = simulate_preset("paper-kp10"), "speed <= 0.5: found 1 m/s"
    write_violation_rrd(run, path, at_s=3.2, title="speed <= 0.5", message=message)
    return path
