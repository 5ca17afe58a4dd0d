"""All benchmarks as one table: `python benchmarks/run_all.py [NAME ...] [--write PAGE]`.

Each runs in a process of its own. Takes some minutes; the names of benchmarks choose among them.
"""

import argparse
import os
import platform
import re
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from benchmarks.table import ROOT, WIDTH, Row, format_table, read_row, tell_better_peers

BENCHMARKS: Final = (
    *(
        "commands",
        "many",
        "folder",
        "scale",
        "files",
        "engine",
        "sqlite",
        "memory",
        "writer",
        "loop",
    ),
    *("batch", "measure", "compare", "check", "explain", "show", "hostile"),
)
"""In the order of the table; each is a file `bench_NAME.py`."""

_LIBRARIES: Final = (
    *("numpy", "scipy", "zstandard", "numba", "mcap", "mcap-ros2-support", "rosbags", "rerun-sdk"),
    *("matplotlib", "control", "rtamt", "pyfunnel"),
)
_BEGIN: Final = "<!-- make bench writes from here -->\n"
_END: Final = "<!-- to here -->\n"


def main() -> int:
    """Run what is asked for, print the table, exit with 1 where a benchmark failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(BENCHMARKS))
    parser.add_argument("--share", type=float, default=1.0, help="of the usual sizes; otherwise 1")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the table into this page")
    asked = parser.parse_args()
    unknown = [name for name in asked.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f"expected some of {', '.join(BENCHMARKS)}, found {', '.join(unknown)}")
    if asked.write is not None and (asked.names or asked.share != 1.0):
        parser.error("--write: expected all benchmarks at their whole sizes, found a part")
    rows, failed = [], []
    for name in asked.names or BENCHMARKS:
        started = time.perf_counter()
        try:
            rows += list(run_benchmark(name, asked.share))
        except subprocess.CalledProcessError:
            failed.append(name)
        print(f"{name}: {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
    text = format_report(rows)
    print(text)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
        return 1
    if asked.write is not None:
        asked.write.write_text(replace_report(asked.write.read_text("utf-8"), text), "utf-8")
    return 0


def run_benchmark(name: str, share: float) -> Iterator[Row]:
    """Yield the rows of a benchmark, run in a process of its own."""
    command = [sys.executable, str(ROOT / "benchmarks" / f"bench_{name}.py"), "--json"]
    command += ["--share", str(share)]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
    yield from map(read_row, done.stdout.splitlines())


def format_report(rows: Sequence[Row]) -> str:
    """Return the machine, the table, and what peers do better, in Markdown."""
    aims = [row for row in rows if row.is_met is not None]
    met = sum(row.is_met is True for row in aims)
    better = tell_better_peers(rows) or ["- no job of this table"]
    lines = [describe_machine(), "", format_table(rows), "", f"{met} of {len(aims)} aims are met."]
    return "\n".join([*lines, "", "Peers that do the same for less:", "", *better]) + "\n"


def describe_machine() -> str:
    """Return processor, cores, system and versions, and nothing that names the machine."""
    found = []
    for name in _LIBRARIES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"no {name}")
    python = f"{platform.python_implementation()} {platform.python_version()}"
    machine = f"{read_processor()}, {os.cpu_count()} cores, {platform.system()} {python}"
    return textwrap.fill(f"Taken on: {machine}; {', '.join(found)}.", WIDTH)


def read_processor() -> str:
    """Return the model of the processor, as far as the system tells it."""
    file = Path("/proc/cpuinfo")
    text = file.read_text("utf-8") if file.exists() else ""
    model = re.search(r"^model name\s*: (.+)$", text, re.M)
    return model[1] if model else platform.processor() or platform.machine()


def replace_report(page: str, report: str) -> str:
    """Return a page with another report between its two marks."""
    head, begin, rest = page.partition(_BEGIN)
    _, end, tail = rest.partition(_END)
    if not begin or not end:
        raise ValueError(f"expected the lines {_BEGIN.strip()} and {_END.strip()}, found others")
    return f"{head}{begin}\n{report}\n{end}{tail}"


if __name__ == "__main__":
    sys.exit(main())
