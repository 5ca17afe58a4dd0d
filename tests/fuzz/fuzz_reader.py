"""Look for bytes that make the reader fail otherwise than in one line. Not run by pytest.

    pip install atheris
    PYTHONPATH=. python tests/fuzz/fuzz_reader.py -max_total_time=300

Without a corpus it starts from small files of every compression. What breaks is written to
`crash-*`; keep it, made small, as a test in tests/log/engine/test_damaged_columns.py.
"""

import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import atheris  # type: ignore[import-untyped]

with atheris.instrument_imports(include=["turtlelog.log", "mcap"]):
    from turtlelog.errors import LogError
    from turtlelog.log import (
        PartialRecordingWarning,
        iter_columns,
        read_columns,
        read_info,
        read_recording,
        recover_recording,
    )

from mcap.writer import CompressionType

from tests.log.engine.files import Row, pack, write_rows
from tests.log.engine.raw_records import read_raw

BUGS = ("TypeError", "AttributeError", "NameError", "AssertionError", "UnboundLocalError")
FOLDER = Path(tempfile.mkdtemp(prefix="fuzz-"))
SCHEMAS = {
    "/p": ("t/msg/P", "uint8 n\nfloat64[2] x\n"),
    "/s": ("t/msg/S", f"string s\nuint8[] data\nP[] p\n{'=' * 80}\nMSG: t/P\nstring a\nbool b\n"),
}


def read_anyhow(data: bytes) -> None:
    """Read bytes in every way; each may fail in one line, which may not hide a bug of ours."""
    path = FOLDER / "a.mcap"
    path.write_bytes(data)
    for read in (
        read_columns,
        read_info,
        read_raw,
        lambda path: list(iter_columns(path, rows=2)),
        lambda path: read_info(path, allow_partial=True),
        lambda path: read_recording(path, allow_partial=True),
        recover_soundly,
    ):
        try:
            read(path)
        except LogError as err:
            if "\n" in str(err) or any(bug in str(err) for bug in BUGS):
                raise RuntimeError(str(err)) from err


def recover_soundly(path: Path) -> None:
    """Recover a file; what is written must be whole."""
    target = FOLDER / "recovered.mcap"
    report = recover_recording(path, target)
    found = read_info(target)
    if not found.complete or sum(topic.count for topic in found.topics) != sum(
        report.recovered.values()
    ):
        raise RuntimeError(f"expected a whole file of what was recovered, found {found}")


def write_corpus() -> Path:
    """Return a folder of small files to start from, without checksums that mutations would fail."""
    folder = FOLDER / "corpus"
    folder.mkdir()
    point = pack([("uint8", 1), ("float64", 0.5), ("float64", 2.0)])
    text = pack([("string", "ab"), ("uint32", 1), ("uint8", 7), ("uint32", 1), ("string", "c")])
    rows = [Row(topic="/p", time_ns=number, data=point) for number in range(3)]
    rows.append(Row(topic="/s", time_ns=3, data=text + b"\1"))
    for compression in CompressionType:
        for chunked in (True, False):
            path = folder / f"{compression.name}-{chunked}.mcap"
            options = {"enable_crcs": False, "use_chunking": chunked}
            write_rows(path, SCHEMAS, rows, compression=compression, chunk_size=99, **options)
    return folder


def main() -> None:
    warnings.simplefilter("ignore", PartialRecordingWarning)
    try:
        atheris.Setup([*sys.argv, str(write_corpus())], read_anyhow)
        atheris.Fuzz()
    finally:
        shutil.rmtree(FOLDER, ignore_errors=True)


if __name__ == "__main__":
    main()
