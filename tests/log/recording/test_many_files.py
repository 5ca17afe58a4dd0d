"""What reading many files of one experiment costs, counted and not timed."""

import io
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from turtlelog.log.engine import message_types, opening

FILES = 100
MOST_READS = 20
"""Of a usual file: its ends, its summary, a chunk, and the records between."""

MOST_LINES = 3
"""In which a scenario differs from the one before: its name, and two gains."""


@pytest.fixture
def experiment(tmp_path: Path) -> list[Path]:
    base = tl.override_scenario(tl.scenario.get_preset("paper-kp4"), {"max_duration_s": 0.5})
    files = [tmp_path / f"{number:03}.mcap" for number in range(FILES)]
    for number, file in enumerate(files):
        gains = {"law.kp_linear": 1.0 + number / 64.0, "law.kp_angular": 2.0 + number / 64.0}
        changed = tl.override_scenario(base, {"name": f"run {number}", **gains})
        tl.write_recording(tl.simulate_run(changed), file)
    return files


@pytest.mark.thorough
def test_many_files_are_opened_once_and_what_they_share_is_parsed_once(
    experiment: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: Counter[str] = Counter()

    class Counting(io.BufferedReader):
        def read(self, *size: Any) -> bytes:
            counts["read"] += 1
            return super().read(*size)

    def open_counted(path: Path) -> Counting:
        counts["open"] += 1
        return Counting(io.FileIO(path))

    def parse_schema(name: str, text: str) -> Any:
        counts["schema"] += 1
        return read_schema(name, text)

    def parse_lines(text: str) -> Any:
        counts["toml"] += 1
        return loads(text)

    read_schema, loads = message_types._parse_schema, tomllib.loads
    monkeypatch.setattr(opening, "open_file", open_counted)
    monkeypatch.setattr(message_types, "_parse_schema", parse_schema)
    tl.read_run(experiment[0])
    monkeypatch.setattr(tomllib, "loads", parse_lines)
    counts.clear()
    names = [tl.read_run(file).name for file in experiment[1:]]
    assert names == [f"run {number}" for number in range(1, FILES)]
    assert counts["open"] == FILES - 1
    assert counts["read"] <= MOST_READS * counts["open"]
    assert counts["schema"] == 0
    assert 0 < counts["toml"] <= MOST_LINES * counts["open"]
