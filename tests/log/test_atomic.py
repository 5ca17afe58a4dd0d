import os
from pathlib import Path

import pytest

from turtlelog.errors import LogError
from turtlelog.log import replace_when_complete


def test_the_file_appears_when_the_block_ends(tmp_path: Path) -> None:
    with replace_when_complete(tmp_path / "a.txt") as temporary:
        temporary.write_text("new", encoding="utf-8")
        assert not (tmp_path / "a.txt").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def write_half(path: Path, error: type[BaseException]) -> None:
    with replace_when_complete(path) as temporary:
        temporary.write_text("half", encoding="utf-8")
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failure_keeps_the_old_file_and_nothing_else(
    error: type[BaseException], tmp_path: Path
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(error):
        write_half(path, error)
    assert path.read_text(encoding="utf-8") == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_full_disk_is_one_line_that_names_the_file(tmp_path: Path) -> None:
    with (
        pytest.raises(LogError, match=r"a\.txt: expected a place .*, found: No space left"),
        replace_when_complete(tmp_path / "a.txt"),
    ):
        raise OSError(28, "No space left on device")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a device or pipe to name")
def test_a_device_is_not_replaced() -> None:
    with pytest.raises(LogError, match="found a device"), replace_when_complete(os.devnull):
        pytest.fail("a device would have been replaced")
