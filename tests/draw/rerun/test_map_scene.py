from pathlib import Path

import pyarrow as pa
from rerun.chunk import RrdReader

from tests.sweep.swept_tables import write_table
from tests.sweep.test_gain_borders import GRID, view_table
from turtlelog.draw import write_map_rrd
from turtlelog.sweep import find_loop_limits


def read_texts(path: Path, entity: str) -> list[str]:
    found: list[str] = []
    for chunk in RrdReader(path).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        for field, column in zip(batch.schema, batch.columns, strict=True):
            if field.name.endswith(":labels"):
                found += pa.array(column).flatten().to_pylist()
    return found


def test_each_cell_names_its_value_and_its_row(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet",
        GRID,
        {"translate.overshoot": lambda delay, kp: kp + delay if kp < 24 else "too_short"},
        units={"translate.overshoot": "%"},
    )
    view = view_table(path)
    write_map_rrd(view, find_loop_limits(view), tmp_path / "t.rrd")
    texts = read_texts(tmp_path / "t.rrd", "/translate.overshoot/rows")
    assert len(texts) == 60
    held = "loop.transport_delay_ticks = 3, law.kp_linear = 4"
    assert f"7 %\nrow 13: {held}" in texts
    assert sum(text.startswith("no value: too short\nrow ") for text in texts) == 5
    entities = {chunk.entity_path for chunk in RrdReader(tmp_path / "t.rrd").stream()}
    assert "/translate.overshoot/cells" in entities
    assert any("instability" in entity for entity in entities)
