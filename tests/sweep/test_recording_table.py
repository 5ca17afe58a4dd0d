import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from turtlelog.errors import LogError
from turtlelog.log import read_as_chosen
from turtlelog.sweep import (
    ResultTable,
    TabulatedFiles,
    find_recordings,
    plan_metric_table,
    read_result_table,
    recording_table,
    tabulate_recordings,
)

Tabulate = Callable[..., TabulatedFiles]
ONLY = ("run.duration", "rotate.*", "final.position_error")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("runs")
    for kp in (2.0, 4.0):
        changes = {"max_duration_s": 0.2 * kp, "law.kp_angular": kp}
        scenario = tl.override_scenario(tl.load_scenario("textbook"), changes)
        tl.write_recording(tl.simulate_run(scenario), folder / f"{kp:g}.mcap")
    return sorted(folder.iterdir())


@pytest.fixture
def folder(tmp_path: Path, runs: list[Path]) -> Path:
    place = tmp_path / "data"
    (place / "deep").mkdir(parents=True)
    for number in range(6):
        shutil.copy(runs[number % 2], place / "deep" / f"{number}.mcap")
    (place / "cut.mcap").write_bytes(runs[0].read_bytes()[:400])
    (place / "empty.mcap").touch()
    return place


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Files that were measured."""
    names: list[str] = []
    read = read_as_chosen

    def count(path: str, choice: Any) -> Any:
        names.append(Path(path).name)
        return read(path, choice)

    monkeypatch.setattr(recording_table, "read_as_chosen", count)
    return names


def tabulate(folder: Path, **options: Any) -> TabulatedFiles:
    output = folder / "table.parquet"  # within the folder: it is no recording
    only = options.pop("only", ONLY)
    found = find_recordings([folder], without=[output])
    return tabulate_recordings(found, output, plan_metric_table(only=only), **options)


def read_columns(path: Path) -> dict[str, list[Any]]:
    table = read_result_table(path, kind="metrics")
    return {column.name: list(column.cells) for column in table.columns}


def test_a_table_has_a_row_for_every_file_damaged_ones_too(folder: Path) -> None:
    done = tabulate(folder)
    assert (done.files, done.read, done.failed) == (8, 8, 2)
    table = read_result_table(done.output, kind="metrics")
    cells = {column.name: column.cells for column in table.columns}
    assert list(cells["file"]) == [
        *("cut.mcap", "deep/0.mcap", "deep/1.mcap", "deep/2.mcap"),
        *("deep/3.mcap", "deep/4.mcap", "deep/5.mcap", "empty.mcap"),
    ]
    assert "truncated or unfinished" in cells["error"][0]
    assert "it is empty" in cells["error"][7]
    assert cells["error"][1] is None
    metric = tl.measure_run(tl.read_recording(folder / "deep" / "1.mcap"))["run.duration"]
    assert cells["run.duration"][2] == metric.value
    assert cells["run.duration.status"][:2] == [None, "ok"]
    duration = table.find("run.duration")
    assert duration is not None
    assert duration.unit == "s"


def test_a_metric_without_a_value_has_its_status(folder: Path) -> None:
    cells = read_columns(tabulate(folder).output)
    measured = tl.measure_run(tl.read_recording(folder / "deep" / "0.mcap"), only=["rotate.*"])
    lacking = [one for one in measured.values() if one.value is None]
    assert lacking
    for one in lacking:
        assert cells[one.id][1] is None
        assert cells[f"{one.id}.status"][1] == one.status.value


def test_what_has_not_changed_is_not_opened(
    folder: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = tabulate(folder).output.read_bytes()
    assert len(opened) == 8
    monkeypatch.setattr("turtlelog.sweep.recording_table.hash_recording", lambda path: 1 / 0)
    done = tabulate(folder)
    assert done.read == 0
    assert len(opened) == 8
    assert done.failed == 2
    assert done.output.read_bytes() == first


def test_only_what_is_new_or_differs_is_measured(
    folder: Path, runs: list[Path], opened: list[str], tmp_path: Path
) -> None:
    tabulate(folder)
    opened.clear()
    os.utime(folder / "deep" / "0.mcap", ns=(1, 1))  # the content is the same
    shutil.copy(runs[1], folder / "deep" / "2.mcap")  # it was another
    shutil.copy(runs[1], folder / "aa.mcap")
    (folder / "deep" / "5.mcap").unlink()
    done = tabulate(folder)
    assert opened == ["aa.mcap", "2.mcap"]
    assert (done.files, done.read) == (8, 2)
    anew = tmp_path / "anew.parquet"
    found = find_recordings([folder], without=[done.output])
    tabulate_recordings(found, anew, plan_metric_table(only=ONLY))
    assert anew.read_bytes() == done.output.read_bytes()


def test_same_size_and_another_time_is_measured_where_the_content_differs(
    folder: Path, opened: list[str]
) -> None:
    tabulate(folder)
    opened.clear()
    path = folder / "deep" / "0.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    tabulate(folder)
    assert opened == ["0.mcap"]


@pytest.mark.thorough
def test_bytes_are_the_same_with_any_number_of_processes(folder: Path, tmp_path: Path) -> None:
    one = tabulate(folder).output.rename(tmp_path / "one.parquet")
    assert tabulate(folder, jobs=2).output.read_bytes() == one.read_bytes()


def test_other_settings_measure_anew(folder: Path, opened: list[str]) -> None:
    tabulate(folder)
    opened.clear()
    done = tabulate(folder, only=("run.duration",))
    assert len(opened) == 8
    assert "final.position_error" not in read_columns(done.output)


def test_another_version_measures_anew(
    folder: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tabulate(folder)
    opened.clear()
    monkeypatch.setattr("turtlelog.sweep.recording_table.__version__", "0.0.1")
    tabulate(folder)
    assert len(opened) == 8


def test_an_interruption_loses_no_more_than_a_chunk(folder: Path, opened: list[str]) -> None:
    def interrupt(chunks: Iterator[Any], count: int) -> Iterator[Any]:
        assert count == 8
        for number, chunk in enumerate(chunks):
            if number == 5:
                raise KeyboardInterrupt
            yield chunk

    with pytest.raises(KeyboardInterrupt):
        tabulate(folder, watch=interrupt)
    assert not (folder / "table.parquet").exists()
    first = list(opened)
    with (folder / "table.parquet.partial").open("ab") as stream:
        stream.write(b"cut off while it was written")
    done = tabulate(folder)
    assert done.read == 8 - 5
    assert opened[len(first) :] == ["4.mcap", "5.mcap", "empty.mcap"]
    assert not (folder / "table.parquet.partial").exists()
    kept = done.output.read_bytes()
    done.output.unlink()
    assert tabulate(folder).output.read_bytes() == kept


def test_what_was_kept_for_other_settings_is_not_used(folder: Path, opened: list[str]) -> None:
    with pytest.raises(ZeroDivisionError):
        tabulate(folder, only=("run.duration",), watch=lambda chunks, _: (1 / 0 for _ in chunks))
    opened.clear()
    assert tabulate(folder).read == 8
    assert len(opened) == 8


def test_two_tables_into_one_file_at_once_are_refused(folder: Path) -> None:
    def begin_another(chunks: Iterator[Any], _: int) -> Iterator[Any]:
        with pytest.raises(
            tl.errors.SweepError, match=r"table\.parquet: another command is writing it"
        ):
            tabulate(folder)
        return chunks

    assert tabulate(folder, watch=begin_another).read == 8


@pytest.mark.thorough
@pytest.mark.parametrize("cells", [1, 150])
def test_a_table_of_many_groups_is_that_of_one(
    folder: Path, cells: int, monkeypatch: pytest.MonkeyPatch, runs: list[Path]
) -> None:
    before = read_columns(tabulate(folder).output)
    monkeypatch.setattr("turtlelog.sweep.result_table._CELLS_GROUPED", cells)
    monkeypatch.setattr("turtlelog.sweep.recording_table._COLUMNS_LOOKED", 1)
    assert tabulate(folder).read == 0
    assert read_columns(folder / "table.parquet") == before
    shutil.copy(runs[0], folder / "deep" / "3.mcap")
    (folder / "deep" / "1.mcap").unlink()
    done = tabulate(folder)
    assert (done.read, done.failed, len(done.errors)) == (1, 2, 2)
    assert [label for label, _ in done.errors] == ["cut.mcap", "empty.mcap"]
    after = read_columns(done.output)
    assert after["file"] == [*before["file"][:2], *before["file"][3:]]
    durations = {name: before["run.duration"][number] for number, name in enumerate(before["file"])}
    durations["deep/3.mcap"] = durations["deep/0.mcap"]  # whose content it has now
    assert after["run.duration"] == [durations[name] for name in after["file"]]


@pytest.mark.parametrize("kind", ["sweep", "text", "cut"])
def test_a_file_that_is_no_such_table_is_not_replaced(folder: Path, kind: str) -> None:
    output = tabulate(folder).output
    if kind == "sweep":
        tl.sweep.write_result_table(ResultTable(kind="sweep", columns=()), output)
    else:
        output.write_bytes(b"my thesis" if kind == "text" else output.read_bytes()[:-20])
    before = output.read_bytes()
    with pytest.raises(LogError, match=r"table\.parquet: expected"):
        tabulate(folder)
    assert output.read_bytes() == before


def test_a_table_of_another_name_in_the_folder_is_no_recording(folder: Path) -> None:
    tabulate(folder).output.rename(folder / "former.parquet")
    assert tabulate(folder).files == 8


def test_a_bag_is_measured_again_where_one_of_its_files_differs(
    tmp_path: Path, runs: list[Path], opened: list[str]
) -> None:
    (tmp_path / "data").mkdir()
    tl.log.export_rosbag2(tl.read_recording(runs[0]), tmp_path / "data" / "bag")
    assert tabulate(tmp_path / "data").failed == 0
    assert tabulate(tmp_path / "data").read == 0
    metadata = tmp_path / "data" / "bag" / "metadata.yaml"
    os.utime(metadata, ns=(1, 1))
    assert tabulate(tmp_path / "data").read == 0
    metadata.write_text(metadata.read_text() + "\n")
    assert tabulate(tmp_path / "data").read == 1
    assert opened == ["bag", "bag"]


def test_loops_of_several_laws_have_columns_in_one_order(tmp_path: Path, runs: list[Path]) -> None:
    """The order does not depend on which file was read first."""
    (tmp_path / "data").mkdir()
    shutil.copy(runs[0], tmp_path / "data" / "b.mcap")
    other = tl.override_scenario(tl.load_scenario("posture"), {"max_duration_s": 0.3})
    tabulate(tmp_path / "data", only=None)
    tl.write_recording(tl.simulate_run(other), tmp_path / "data" / "a.mcap")
    done = tabulate(tmp_path / "data", only=None)
    assert done.read == 1
    grown = done.output.rename(tmp_path / "grown.parquet").read_bytes()
    assert tabulate(tmp_path / "data", only=None).output.read_bytes() == grown
