"""What comes of reading damaged files: equal data, one clean error, or something worse."""

import enum
import itertools
import multiprocessing
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import turtlelog as tl
from tests.torture.recordings import Record, list_contents
from turtlelog.errors import LogError
from turtlelog.log.recovery import recover_recording


class Outcome(enum.Enum):
    """The last two must never be."""

    EQUAL = "equal data"
    PART = "part of the data, said so"
    ERROR = "one LogError"
    FOREIGN = "foreign exception"
    SILENT = "silently other data"


BAD = frozenset({Outcome.FOREIGN, Outcome.SILENT})


@dataclass(frozen=True, slots=True)
class Cut:
    """A file that ends before `length`."""

    length: int

    def apply(self, data: bytes) -> bytes:
        return data[: self.length]


@dataclass(frozen=True, slots=True)
class Flip:
    """A file with one bit turned over."""

    place: int
    bit: int

    def apply(self, data: bytes) -> bytes:
        damaged = bytearray(data)
        damaged[self.place] ^= 1 << self.bit
        return bytes(damaged)


@dataclass(frozen=True, slots=True)
class Overwrite:
    """A file with other bytes at one place."""

    place: int
    data: bytes

    def apply(self, data: bytes) -> bytes:
        return data[: self.place] + self.data + data[self.place + len(self.data) :]


Harm = Cut | Flip | Overwrite
Failure = tuple[str, Harm, Outcome, str]
"""Reader, what was done to the file, what came of it, and its text."""


def list_harms(data: bytes) -> list[Harm]:
    """Return a cut at every byte, and a flip of every bit."""
    flips = (Flip(place, bit) for place in range(len(data)) for bit in range(8))
    return [*(Cut(length) for length in range(len(data))), *flips]


def sample_harms(data: bytes, count: int, seed: int) -> list[Harm]:
    """Return as many cuts as flips, chosen by a seed."""
    random, size = Random(seed), len(data)
    cuts: list[Harm] = [Cut(length) for length in random.sample(range(size), count // 2)]
    places = random.sample(range(8 * size), count - count // 2)
    return [*cuts, *(Flip(place // 8, place % 8) for place in places)]


class Readers:
    """Every way to read a file, each held against what the undamaged file holds."""

    def __init__(self, sound: bytes, folder: Path, twin: bytes | None = None) -> None:
        self._path, self._output = folder / "damaged.mcap", folder / "recovered.mcap"
        self._messages, self._files = list_contents(sound if twin is None else twin)
        self._path.write_bytes(sound)
        self._reads: dict[str, Callable[[], Any]] = {
            "read_recording": lambda: tl.read_recording(self._path),
            "read_info": lambda: tl.read_info(self._path),
        }
        if hasattr(tl, "read_columns"):
            self._reads["read_columns"] = lambda: dict(tl.read_columns(self._path))
        self._expected = {name: describe(read()) for name, read in self._reads.items()}

    def try_all(self, damaged: bytes) -> Iterator[tuple[str, Outcome, str]]:
        """Yield what comes of each reader."""
        self._path.write_bytes(damaged)
        for name in self._reads:
            yield name, *self._try(lambda name=name: self._compare(name))  # type: ignore[misc]
        yield "recover_recording", *self._try(self._recover)

    def _try(self, read: Callable[[], tuple[Outcome, str]]) -> tuple[Outcome, str]:
        try:
            return read()
        except LogError as err:
            text = str(err)
            is_clean = "\n" not in text and text.startswith(f"{self._path}: ")
            return (Outcome.ERROR if is_clean else Outcome.FOREIGN), text
        except Exception as err:
            return Outcome.FOREIGN, repr(err)

    def _compare(self, name: str) -> tuple[Outcome, str]:
        found = self._reads[name]()
        if describe(found) == self._expected[name]:
            return Outcome.EQUAL, ""
        # What is known of a file that was never finished, and that it was not.
        is_said = isinstance(found, tl.log.RecordingInfo) and not found.complete
        return (Outcome.PART if is_said else Outcome.SILENT), ""

    def _recover(self) -> tuple[Outcome, str]:
        report = recover_recording(self._path, self._output)
        found, files = list_contents(self._output.read_bytes())
        if not is_part(found, self._messages):
            return Outcome.SILENT, f"messages that were never written: {report}"
        if len(found) == len(self._messages) and files == self._files:
            return Outcome.EQUAL, ""
        return (Outcome.SILENT if report.complete else Outcome.PART), str(report)


def is_part(found: list[Record], whole: Iterable[Record]) -> bool:
    """Return whether all messages found were written, in this order."""
    rest = iter(whole)
    return all(message in rest for message in found)


def describe(value: Any) -> Any:
    """Return a value as what can be compared to the last bit."""
    if is_dataclass(value):
        return [(field.name, describe(getattr(value, field.name))) for field in fields(value)]
    if isinstance(value, Mapping):
        return sorted((str(key), describe(inner)) for key, inner in value.items())
    if isinstance(value, np.ndarray):
        data = value.tolist() if value.dtype == object else value.tobytes()
        return str(value.dtype), value.shape, data
    return repr(value)


def count_outcomes(
    sound: bytes,
    harms: list[Harm],
    *,
    processes: int = 1,
    label: str = "",
    twin: bytes | None = None,
) -> tuple[Counter[tuple[str, Outcome]], list[Failure]]:
    """Return how often each reader came to each outcome, and the bad ones.

    Args:
        sound: The file before the harm.
        harms: What is done to it, one at a time.
        processes: How many work at the same time.
        label: Of the progress on stderr; none where it is empty.
        twin: A file of the same contents that the mcap library reads, where it does not read this.
    """
    size = max(1, min(2000, len(harms) // (4 * processes)))
    jobs = [(sound, harms[start : start + size], twin) for start in range(0, len(harms), size)]
    counts: Counter[tuple[str, Outcome]] = Counter()
    failures: list[Failure] = []
    for done, (found, bad) in enumerate(_run_jobs(jobs, processes), start=1):
        counts += found
        failures += bad
        if label:
            sys.stderr.write(f"\r{label}: {done * 100 // len(jobs)} %, {len(failures)} bad ")
            sys.stderr.flush()
    return counts, failures


def format_table(counts: Mapping[str, Counter[tuple[str, Outcome]]]) -> str:
    """Return the outcomes as a table: a row for each file and reader."""
    titles = ["file", "reader", *(outcome.value for outcome in Outcome)]
    rows = [titles]
    for file, found in counts.items():
        for reader in dict.fromkeys(name for name, _ in found):
            rows.append([file, reader, *(str(found[reader, outcome]) for outcome in Outcome)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


Job = tuple[bytes, list[Harm], bytes | None]
Result = tuple[Counter[tuple[str, Outcome]], list[Failure]]


def _run_jobs(jobs: list[Job], processes: int) -> Iterator[Result]:
    if processes == 1:
        yield from itertools.starmap(_run_job, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap_unordered(_run_packed_job, jobs)


def _run_packed_job(job: Job) -> Result:
    return _run_job(*job)


def _run_job(sound: bytes, harms: list[Harm], twin: bytes | None) -> Result:
    counts: Counter[tuple[str, Outcome]] = Counter()
    failures: list[Failure] = []
    with tempfile.TemporaryDirectory() as folder:
        readers = Readers(sound, Path(folder), twin)
        for harm in harms:
            for name, outcome, text in readers.try_all(harm.apply(sound)):
                counts[name, outcome] += 1
                if outcome in BAD:
                    failures.append((name, harm, outcome, text))
    return counts, failures
