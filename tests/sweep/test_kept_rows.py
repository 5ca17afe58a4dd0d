from pathlib import Path

import pytest

from turtlelog.sweep import kept_rows
from turtlelog.sweep.kept_rows import FileRows, KeptRows


def keep(folder: Path, *labels: str) -> KeptRows:
    kept = KeptRows(folder / "table.parquet", {"kind": "metrics"})
    for label in labels:
        kept.add([FileRows.pack(label, (1, 2, "hash"), [{}])])
    return kept


@pytest.mark.parametrize("searched", [16, kept_rows._SEARCHED_BYTES])
@pytest.mark.parametrize("cut", [1, 5, 30])
def test_what_is_kept_after_a_cut_part_is_read(
    tmp_path: Path, cut: int, searched: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_rows, "_SEARCHED_BYTES", searched)
    kept = keep(tmp_path, "a", "b")
    kept.path.write_bytes(kept.path.read_bytes()[:-cut])
    assert [one.label for one in kept.read()] == ["a"]
    assert [one.label for one in keep(tmp_path, "c", "d").read()] == ["a", "c", "d"]


def test_damaged_part_is_left_out_and_the_others_are_read(tmp_path: Path) -> None:
    kept = keep(tmp_path, "a")
    first = kept.path.stat().st_size
    keep(tmp_path, "b", "c")
    content = bytearray(kept.path.read_bytes())
    content[first + kept_rows._FRAME.size + 3] ^= 0xFF
    kept.path.write_bytes(content)
    assert [one.label for one in kept.read()] == ["a", "c"]
