import signal
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

import turtlelog as tl
from tests.fresh_process import run_command
from turtlelog.sweep import (
    RowRecords,
    Sweep,
    build_plan,
    load_row_scenario,
    prepare_sweep,
    read_result_table,
    result_table,
    run_sweep,
    sweep_rows,
)
from turtlelog.sweep.partial_table import KeptParts, name_partial

GRID = ("law.kp_linear=0.5:4:0.5", "loop.transport_delay_ticks=0:4")
SWEEP = ("sweep", "paper-kp4", "--grid", GRID[0], "--grid", GRID[1], "--metric", "final.*")


def prepare(*grid: str, metrics: str = "final.*", records: RowRecords | None = None) -> Sweep:
    base = tl.override_scenario(tl.load_scenario("paper-kp4"), {"loop.loss_probability": 0.05})
    return prepare_sweep(base, build_plan(grid or GRID), metrics=[metrics], records=records)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the table of a sweep that nothing interrupted."""
    output = tmp_path_factory.mktemp("whole") / "t.parquet"
    run_sweep(prepare(), output, jobs=1)
    return output.read_bytes()


def stop_after(count: int) -> Callable[[int], None]:
    def watch(done: int) -> None:
        if done >= count:
            raise KeyboardInterrupt

    return watch


def interrupt(sweep: Sweep, output: Path, *, after: int) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep, output, jobs=1, watch=stop_after(after))


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the list of all rows that are simulated from here on, in this process."""
    rows: list[int] = []

    simulate_rows = sweep_rows.simulate_rows

    def count_rows(chunk: sweep_rows.RowChunk) -> sweep_rows.RowResults:
        rows.extend(range(chunk.first, chunk.first + len(chunk.values)))
        return simulate_rows(chunk)

    monkeypatch.setattr(sweep_rows, "simulate_rows", count_rows)
    return rows


def test_interrupted_sweep_goes_on_with_nothing_repeated_or_lost(
    whole: bytes, simulated: list[int], tmp_path: Path
) -> None:
    output = tmp_path / "t.parquet"
    interrupt(prepare(), output, after=1)
    interrupt(prepare(), output, after=15)
    assert not output.exists()
    assert name_partial(output).exists()
    run_sweep(prepare(), output, jobs=1)
    assert sorted(simulated) == list(range(40))
    assert output.read_bytes() == whole
    assert not name_partial(output).exists()


def test_finished_sweep_is_not_simulated_again(simulated: list[int], tmp_path: Path) -> None:
    output = tmp_path / "t.parquet"
    first = run_sweep(prepare("law.kp_linear=-1:2"), output)
    before, rows = output.read_bytes(), len(simulated)
    assert run_sweep(prepare("law.kp_linear=-1:2"), output) == first
    assert (output.read_bytes(), len(simulated)) == (before, rows)


@pytest.mark.parametrize("lost", [1, 9, 200])
def test_part_that_was_cut_off_while_it_was_written_is_done_again(
    lost: int, whole: bytes, simulated: list[int], tmp_path: Path
) -> None:
    output = tmp_path / "t.parquet"
    interrupt(prepare(), output, after=15)
    partial = name_partial(output)
    partial.write_bytes(partial.read_bytes()[:-lost])
    run_sweep(prepare(), output, jobs=1)
    assert output.read_bytes() == whole
    assert len(simulated) > 40


@pytest.mark.thorough
def test_partial_file_that_was_cut_in_its_head_is_begun_again(whole: bytes, tmp_path: Path) -> None:
    output = tmp_path / "t.parquet"
    interrupt(prepare(), output, after=1)
    partial = name_partial(output)
    for size in (0, 5, 20, 60):
        partial.write_bytes(partial.read_bytes()[:size])
        run_sweep(prepare(), output, jobs=1)
        assert output.read_bytes() == whole
        output.unlink()
        interrupt(prepare(), output, after=1)


def start(folder: Path, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "turtlelog", *SWEEP, *words],
        cwd=folder,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


NOISE = ("--set", "loop.loss_probability=0.05", "--jobs", "2")


@pytest.fixture(scope="module")
def whole_of_command(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the table of the command, which nothing ended."""
    folder = tmp_path_factory.mktemp("whole")
    done = run_command(*SWEEP, "-o", "t.parquet", *NOISE, folder=folder)
    assert done.stdout.startswith("40 runs over ")
    return (folder / "t.parquet").read_bytes()


@pytest.mark.everyday("2")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_sweep_that_is_ended_from_outside_goes_on(
    how: signal.Signals, whole_of_command: bytes, tmp_path: Path
) -> None:
    """A command starts, is ended, and starts again."""
    ended = start(tmp_path, "-o", "t.parquet", *NOISE)
    partial = tmp_path / "t.parquet.partial"
    limit = time.monotonic() + 30
    while not (partial.exists() and partial.stat().st_size > 900) and time.monotonic() < limit:
        time.sleep(0.002)
    ended.send_signal(how)
    _, err = ended.communicate(timeout=30)
    if how == signal.SIGINT:
        assert ended.returncode == 130
        assert "of 40 rows are done; the same command goes on\n" in err
    assert partial.exists()
    again = run_command(*SWEEP, "-o", "t.parquet", *NOISE, folder=tmp_path)
    assert again.stdout.startswith("40 runs over ")
    assert "40 runs over " in again.stdout
    assert (tmp_path / "t.parquet").read_bytes() == whole_of_command


@pytest.mark.thorough
@pytest.mark.everyday("of the table")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
@pytest.mark.parametrize(
    ("most_bytes", "message"),
    [
        (
            1200,
            "t.parquet.partial: expected room for what is done, found: File too large; the same"
            " command goes on from there",
        ),
        # The table has 9839; what is done the more, the slower the machine: its parts are shorter.
        (9000, "t.parquet: cannot be written: File too large"),
    ],
    ids=["of the rows", "of the table"],
)
def test_full_disk_is_one_line_and_the_sweep_goes_on(
    most_bytes: int, message: str, tmp_path: Path
) -> None:
    """A command starts on a full disk, and once more."""
    code = (
        "import resource, signal\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({most_bytes}, {most_bytes}))\n"
        "from turtlelog.cli.app import main\n"
        "main()\n"
    )
    words = [*SWEEP, "--jobs", "1", "-o", "t.parquet"]
    full = subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert full.returncode == 2
    assert full.stderr == f"turtlelog: error: {message}\n"
    again = run_command(*words, folder=tmp_path)
    assert again.stdout.startswith("40 runs over ")
    assert "40 runs over " in again.stdout


def test_results_and_partial_file_of_another_sweep_are_refused(tmp_path: Path) -> None:
    output = tmp_path / "t.parquet"
    interrupt(prepare(), output, after=1)
    with pytest.raises(
        tl.errors.SweepError, match="found what is done of a sweep with another plan"
    ):
        run_sweep(prepare("law.kp_linear=1:2"), output)
    run_sweep(prepare(), output)
    with pytest.raises(
        tl.errors.SweepError, match="found the results of a sweep with another choice of"
    ):
        run_sweep(prepare(metrics="run.*"), output)


@pytest.mark.parametrize("name", ["t.parquet", "t.parquet.partial"])
def test_file_that_is_no_sweeps_is_not_replaced(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"somebody's\n")
    with pytest.raises((tl.errors.SweepError, tl.errors.LogError), match=name):
        run_sweep(prepare("law.kp_linear=1:2"), tmp_path / "t.parquet")
    assert (tmp_path / name).read_bytes() == b"somebody's\n"


def test_changed_code_of_the_law_is_another_sweep(tmp_path: Path) -> None:
    law = tmp_path / "own.py"
    law.write_text(_LAW)
    base = tl.override_scenario(
        tl.load_scenario("textbook"), {"law.kind": f"{law}:Own", "max_duration_s": 1.0}
    )
    plan = build_plan(["goal.x_m=2:4"])
    output = tmp_path / "t.parquet"
    interrupt(prepare_sweep(base, plan), output, after=1)
    law.write_text(f"{_LAW}# changed\n")
    with pytest.raises(tl.errors.SweepError, match="of a sweep with another code of the law"):
        run_sweep(prepare_sweep(base, plan), output)


_LAW = """
from dataclasses import dataclass
from turtlelog.laws import Decision
class Own:
    @dataclass(frozen=True)
    class Parameters:
        gain: float = 1.0
    def __init__(self, parameters): pass
    def reset(self, start, goal, path=None): pass
    def step(self, time_ns, pose): return Decision(speed_m_s=0.1, turn_rate_rad_s=0.2)
"""


def test_two_sweeps_into_one_file_at_once_are_refused(tmp_path: Path) -> None:
    output = tmp_path / "t.parquet"
    sweep = prepare("law.kp_linear=1:2")
    partial = KeptParts(output, sweep.list_facts(), sweep_rows.RowResults)
    try:
        with pytest.raises(tl.errors.SweepError, match="another command is writing it"):
            run_sweep(sweep, output)
    finally:
        partial.close()
    run_sweep(sweep, output)
    assert output.exists()


def test_folder_of_recordings_must_be_new_but_where_a_sweep_goes_on(tmp_path: Path) -> None:
    folder, output = tmp_path / "runs", tmp_path / "t.parquet"
    sweep = prepare("law.kp_linear=1:4", records=RowRecords(folder=str(folder)))
    interrupt(sweep, output, after=1)
    run_sweep(sweep, output)
    assert [path.name for path in sorted(folder.iterdir())] == [
        f"row-00000{row}.mcap" for row in range(4)
    ]
    with pytest.raises(
        tl.errors.SweepError, match="expected a new folder for recordings, found one with"
    ):
        run_sweep(sweep, tmp_path / "other.parquet")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["runs", "t.parquet"]


def test_what_a_killed_sweep_left_half_written_is_gone_when_it_goes_on(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    sweep = prepare("law.kp_linear=1:4", records=RowRecords(folder=str(folder)))
    interrupt(sweep, tmp_path / "t.parquet", after=1)
    (folder / ".turtlelog-0123456789ab.part").write_bytes(b"half")
    (folder / ".notes.part").write_bytes(b"of the user")
    run_sweep(sweep, tmp_path / "t.parquet")
    hidden = [path.name for path in folder.iterdir() if path.name.startswith(".")]
    assert hidden == [".notes.part"]


def test_parts_are_whole_wherever_the_file_was_cut(tmp_path: Path) -> None:
    output, facts, parts = tmp_path / "t.parquet", {"plan": "x"}, ["a", "bb" * 40, "c"]
    kept = KeptParts(output, facts, str)
    ends = [kept.path.stat().st_size]
    for part in parts:
        kept.add(part)
        ends.append(kept.path.stat().st_size)
    kept.close()
    content = kept.path.read_bytes()
    for size in range(len(content) + 1):
        kept.path.write_bytes(content[:size])
        again = KeptParts(output, facts, str)
        whole = max(0, sum(end <= size for end in ends) - 1)
        assert [again.read(place) for place in again.places] == parts[:whole]
        assert again.was_begun == (size >= ends[0])
        again.add("new")
        again.close()
        third = KeptParts(output, facts, str)
        assert [third.read(place) for place in third.places] == [*parts[:whole], "new"]
        third.close()


def test_what_is_kept_of_other_facts_is_refused_or_begun_anew(tmp_path: Path) -> None:
    def refuse(path: Path, found: object) -> None:
        raise tl.errors.SweepError(f"{path.name}: {found}")

    output = tmp_path / "t.parquet"
    kept = KeptParts(output, {"plan": "x"}, str)
    kept.add("a")
    kept.close()
    with pytest.raises(tl.errors.SweepError, match=r"t\.parquet\.partial: {'plan': 'x'}"):
        KeptParts(output, {"plan": "y"}, str, require=refuse)
    same = KeptParts(output, {"plan": "x"}, str, require=refuse)
    assert same.places
    same.close()
    other = KeptParts(output, {"plan": "y"}, str)
    assert not other.places
    assert not other.was_begun
    other.close()


def test_part_that_is_damaged_ends_what_was_kept(tmp_path: Path) -> None:
    kept = KeptParts(tmp_path / "t.parquet", {}, str)
    places = [kept.add(part) for part in "abc"]
    kept.close()
    content = bytearray(kept.path.read_bytes())
    content[places[1] + 9] ^= 0xFF
    kept.path.write_bytes(content)
    again = KeptParts(tmp_path / "t.parquet", {}, str)
    assert again.places == places[:1]
    again.close()


@pytest.mark.thorough
@pytest.mark.parametrize("cells", [1, 40, 200])
def test_table_of_many_groups_holds_what_one_group_does(
    cells: int, whole: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    output = tmp_path / "t.parquet"
    with monkeypatch.context() as patched:
        patched.setattr(result_table, "_CELLS_GROUPED", cells)
        found = run_sweep(prepare(), output, jobs=1)
        assert run_sweep(prepare(), output, jobs=1) == found  # now as the table tells
    (tmp_path / "whole.parquet").write_bytes(whole)
    one, many = (
        read_result_table(tmp_path / name, kind="sweep") for name in ("whole.parquet", "t.parquet")
    )
    assert many == one
    assert many.columns[0].cells == list(range(40))
    assert load_row_scenario(output, 39) == load_row_scenario(tmp_path / "whole.parquet", 39)


@pytest.mark.parametrize("count", [2**23 - 5, 2**23, 2**25])
def test_part_of_equal_bytes_is_read_back_however_long(tmp_path: Path, count: int) -> None:
    kept = KeptParts(tmp_path / "t.parquet", {}, str)
    place = kept.add("a" * count)
    assert kept.read(place) == "a" * count
    kept.close()


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(zlib.compress(b"\xdb\x00\x80\x00\x00" + b"a" * 2**23), id="longer"),
        pytest.param(zlib.compress(b"\xc0"), id="another type"),
        pytest.param(b"no zlib", id="not packed"),
    ],
)
def test_part_that_no_sweep_wrote_is_one_line(tmp_path: Path, data: bytes) -> None:
    kept = KeptParts(tmp_path / "t.parquet", {}, str)
    place = kept.add("a")
    with kept.path.open("r+b") as stream:
        stream.seek(place)
        stream.write(struct.pack("<II", len(data), zlib.crc32(data)) + data)
    with pytest.raises(
        tl.errors.SweepError, match=r"partial: a part .* Delete the file, then type"
    ):
        kept.read(place)
    kept.close()
