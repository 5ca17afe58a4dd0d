"""Small files that ask for much: what `info`, `metrics`, `convert --recover` take.

A file of less than 10 MB takes less than 256 MB and 10 s of processor time in every command, and
ends with an answer or one line. Alone this prints a row a file, or those of the names it is given;
in the table of all benchmarks stands the worst of each command.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmarks.table import ROOT, Row, run_alone

COMMANDS: Final = ("info", "metrics", "convert --recover")
MOST_BYTES: Final = 10_000_000
MOST_MB: Final = 256
MOST_S: Final = 10

_ADDRESS_BYTES: Final = 8 * 2**30
_PATIENCE_S: Final = 60
"""What a fault may take of the machine: address space, and processor time or twice as much."""

_MAKE: Final = """
import pathlib, sys
from benchmarks.hostile_files import FILES
print(FILES[sys.argv[1]](pathlib.Path(sys.argv[2])))
"""

# The peak that is told of a process includes that of the one that started it: this one is small.
_RUN: Final = """
import json, os, resource, subprocess, sys, threading
space, patience = int(sys.argv[1]), int(sys.argv[2])
def limit():
    resource.setrlimit(resource.RLIMIT_AS, (space, space))
    resource.setrlimit(resource.RLIMIT_CPU, (patience, patience + 1))
process = subprocess.Popen(
    sys.argv[3:], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    preexec_fn=limit,
)
watch = threading.Timer(2 * patience, process.kill)
watch.start()
said = process.stderr.read().decode(errors="replace")
_, status, used = os.wait4(process.pid, 0)
watch.cancel()
unit = 1 if sys.platform == "darwin" else 1024
print(json.dumps({
    "code": os.waitstatus_to_exitcode(status),
    "cpu_s": used.ru_utime + used.ru_stime,
    "memory_mb": used.ru_maxrss * unit / 1e6,
    "said": said,
}))
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """What a command took.

    Attributes:
        file: The name of the file in `FILES`.
        size: Of all that was made [bytes].
        command: Which.
        code: Its exit code; below 0 the signal that ended it.
        cpu_s: Processor time [s].
        memory_mb: Peak of its memory [MB].
        said: On stderr.
    """

    file: str
    size: int
    command: str
    code: int
    cpu_s: float
    memory_mb: float
    said: str

    @property
    def is_kept(self) -> bool:
        """Return whether the promise holds: bounded, and an answer or one line."""
        is_bounded = self.cpu_s < MOST_S and self.memory_mb < MOST_MB and self.size < MOST_BYTES
        is_line = self.code == 0 or (self.code == 2 and self.said.count("\n") == 1)
        return is_bounded and is_line


def try_file(name: str, commands: Sequence[str] = COMMANDS) -> Iterator[Taken]:
    """Make a file and yield what each command takes of it, in a process of its own."""
    with tempfile.TemporaryDirectory() as made, tempfile.TemporaryDirectory() as other:
        path = _run_python(_MAKE, name, made).strip()
        size = sum(found.lstat().st_size for found in Path(made).rglob("*") if not found.is_dir())
        for command in commands:
            output = ["-o", f"{other}/out.mcap"] if command == "convert --recover" else []
            words = [sys.executable, "-m", "turtlelog", *command.split(), path, *output]
            limits = str(_ADDRESS_BYTES), str(_PATIENCE_S)
            found = json.loads(_run_python(_RUN, *limits, *words))
            yield Taken(file=name, size=size, command=command, **found)
            shutil.rmtree(f"{other}/out.mcap", ignore_errors=True)
            Path(f"{other}/out.mcap").unlink(missing_ok=True)


def _run_python(code: str, *words: str) -> str:
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=env
    ).stdout


def measure(share: float = 1.0) -> Iterator[Row]:
    """Yield the most that each command takes of any file; `share` takes some of the files."""
    from benchmarks.hostile_files import FILES

    names = list(FILES)[:: max(1, round(1 / share))]
    taken = [found for name in names for found in try_file(name)]
    for command in COMMANDS:
        of_command = [found for found in taken if found.command == command]
        job = f"hostile: {command}"
        slowest = max(found.cpu_s for found in of_command)
        largest = max(found.memory_mb for found in of_command)
        yield Row(job=job, value=slowest, aim=MOST_S, aim_of="value")
        yield Row(job=job, value=largest, unit="MB", aim=MOST_MB, aim_of="value")


def print_files(names: Sequence[str]) -> int:
    """Print a row a file whose name has one of some words in it; return how many break it."""
    from benchmarks.hostile_files import FILES

    heads = "".join(f"{command:>24}" for command in COMMANDS)
    print(f"{'file':42}{'MB':>6}{heads}   (s, MB, exit code; * breaks the promise)")
    broken = 0
    for name in FILES:
        if names and not any(word in name for word in names):
            continue
        taken = list(try_file(name))
        cells = "".join(
            f"{found.cpu_s:9.2f} s{found.memory_mb:6.0f} MB{found.code:3}{' *'[not found.is_kept]}"
            for found in taken
        )
        print(f"{name:42}{taken[0].size / 1e6:6.1f}{cells}", flush=True)
        broken += sum(not found.is_kept for found in taken)
    print(f"The promise: below {MOST_S} s and {MOST_MB} MB, exit code 0, or 2 and one line.")
    return broken


if __name__ == "__main__":
    if {"--json", "--share"} & set(sys.argv):
        run_alone(measure)
    else:
        parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
        parser.add_argument("names", nargs="*", help="words of names, for example sqlite")
        sys.exit(min(print_files(parser.parse_args().names), 1))
