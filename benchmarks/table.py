"""One table of all benchmarks: what a job costs, beside a peer and a bound, and how it is measured.

A benchmark has `measure(share)`, which yields rows; `share` makes its sizes smaller, for a quick
look. Costs are processor times, of all threads, and peaks of memory: other programs that run at the
same time hardly change them.
"""

import gc
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

ROOT: Final = Path(__file__).resolve().parents[1]
WIDTH: Final = 120
"""How wide the table may be [characters]."""

Measure = Callable[[float], Iterator["Row"]]

_HEADS: Final = ("job", "turtlelog", "peer", "bound", "ratio", "aim", "met")
_NONE: Final = ""


@dataclass(frozen=True, slots=True)
class Cost:
    """What another way costs.

    Attributes:
        name: Which way; docs/performance.md says what it does.
        value: In the unit of the row.
        is_yardstick: Whether it does less than the job, or something else: good to count in only.
    """

    name: str
    value: float
    is_yardstick: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What one job costs.

    Attributes:
        job: What is done.
        value: What it costs turtlelog.
        unit: s, of processor time, MB, or B.
        peer: Another way to the same end, which may be better, or a yardstick.
        bound: A part of the job that no way can leave out; on one machine none costs less.
        aim: The most that is wanted; None where nothing was promised.
        aim_of: Whether the aim is for the ratio or for the value.
    """

    job: str
    value: float
    unit: Literal["s", "MB", "B"] = "s"
    peer: Cost | None = None
    bound: Cost | None = None
    aim: float | None = None
    aim_of: Literal["ratio", "value"] = "ratio"

    @property
    def ratio(self) -> float | None:
        """Return the cost in those of the bound, or of the peer where no bound is known."""
        other = self.bound or self.peer
        return None if other is None or not other.value else self.value / other.value

    @property
    def is_met(self) -> bool | None:
        """Return whether the aim is met, None where there is none."""
        found = self.value if self.aim_of == "value" else self.ratio
        return None if self.aim is None or found is None else found <= self.aim

    @property
    def peer_is_better(self) -> bool:
        """Return whether the peer does the same at less cost."""
        peer = self.peer
        return peer is not None and not peer.is_yardstick and peer.value < self.value


def time_calls(*calls: Callable[[], object], repeats: int = 5) -> list[float]:
    """Return the least processor time of each call [s]; the calls take turns.

    What else runs on the machine only ever adds, and taking turns shares it out.
    """
    least = [math.inf] * len(calls)
    gc.collect()
    for _ in range(repeats):
        for number, call in enumerate(calls):
            start = time.process_time()
            call()
            least[number] = min(least[number], time.process_time() - start)
    return least


def time_commands(
    *commands: Sequence[str],
    repeats: int = 5,
    env: Mapping[str, str] | None = None,
    folder: Path = ROOT,
) -> list[float]:
    """Return the least processor time of each command and its processes [s], in turns.

    Unless `env` says otherwise the first call compiles what is not compiled yet.
    """
    env = build_warm_environment() if env is None else env
    least = [math.inf] * len(commands)
    for _ in range(repeats):
        for number, command in enumerate(commands):
            start = _read_children_s()
            done = subprocess.run(command, capture_output=True, env=env, cwd=folder, text=True)
            if done.returncode:
                raise RuntimeError(f"{command}: expected success, found {done.stderr}")
            least[number] = min(least[number], _read_children_s() - start)
    return least


def build_warm_environment() -> dict[str, str]:
    """Return the variables of this process, but for those that keep byte-code from its place."""
    taken = {"PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX"}
    return {name: value for name, value in os.environ.items() if name not in taken}


def _read_children_s() -> float:
    import resource  # not on Windows

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_apart(code: str, *arguments: str) -> dict[str, Any]:
    """Run code in a process of its own and return what it says.

    The code finds `arguments`, and `read_peak()`: the most memory so far [MB]; it puts what it says
    into the dictionary `said`.
    """
    command = [sys.executable, "-c", f"{_APART}\n{code}\nprint(json.dumps(said))", *arguments]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return said


# The peak that getrusage gives may include the process that started this one: Linux knows better.
_APART: Final = """
import json, pathlib, sys
arguments, said = sys.argv[1:], {}
def read_peak():
    status = pathlib.Path("/proc/self/status")
    if status.exists():
        return next(int(line.split()[1]) for line in status.open() if "VmHWM" in line) * 1024 / 1e6
    import resource
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
"""


def format_table(rows: Iterable[Row]) -> str:
    """Return the rows as a table in Markdown, aligned."""
    cells = [_HEADS, *map(_format_row, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    return "\n".join(_join(line, widths) for line in (cells[0], rule, *cells[1:]))


def _join(cells: Sequence[str], widths: Sequence[int]) -> str:
    first, *others = zip(cells, widths, strict=True)
    padded = [first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in others)]
    return f"| {' | '.join(padded)} |"


def _format_row(row: Row) -> tuple[str, ...]:
    met = {True: "yes", False: "no", None: _NONE}[row.is_met]
    return (
        row.job,
        format_value(row.value, row.unit),
        *(_format_cost(cost, row.unit) for cost in (row.peer, row.bound)),
        _format_ratio(row),
        _NONE if row.aim is None else _format_aim(row),
        met,
    )


def _format_ratio(row: Row) -> str:
    if row.ratio is None:
        return _NONE
    other = "" if row.bound else " y" if row.peer and row.peer.is_yardstick else " p"
    return f"{_round(row.ratio)}{other}"


def _format_aim(row: Row) -> str:
    aim = row.aim or 0.0
    return format_value(aim, row.unit) if row.aim_of == "value" else f"{aim:.3g}"


def _format_cost(cost: Cost | None, unit: str) -> str:
    return _NONE if cost is None else f"{cost.name} {format_value(cost.value, unit)}"


def format_value(value: float, unit: str) -> str:
    """Return a cost with three digits and its unit."""
    if unit != "s":
        return f"{_round(value)} {unit}"
    for factor, name in ((1.0, "s"), (1e3, "ms")):
        if value * factor >= 1.0:
            return f"{_round(value * factor)} {name}"
    return f"{_round(value * 1e6)} us"


def _round(value: float) -> str:
    """Return three digits, and all of those before the point."""
    if value == 0.0:
        return "0"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"


def tell_better_peers(rows: Iterable[Row]) -> list[str]:
    """Return a line for each job that its peer does at less cost."""
    return [
        f"- {row.job}: {row.peer.name} takes {format_value(row.peer.value, row.unit)},"
        f" turtlelog {format_value(row.value, row.unit)}."
        for row in rows
        if row.peer is not None and row.peer_is_better
    ]


def run_alone(measure: Measure) -> None:
    """Print the rows of one benchmark: as a table, or as JSON with `--json`; `--share` is below 1.

    The JSON is one row a line.
    """
    import argparse

    parser = argparse.ArgumentParser()
    parser.add_argument("--share", type=float, default=1.0, help="of the usual sizes; otherwise 1")
    parser.add_argument("--json", action="store_true", help="one row a line")
    asked = parser.parse_args()
    rows = measure(asked.share)
    if asked.json:
        for row in rows:
            print(json.dumps(asdict(row)), flush=True)
    else:
        print(format_table(list(rows)))


def read_row(line: str) -> Row:
    """Return a row from its JSON."""
    values = json.loads(line)
    for name in ("peer", "bound"):
        if values[name] is not None:
            values[name] = Cost(**values[name])
    return Row(**values)
