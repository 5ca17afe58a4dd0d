"""The benchmarks run, and their table says what was measured."""

import re
import sys
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from benchmarks import bench_engine, bench_hostile, run_all, table
from benchmarks.table import Cost, Row, format_table, tell_better_peers

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "performance.md").read_text("utf-8")
ROWS = [
    Row(job="read", value=0.160, bound=Cost("unpack", 0.1), peer=Cost("other", 0.15), aim=1.6),
    Row(job="copy", value=0.161, bound=Cost("unpack", 0.1), aim=1.6),
    Row(job="plot", value=5.0, aim=5.0, aim_of="value"),
    Row(job="plot", value=5.01, peer=Cost("other", 10.0), aim=5.0, aim_of="value"),
    Row(job="size", value=44.1, unit="MB"),
    Row(job="load", value=3.0, peer=Cost("other", 1.0, is_yardstick=True), aim=2.9),
]


def test_table_says_ratio_aim_and_whether_it_is_met() -> None:
    assert format_table(ROWS).splitlines() == [
        "| job  | turtlelog |         peer |         bound |   ratio |    aim | met |",
        "| ---- | --------: | -----------: | ------------: | ------: | -----: | --: |",
        "| read |    160 ms | other 150 ms | unpack 100 ms |    1.60 |    1.6 | yes |",
        "| copy |    161 ms |              | unpack 100 ms |    1.61 |    1.6 |  no |",
        "| plot |    5.00 s |              |               |         | 5.00 s | yes |",
        "| plot |    5.01 s | other 10.0 s |               | 0.501 p | 5.00 s |  no |",
        "| size |   44.1 MB |              |               |         |        |     |",
        "| load |    3.00 s | other 1.00 s |               |  3.00 y |    2.9 |  no |",
    ]


def test_only_peers_that_do_the_same_for_less_are_told() -> None:
    assert tell_better_peers(ROWS) == ["- read: other takes 150 ms, turtlelog 160 ms."]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0 us"), (9.996e-4, "1000 us"), (0.001, "1.00 ms"), (1.0, "1.00 s"), (1234.5, "1234 s")],
)
def test_times_have_three_digits(value: float, text: str) -> None:
    assert table.format_value(value, "s") == text


@pytest.mark.thorough
def test_calls_take_turns_and_the_least_time_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    clock = iter([0.0, 3.0, 3.0, 4.0, 4.0, 6.0, 6.0, 8.0])
    monkeypatch.setattr(time, "process_time", lambda: next(clock))
    times = table.time_calls(lambda: calls.append("a"), lambda: calls.append("b"), repeats=2)
    assert calls == ["a", "b", "a", "b"]
    assert times == [2.0, 1.0]


def test_reading_is_timed_in_a_fresh_process(tmp_path: Path) -> None:
    """A process starts and loads the readers."""
    bench_engine.write_file(tmp_path / "some.mcap", 100)
    said = table.run_apart(bench_engine.READ, str(tmp_path / "some.mcap"))
    assert 0.0 < said["unpack"] < said["read"][0]


@pytest.mark.everyday("writer")
@pytest.mark.parametrize("name", ["loop", "measure", "writer"])
def test_benchmark_yields_rows(name: str) -> None:
    rows = list(import_module(f"benchmarks.bench_{name}").measure(3e-3))
    assert all(row.value > 0.0 for row in rows)
    assert all(cost.value > 0.0 for row in rows for cost in (row.peer, row.bound) if cost)


@pytest.mark.thorough
def test_benchmark_in_a_process_of_its_own_hands_over_its_rows() -> None:
    """A process starts and loads the program."""
    jobs = [row.job for row in run_all.run_benchmark("loop", 1e-3)]
    assert jobs[:2] == ["simulate, a sample", "replay the loop, a sample"]


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="limits the memory of a process")
def test_a_hostile_file_is_read_in_a_process_of_its_own() -> None:
    [taken] = bench_hostile.try_file("sqlite: column rowid", ["convert --recover"])
    assert (taken.code, taken.is_kept) == (0, True)
    assert not replace(taken, memory_mb=256.0).is_kept
    assert not replace(taken, code=2, said="one\ntwo\n").is_kept
    assert replace(taken, code=2, said="one\n", memory_mb=255.0, cpu_s=9.9).is_kept


def test_every_benchmark_is_in_the_table() -> None:
    files = (ROOT / "benchmarks").glob("bench_*.py")
    assert sorted(run_all.BENCHMARKS) == sorted(file.stem.removeprefix("bench_") for file in files)


def test_page_holds_a_table_that_is_readable_and_explains_its_peers() -> None:
    found = re.findall(r"^\| .+ \|$", PAGE.partition("## The table")[2], re.M)
    assert re.split(r"[| ]+", found[0]) == re.split(r"[| ]+", format_table([]).splitlines()[0])
    assert max(map(len, found)) <= table.WIDTH
    explained = re.findall(
        r"`([^`]+)`", PAGE.partition("## Peers,")[2].partition("## The table")[0]
    )
    for line in found[2:]:
        for cell in line.split("|")[3:5]:
            name = cell.strip().rsplit(maxsplit=2)[0] if cell.strip() else "unpack"
            assert name in explained


def test_report_replaces_the_one_that_stands_on_the_page() -> None:
    once = run_all.replace_report(PAGE, "| a |\n")
    assert run_all.replace_report(once, "| b |\n") == once.replace("| a |", "| b |")
    with pytest.raises(ValueError, match="expected the lines"):
        run_all.replace_report("no marks", "| a |")


def test_report_names_no_host() -> None:
    import platform

    assert platform.node() not in run_all.describe_machine()
