import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pyarrow import parquet

from tests.log.runs import simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log.engine.limits import MOST_ROWS
from turtlelog.log.exported_tables import (
    export_csv,
    export_parquet,
    import_tables,
    require_read_back,
)
from turtlelog.run import Event, PoseColumns, Run

FLOATS = st.floats(allow_nan=False, allow_infinity=False)


def read_csv(path: Path) -> dict[str, list[str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        heads, *rows = csv.reader(stream)
    return {head: [row[place] for row in rows] for place, head in enumerate(heads)}


def make_numbers_run(values: list[float]) -> Run:
    """Return a run whose samples and positions are any numbers."""
    run = simulate_short_run()
    column = np.resize(np.array(values), len(run.samples))
    pairs = np.resize(np.array(values), (len(run.poses), 2))
    return replace(
        run,
        poses=replace(run.poses, xy_m=pairs, speed_m_s=None, turn_rate_rad_s=None),
        samples=replace(
            run.samples,
            error_xy_m=pairs[: len(run.samples)].copy(),
            speed_m_s=column,
            wanted_speed_m_s=None,
        ),
        events=(Event(time_ns=7, kind="wall_hit", text='The "wall", \t\n\u00fc'),),
    )


def assert_holds_run(samples: dict[str, list[Any]], poses: dict[str, list[Any]], run: Run) -> None:
    expected = run.samples
    assert expected.error_xy_m is not None
    assert [float(x) for x in samples["error_y_m"]] == expected.error_xy_m[:, 1].tolist()
    assert [float(x) for x in samples["speed_m_s"]] == expected.speed_m_s.tolist()
    assert [int(x) for x in samples["sequence"]] == expected.sequence.tolist()
    assert samples["phase"] == [run.phase_names[number] for number in expected.phase]
    assert [int(x) for x in poses["time_ns"]] == run.poses.time_ns.tolist()
    found = [[float(x), float(y)] for x, y in zip(poses["x_m"], poses["y_m"], strict=True)]
    assert found == run.poses.xy_m.tolist()


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(FLOATS, min_size=1, max_size=4))
def test_any_numbers_come_back_from_csv(values: list[float], tmp_path: Path) -> None:
    run = make_numbers_run(values)
    tables = {name: tmp_path / f"{name}.csv" for name in ("samples", "poses")}
    for name, path in tables.items():
        export_csv(run, path, table=name)
    assert_holds_run(read_csv(tables["samples"]), read_csv(tables["poses"]), run)


def test_a_run_comes_back_from_parquet_with_its_types(tmp_path: Path) -> None:
    run = simulate_short_run()
    written = export_parquet(run, tmp_path / "out")
    assert sorted(tmp_path.joinpath("out").iterdir()) == sorted(written)
    tables = {path.stem: parquet.read_table(path) for path in written}
    assert_holds_run(tables["samples"].to_pydict(), tables["poses"].to_pydict(), run)
    kinds = {field.name: str(field.type) for field in tables["samples"].schema}
    assert (kinds["time_ns"], kinds["distance_m"], kinds["phase"]) == ("int64", "double", "string")


def test_a_folder_holds_a_file_per_table(tmp_path: Path) -> None:
    export_csv(simulate_short_run(), tmp_path / "out")
    heads = {path.stem: [*read_csv(path)] for path in (tmp_path / "out").glob("*.csv")}
    assert heads["commands"] == ["time_ns", "speed_m_s", "lateral_speed_m_s", "turn_rate_rad_s"]
    assert heads["poses"][:4] == ["time_ns", "x_m", "y_m", "heading_rad"]
    assert heads["events"] == ["time_ns", "kind", "text"]
    assert {"phase", "wanted_turn_rate_rad_s", "world_velocity_y_m_s"} <= {*heads["samples"]}


def test_facts_beside_csv_are_read_back_and_refused_if_they_are_others(tmp_path: Path) -> None:
    run = simulate_short_run()
    written = export_csv(run, tmp_path / "out")
    require_read_back(run, written, None)
    with pytest.raises(LogError, match=r"run\.json: .* found other values in facts of the run"):
        require_read_back(replace(run, goal_xy_m=(9.0, 9.0)), written, None)
    (tmp_path / "out" / "run.json").write_text("[]")
    with pytest.raises(LogError, match=r"run\.json: expected the facts of a run as turtlelog"):
        import_tables(tmp_path / "out")


def test_what_was_not_recorded_is_left_out(tmp_path: Path) -> None:
    export_csv(make_numbers_run([1.0]), tmp_path / "poses.csv")
    assert [*read_csv(tmp_path / "poses.csv")] == ["time_ns", "x_m", "y_m", "heading_rad"]


def test_texts_come_back_whole(tmp_path: Path) -> None:
    run = make_numbers_run([1.0])
    export_csv(run, tmp_path / "events.csv", table="events")
    assert read_csv(tmp_path / "events.csv")["text"] == [event.text for event in run.events]


def test_a_file_is_replaced_and_a_folder_is_not(tmp_path: Path) -> None:
    run = simulate_short_run()
    (tmp_path / "poses.csv").write_text("old")
    assert export_csv(run, tmp_path / "poses.csv") == (tmp_path / "poses.csv",)
    assert len(read_csv(tmp_path / "poses.csv")["x_m"]) == len(run.poses)
    with pytest.raises(LogError, match="expected the name of a new folder, found a folder with"):
        export_csv(run, tmp_path)


def test_an_unknown_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"expected one of poses, commands, .* found pose"):
        export_parquet(simulate_short_run(), tmp_path / "a.parquet", table="pose")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("letters", [131_072, 131_073])
def test_a_cell_that_is_too_long_is_named_with_its_row(tmp_path: Path, letters: int) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("time_ns,x_m,y_m,heading_rad\n0,0,0,0\n1,0,0," + "0" * letters + "\n")
    said = r"poses\.csv: behind row 1: expected cells, found a cell of more than 131,072 characters"
    if letters == 131_072:
        assert len(import_tables(path).poses) == 2
        return
    with pytest.raises(LogError, match=rf"{said}; look for a quote that no other closes"):
        import_tables(path)


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("clock", "[]", "Expected `object | null`, got `array`"),
        ("clock", "{}", "Object missing required field `used`"),
        ("clock", '{"used": "sun"}', "Invalid enum value 'sun' - at `$.used`"),
        ("goal_m_m_rad", "[1]", "Expected `array` of length 3, got 1"),
        ("scenario", "7", "Expected `object | null`, got `int`"),
        ("stop_reason", "[" * 10**5, "no JSON"),
    ],
)
def test_odd_metadata_are_one_line_without_python(
    tmp_path: Path, name: str, text: str, found: str
) -> None:
    (path,) = export_parquet(simulate_short_run(), tmp_path / "poses.parquet", table="poses")
    table = parquet.read_table(path)
    metadata = {**table.schema.metadata, f"turtlelog.{name}".encode(): text.encode()}
    parquet.write_table(table.replace_schema_metadata(metadata), path)
    said = (
        f"poses.parquet: the metadata turtlelog.{name} are not as turtlelog writes them ({found})"
    )
    with pytest.raises(LogError, match=re.escape(said)):
        import_tables(path)


@pytest.mark.parametrize("more", [0, 1])
def test_a_table_of_more_rows_than_a_small_file_may_have_is_read_back(
    more: int, tmp_path: Path
) -> None:
    count = MOST_ROWS + more
    poses = PoseColumns(
        time_ns=np.arange(count), xy_m=np.zeros((count, 2)), heading_rad=np.zeros(count)
    )
    run = replace(simulate_short_run(), poses=poses)
    written = export_parquet(run, tmp_path / "poses.parquet")
    require_read_back(run, written, None)
    groups = parquet.read_metadata(written[0])
    assert groups.num_row_groups == -(-count // 2**16)
    assert groups.row_group(0).column(0).compression == ("UNCOMPRESSED" if more else "ZSTD")
    with pytest.raises(LogError, match="found other values in x_m of poses"):
        require_read_back(replace(run, poses=replace(poses, xy_m=poses.xy_m + 1)), written, None)
