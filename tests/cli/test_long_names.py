import time
from pathlib import Path

import pytest

from benchmarks.hostile_databases import FILES
from turtlelog.cli.app import main

MOST_S = 7.0
"""It takes 2 s; where the name is broken into lines 9 s more."""


def test_a_name_of_megabytes_is_printed_in_seconds_and_cut_in_notes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bag of 9 MB is read."""
    path = FILES["sqlite: topic of 2.3 M letters in UTF-16"](tmp_path)
    start = time.process_time()
    with pytest.raises(SystemExit) as ended:
        main(["explain", str(path)])
    took_s = time.process_time() - start
    told = capsys.readouterr()
    assert ended.value.code == 1
    assert "letters more)" in told.err
    assert len(told.err) < 10_000
    longest = max(told.out.splitlines(), key=len)
    assert len(longest) > 2_000_000
    assert took_s < MOST_S
