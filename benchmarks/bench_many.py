"""The usual metrics of 10,000 usual files: processor time a file, and the peak of the processes.

The files are the paper's four recordings, under 10,000 names of hard links: each is opened, read
and measured like any other; that all are in the memory of the system costs nothing less, since
only processor time counts. The bound is to read a file and decompress its chunks.
"""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.bench_engine import find_chunks, unpack_alone
from benchmarks.bench_files import decode_rows
from benchmarks.table import ROOT, Cost, Row, run_alone, run_apart, time_calls

FILES = 10_000
FEW = 1_000
JOBS = 2
RECORDINGS = sorted((ROOT / "recordings" / "paper").glob("*.mcap"))

METRICS = """
import contextlib, io, resource
from turtlelog.cli.app import main
files = sorted(pathlib.Path(arguments[0]).glob("*.mcap"))[:int(arguments[1])]
text = io.StringIO()
with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
    main(["metrics", "--jobs", arguments[2], *map(str, files)])
said["rows"] = sum(line.startswith("run0") for line in text.getvalue().splitlines())
used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
said["time"] = sum(found.ru_utime + found.ru_stime for found in used)
said["peak"] = max(read_peak(), used[1].ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6)
"""


def link_files(folder: Path, count: int) -> None:
    """Make that many names of copies of the recordings."""
    names = [folder / f"run{number:05}.mcap" for number in range(count)]
    for number, name in enumerate(names):
        if number < len(RECORDINGS):
            shutil.copyfile(RECORDINGS[number], name)
        else:
            name.hardlink_to(names[number % len(RECORDINGS)])


def measure(share: float = 1.0) -> Iterator[Row]:
    many, few = round(FILES * share), round(FEW * share)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        link_files(folder, many)
        less, more = (run_apart(METRICS, name, str(count), str(JOBS)) for count in (few, many))
    assert more["rows"] == many, more
    chunks = [(path, find_chunks(path)) for path in RECORDINGS]
    bound, decoder = time_calls(
        lambda: [unpack_alone(*found) for found in chunks],
        lambda: [decode_rows(path) for path in RECORDINGS],
    )
    yield Row(
        job=f"metrics of {many:,} files, a file",
        value=more["time"] / many,
        peer=Cost("mcap_ros2", decoder / len(RECORDINGS)),
        bound=Cost("unpack", bound / len(RECORDINGS)),
        aim=0.003,
        aim_of="value",
    )
    yield Row(
        job=f"peak of metrics, {many:,} files",
        value=more["peak"],
        unit="MB",
        peer=Cost(f"{few:,} files", less["peak"], is_yardstick=True),
        aim=2,  # for ten times the files: what is kept of each file is small
    )


if __name__ == "__main__":
    run_alone(measure)
