"""Every reader of text is fed lines of 4 MB, and takes time and memory in proportion to them."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

import turtlelog as tl
from tests.torture.kills import ROOT
from turtlelog.check import load_spec
from turtlelog.errors import TurtlelogError
from turtlelog.escapes import guard_cell
from turtlelog.log.engine.idl import convert_idl
from turtlelog.log.engine.message_types import read_type
from turtlelog.log.ros2.bag_files import parse_bag_metadata
from turtlelog.log.table_columns import show_column

SIZES = {100_000: 0.7, 4 * 10**6: 3.0}
"""Letters, and how long a text of so many takes at most [s]: ten times what it takes on a quiet
machine. What takes the square of its length took 1 s and more of 100,000 already."""

FILLS = (" ", "'", '"', "[", "(", "9", "\\", "a_", "[{", "9.", "/*", '\\"', "# ", "a [", ",")
BAG = "rosbag2_bagfile_information:\n  storage_identifier: mcap\n"
PLACES = {
    "yaml": (
        *("{}", BAG + "  {}", BAG + "  files: {}", BAG + "  relative_file_paths: [{}"),
        *(BAG + "  relative_file_paths:\n    - '{}'", BAG + "  compression_mode: '{}"),
    ),
    "csv": (
        *("{}", "{}\n1,2,3,4\n", "t,x,y,heading\n0,1,2,{}\n", "# {}\nt,x,y,heading\n0,1,2,3\n"),
        "t,x,y,heading\n2020-01-01T00:00:00{}x,0,0,0\n",
    ),
    "tum": ("{}", "t x y {}\n0 1 2 3\n", "{} 1 1 0 0 0 0 1\n"),
    "tsv": ("t\tx\ty\theading [{}\n0\t1\t2\t3\n", "time_ns,x_m,y_m,heading_rad\n1,2,3,{}\n"),
    "paper": ("target_angle_rad,{}\n1,2\n",),
    "json": ("{}", '{{"data": {{"time": [{}', '{{"metadata": {{"experiment_name": "{}'),
    "scenario": ("{}", 'name = "{}"', "[{}]\n", "a = [{}"),
    "specification": ("{}", '[checks]\na = "{}"', "checks = {}"),
    "ros2msg": ("{}", "float64 {}\n", "float64[{}] x\n", "float64 x\n{}", "===\n{}MSG: a/B\n"),
    "idl": ("module a {{ {}", "{}", "struct a {{ long {}; }};"),
    "cells": ("{}", "{}x"),
}


def list_readers(folder: Path) -> dict[str, Callable[[str], object]]:
    def in_file(name: str, read: Callable[[Path], object]) -> Callable[[str], object]:
        path = folder / name
        return lambda text: (path.write_text(text, "utf-8"), read(path))

    return {
        "yaml": parse_bag_metadata,
        **{kind: in_file(f"log.{kind}", tl.read_run) for kind in ("csv", "tum", "tsv", "json")},
        "paper": in_file("paper.csv", tl.read_run),
        "scenario": in_file("scenario.toml", tl.load_scenario),
        "specification": in_file("spec.toml", load_spec),
        # The longest schemas that are read.
        "ros2msg": lambda text: read_type("a/B", text[: 10**6]),
        "idl": lambda text: convert_idl("a/B", text[:500_000]),
        "cells": guard_cell,
    }


def list_texts(kind: str, size: int) -> Iterator[str]:
    # All of 4 MB would take a minute: of these the first place of each reader, filled in four ways.
    is_large = size > 10**6
    for place in PLACES[kind][: 1 if is_large else None]:
        for fill in FILLS[:: 4 if is_large else 1]:
            yield place.format(fill * (size // len(fill)))


@pytest.mark.everyday(
    "idl-4000000",
    "specification-100000",
    "csv-4000000",
    "json-4000000",
    "yaml-4000000",
    "ros2msg-4000000",
)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", PLACES)
def test_a_long_line_takes_little_time_and_one_line_says_what_is_wrong(
    kind: str, size: int, tmp_path: Path
) -> None:
    """Lines of the greatest length are read, to bound their time."""
    read = list_readers(tmp_path)[kind]
    for text in list_texts(kind, size):
        begun = time.process_time()
        said = find_error(read, text)
        assert time.process_time() - begun < SIZES[size], text[:80]
        assert "\n" not in said
        assert len(said) < 5000


def find_error(read: Callable[[str], object], text: str) -> str:
    try:
        read(text)
    except TurtlelogError as err:
        return str(err)
    return ""


PEAK = """
import pathlib, re, sys
from turtlelog.cli.app import main
try:
    main(["info", sys.argv[1]])
except SystemExit:
    status = pathlib.Path("/proc/self/status").read_text()
    print(int(re.search(r"VmHWM:\\s+(\\d+)", status)[1]) / 1024, file=sys.__stderr__)
"""

QUOTES = "''" * 3_900_000
BOMBS: dict[str, tuple[str, Callable[[], str]]] = {
    "quotes": ("metadata.yaml", lambda: f"{BAG}  relative_file_paths:\n    - '{QUOTES}'"),
    "lists": ("log.json", lambda: '{"data": {"time": [' + "[]," * 3_000_000),
    "rows": ("log.csv", lambda: "t,x,y,heading\n" + "0,0,0,0\n" * 1_200_000),
}


@pytest.mark.everyday("quotes", "lists")
@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak memory from /proc")
@pytest.mark.parametrize("kind", BOMBS)
def test_a_small_file_takes_less_than_256_mb(kind: str, tmp_path: Path) -> None:
    """A process reads a large file, to bound its memory."""
    name, build = BOMBS[kind]
    (tmp_path / name).write_text(build(), "utf-8")
    path = tmp_path if name == "metadata.yaml" else tmp_path / name
    command = [sys.executable, "-c", PEAK, str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert float(done.stderr.splitlines()[-1]) < 256.0


def write_rows(path: Path, rows: int) -> Path:
    path.write_text("t,x,y,heading\n" + "".join(f"{row},0,0,0\n" for row in range(rows)), "utf-8")
    return path


def test_a_table_of_text_has_as_many_rows_as_one_of_parquet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("turtlelog.log.engine.limits.MOST_ROWS", 50)
    assert len(tl.read_run(write_rows(tmp_path / "log.csv", 50)).poses) == 50
    with pytest.raises(TurtlelogError, match="has more than 50 rows; 50 are the most"):
        tl.read_run(write_rows(tmp_path / "log.csv", 51))


def write_columns(path: Path, count: int) -> Path:
    names = ["t", "x", "y", "heading", *(f"c{number}" for number in range(count - 4))]
    path.write_text(f"{','.join(names)}\n{','.join('1' * count)}\n", "utf-8")
    return path


def test_only_columns_that_are_listed_take_time_to_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = list[int]()

    def show(names: Sequence[str], place: int) -> str:
        places.append(place)
        return show_column(names, place)

    monkeypatch.setattr("turtlelog.log.plain_tables.show_column", show)
    run = tl.read_run(write_columns(tmp_path / "log.csv", 1000))
    assert run.notes["columns"].partition("; not read: ")[2].startswith("c0, c1, c2, ")
    assert max(places) < 4 + 160  # letters are listed


@pytest.mark.thorough
def test_a_table_has_up_to_10_000_columns(tmp_path: Path) -> None:
    assert len(tl.read_run(write_columns(tmp_path / "log.csv", 10_000)).poses) == 1
    with pytest.raises(TurtlelogError, match=r"more than 10,000 columns\. Write fewer columns"):
        tl.read_run(write_columns(tmp_path / "log.csv", 10_001))
