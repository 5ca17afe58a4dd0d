"""A table of the metrics of 2,000 files below a folder, and the same again: nothing has changed.

The first call measures every metric of each file. The second one looks at sizes and times, and
writes what the table held: it must cost a small part of the first, its start included.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.bench_many import link_files
from benchmarks.table import Cost, Row, run_alone, run_apart

FILES = 2_000

TABLE = """
import contextlib, io, resource
from turtlelog.cli.app import main
text = io.StringIO()
with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
    main(["metrics", arguments[0], "-o", arguments[1], "--jobs", "1"])
said["text"] = text.getvalue()
used = resource.getrusage(resource.RUSAGE_SELF)
said["time"] = used.ru_utime + used.ru_stime
"""


def measure(share: float = 1.0) -> Iterator[Row]:
    count = max(1, round(FILES * share))
    with tempfile.TemporaryDirectory() as name:
        folder, table = Path(name) / "runs", str(Path(name) / "table.parquet")
        folder.mkdir()
        link_files(folder, count)
        first, again = (run_apart(TABLE, str(folder), table) for _ in range(2))
    assert f"{count} read, 0 unchanged, 0 cannot" in first["text"], first
    assert f"0 read, {count} unchanged, 0 cannot" in again["text"], again
    yield Row(
        job=f"table of {count:,} files, unchanged",
        value=again["time"],
        peer=Cost("measured", first["time"], is_yardstick=True),
        aim=0.1,  # 2 s of 44 s were measured, of which some 1.3 s are to start and to load pyarrow
    )


if __name__ == "__main__":
    run_alone(measure)
