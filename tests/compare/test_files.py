from pathlib import Path

import pytest

import turtlelog as tl
from turtlelog.compare import RunSummary


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "kp4.mcap"
    tl.write_recording(tl.simulate_run(tl.load_scenario("paper-kp4")), path)
    return path


def test_files_are_summarised_in_order_and_errors_stand_in_their_places(recording: Path) -> None:
    found = list(
        tl.compare.summarise_files([recording, "none.mcap", recording], only=["run.duration"])
    )
    assert isinstance(found[1], tl.TurtlelogError)
    for summary in (found[0], found[2]):
        assert isinstance(summary, RunSummary)
        assert (summary.file, summary.name) == (str(recording), "paper-kp4")
        assert summary.parameters["law.kp_linear"] == 4.0
        assert {name: metric.value for name, metric in summary.metrics.items()} == {
            "run.duration": 11.184
        }


def test_errors_keep_nothing_of_what_was_read(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-1000])
    (found,) = tl.compare.summarise_files([cut])
    assert isinstance(found, tl.TurtlelogError)
    assert (found.__traceback__, found.__cause__, found.__context__) == (None, None, None)


def test_nothing_is_read_before_it_is_asked_for(tmp_path: Path) -> None:
    found = tl.compare.summarise_files([tmp_path / "late.mcap"])
    tl.write_recording(tl.simulate_run(tl.load_scenario("textbook")), tmp_path / "late.mcap")
    assert isinstance(next(found), RunSummary)


@pytest.mark.parametrize(
    ("choice", "line"),
    [
        ({"jobs": 0}, "jobs: expected at least 1 process, found 0"),
        ({"only": ["run.lenght"]}, 'no metric "run.lenght"; did you mean run.path_length'),
    ],
)
def test_bad_choices_are_refused_at_once(choice: dict[str, object], line: str) -> None:
    with pytest.raises(tl.TurtlelogError, match=line):
        tl.compare.summarise_files([], **choice)  # type: ignore[arg-type]
