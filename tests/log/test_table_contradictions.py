"""What a table contradicts is said: times that start again, units, headings, reported rates."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog.log.any_file import read_run, read_trajectory
from turtlelog.log.table_contradictions import find_runs
from turtlelog.run import Run

Values = NDArray[np.float64]
TIME_S = np.linspace(0.0, 20.0, 201)


def drive(turned_rad: float = 3.0, noise_m: float = 0.0) -> tuple[Values, Values, Values]:
    """Return x, y [m] and headings [rad] of a drive along an arc at 0.5 m/s."""
    heading_rad = np.linspace(0.0, turned_rad, len(TIME_S))
    middle_rad = (heading_rad[1:] + heading_rad[:-1]) / 2.0
    rng = np.random.default_rng(1)
    x, y = (
        np.concatenate([[0.0], np.cumsum(0.05 * turn(middle_rad))])
        + rng.normal(0.0, noise_m, len(TIME_S))
        for turn in (np.cos, np.sin)
    )
    return x, y, heading_rad


def read(folder: Path, header: str, *columns: Values) -> Run:
    path = folder / "drive.csv"
    rows = zip(*(column.tolist() for column in columns), strict=True)
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return read_run(path)


ONCE = [*range(40)]


@pytest.mark.parametrize(
    ("times", "runs"),
    [
        (ONCE, [40]),
        ([*ONCE, *ONCE], [40, 40]),
        ([*ONCE, *ONCE, *range(20)], [40, 40, 20]),
        ([*range(3, 43), *ONCE], [40, 40]),  # the second run starts earlier
        ([*range(40, 80), *ONCE], [80]),  # two parts in another order
        ([*ONCE, 5, *range(40, 80)], [81]),  # a row that is late
        ([1, 0, *range(2, 40)], [40]),
        ([*range(20, 40), *range(10, 20), *range(40, 60)], [50]),
        ([*range(10), *range(10)], [10, 10]),  # 10 rows make a run
        ([*range(10), *range(9)], [19]),
        ([*range(9), *range(10)], [19]),
        ([*ONCE, *range(19, 59)], [40, 40]),  # back to half of the run
        ([*ONCE, *range(20, 60)], [80]),
    ],
)
def test_times_that_start_again_begin_a_run(times: list[int], runs: list[int]) -> None:
    found = find_runs(np.array(times, dtype=np.int64))
    assert [rows.stop - rows.start for rows in found] == runs


def test_one_of_two_runs_in_a_table_is_read(tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    twice = [np.concatenate([one, two]) for one, two in ((TIME_S, TIME_S), (x, x + 7), (y, y))]
    run = read(tmp_path, "t,x,y,yaw", *twice, np.concatenate([heading_rad, heading_rad]))
    assert run.poses.xy_m[:, 0].tolist() == x.tolist()
    assert run.notes["sorted_rows"] == "0"
    assert run.notes["restarts"] == (
        "run 1 of 2 in the table is read, lines 2 to 202; times start again at line 203, and 201"
        " rows are left out: save each run to a file of its own"
    )
    assert "restarts" in read_trajectory(tmp_path / "drive.csv").notes
