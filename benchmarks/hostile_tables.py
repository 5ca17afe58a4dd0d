"""Hostile tables and logs: CSV, TUM, JSON and Parquet."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from benchmarks.put_files import Make, put_file


def _parquet(folder: Path) -> Path:
    import numpy as np
    import pyarrow as pa
    from pyarrow import parquet

    count, path = 5_000_000, folder / "file.parquet"
    zeros = np.zeros(count)
    columns = {"t": zeros, "x": zeros, "y": zeros, "yaw": zeros}
    parquet.write_table(pa.table(columns), path, compression="zstd")
    return path


def _parquet_columns(folder: Path) -> Path:
    import pyarrow as pa
    from pyarrow import parquet

    path = folder / "file.parquet"
    parquet.write_table(pa.table({f"c{n}": [0.0] for n in range(20_000)}), path)
    return path


def _own_parquet(**facts: str) -> Make:
    """Make a table of turtlelog's poses with some facts in its footer."""

    def make(folder: Path) -> Path:
        import pyarrow as pa
        from pyarrow import parquet

        columns = {name: [0.0, 1.0] for name in ("x_m", "y_m", "heading_rad")}
        table = pa.table({"time_ns": [0, 1], **columns})
        metadata = {f"turtlelog.{name}": said for name, said in facts.items()}
        parquet.write_table(table.replace_schema_metadata(metadata), folder / "file.parquet")
        return folder / "file.parquet"

    return make


def _paper_json(rows: str) -> str:
    return f'{{"metadata": {{}}, "data": {rows}}}'


FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        "csv: 400,000 columns": put_file(
            "file.csv",
            lambda: (
                "t,x,y,heading,"
                + ",".join(f"c{n}" for n in range(400_000))
                + "\n"
                + "0," * 400_003
                + "0\n"
            ),
        ),
        "csv: a cell of 9 MB": put_file(
            "file.csv", lambda: 't,x,y,heading\n0,"' + "\n" * 9_000_000 + '",0,0\n'
        ),
        "csv: 4.9 M empty lines": put_file(
            "file.csv", lambda: "t,x,y,heading\n0,0,0,0\n" + "\n" * 9_800_000
        ),
        "csv: 1.2 M rows of zeros": put_file(
            "file.csv", lambda: "t,x,y,heading\n" + "0,0,0,0\n" * 1_200_000
        ),
        "csv: 350,000 rows": put_file(
            "file.csv", lambda: "t,x,y,heading\n" + "".join(f"{n},0,0,0\n" for n in range(350_000))
        ),
        "csv: numbers of 2.4 M digits": put_file(
            "file.csv", lambda: "t,x,y,heading\n" + ",".join(["1" * 2_400_000] * 4)
        ),
        "csv: quotes": put_file("file.csv", lambda: "t,x,y,heading\n" + '"' * 9_000_000),
        "csv: texts for times": put_file(
            "file.csv",
            lambda: (
                "t,x,y,heading\n"
                + "".join(
                    f"2020-01-01T{n // 3600:02}:{n // 60 % 60:02}:{n % 60:02}+01:00,0,0,0\n"
                    for n in range(86_400)
                )
            ),
        ),
        "csv: dates and 120,000 blanks": put_file(
            "file.csv",
            lambda: "t,x,y,heading\n" + ("2020-01-01T00:00:00" + " " * 120_000 + "x,0,0,0\n") * 80,
        ),
        "tum: 600,000 rows": put_file(
            "file.tum", lambda: "".join(f"{n} 0 0 0 0 0 0 1\n" for n in range(420_000))
        ),
        "tum: quaternions of 1e308": put_file(
            "file.tum",
            lambda: "".join(f"{n} 0 0 0 1e308 1e308 1e308 1e308\n" for n in range(250_000)),
        ),
        "tum: one line": put_file("file.tum", lambda: "0 " * 4_900_000),
        "tum: blanks": put_file("file.tum", lambda: "0 0 0 0 0 0 0 1\n" + " " * 9_800_000),
        "tum: comments": put_file("file.tum", lambda: "#\n" * 4_800_000 + "0 0 0 0 0 0 0 1\n"),
        "json: lists in lists": put_file("file.json", lambda: "[" * 9_800_000),
        "json: 4.9 M numbers": put_file("file.json", lambda: "[" + "1," * 4_900_000 + "1]"),
        "json: 3 M empty objects": put_file(
            "file.json", lambda: _paper_json("[" + "{}," * 3_200_000 + "{}]")
        ),
        "json: number of 9 M digits": put_file("file.json", lambda: _paper_json("1" * 9_800_000)),
        "csv: a quote that does not close": put_file(
            "file.csv",
            lambda: (
                "t,x,y,heading\n" + "0,0,0,0\n" * 200_000 + '0,"0,0,0\n' + "0,0,0,0\n" * 900_000
            ),
        ),
        "csv: zero bytes": put_file("file.csv", lambda: "t,x,y,heading\n" + "\0" * 9_000_000),
        "csv: 9,000 columns of one name": put_file(
            "file.csv",
            lambda: f"t,x,y,heading,{','.join(['x'] * 9000)}\n" + ("0," * 9003 + "0\n") * 400,
        ),
        "csv: a row each 12 days": put_file(
            "file.csv",
            lambda: "t,x,y,heading\n" + "".join(f"{n}000000,{n % 7},0,0\n" for n in range(3000)),
        ),
        "parquet: scenario of lists in lists": _own_parquet(scenario="[" * 1_500_000),
        "parquet: scenario of 100,000 keys": _own_parquet(
            scenario=json.dumps({f"law.k{n}": n for n in range(100_000)})
        ),
        "parquet: declaration of 100,000 phases": _own_parquet(
            declaration=json.dumps({"loops": [], "phases": {f"p{n}": [] for n in range(100_000)}})
        ),
        "parquet: 5 M rows of zeros": _parquet,
        "parquet: 20,000 columns": _parquet_columns,
    }
)
"""By name."""
