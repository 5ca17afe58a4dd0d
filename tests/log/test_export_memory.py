"""How much memory a table takes while it is written: a long run has a million rows."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.log.runs import simulate_short_run
from turtlelog.log import export_csv, export_tum
from turtlelog.run import PoseColumns, Run

ROWS = 20_000


@pytest.mark.parametrize(("export", "suffix"), [(export_csv, ".csv"), (export_tum, ".tum")])
def test_a_table_is_written_with_less_than_100_bytes_a_row(
    export: Callable[[Run, Path], object], suffix: str, tmp_path: Path
) -> None:
    numbers = np.arange(float(ROWS))
    poses = PoseColumns(
        time_ns=np.arange(ROWS), xy_m=np.column_stack([numbers] * 2), heading_rad=numbers / ROWS
    )
    run = replace(simulate_short_run(), poses=poses)
    tracemalloc.start()
    export(run, tmp_path / f"a{suffix}")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len((tmp_path / f"a{suffix}").read_text().splitlines()) in (ROWS, ROWS + 1)
    assert peak < 100 * ROWS
