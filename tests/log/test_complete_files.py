import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from turtlelog.errors import LogError, ShowError, TurtlelogError
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
        pytest.raises(LogError, match=r"a\.txt: cannot be written: No space left"),
        replace_when_complete(tmp_path / "a.txt"),
    ):
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize("error", [LogError, ShowError])
def test_errors_have_the_class_that_the_caller_asks_for(
    error: type[TurtlelogError], tmp_path: Path
) -> None:
    with (
        pytest.raises(error, match="found a folder"),
        replace_when_complete(tmp_path, raising=error),
    ):
        pytest.fail("a folder would have been replaced")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a device or pipe to name")
def test_a_device_is_not_replaced() -> None:
    with pytest.raises(LogError, match="found a device"), replace_when_complete(os.devnull):
        pytest.fail("a device would have been replaced")


@pytest.fixture
def usual_umask() -> Iterator[None]:
    before = os.umask(0o022)
    yield
    os.umask(before)


def write(path: Path, text: str = "new") -> int:
    """Write a file; return the permissions that it has meanwhile."""
    with replace_when_complete(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
        return temporary.stat().st_mode & 0o7777


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no permission bits")
@pytest.mark.usefixtures("usual_umask")
def test_a_file_that_is_replaced_keeps_its_permissions_and_a_new_one_gets_the_usual(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.txt"
    write(path)
    assert path.stat().st_mode & 0o7777 == 0o644
    for mode, meanwhile in ((0o600, 0o600), (0o666, 0o666), (0o750, 0o750), (0o440, 0o640)):
        path.chmod(mode)
        assert write(path) == meanwhile  # nobody reads on the way what is not for him
        assert path.stat().st_mode & 0o7777 == mode


@pytest.mark.skipif(
    sys.platform == "win32" or os.getuid() != 0, reason="only root gives files away"
)
def test_a_file_that_is_replaced_keeps_its_owner(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.touch()
    os.chown(path, 1234, 2345)
    write(path)
    assert (path.stat().st_uid, path.stat().st_gid) == (1234, 2345)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
@pytest.mark.parametrize("target", ["there.txt", "not-yet.txt", "other.txt"])
def test_a_link_stays_and_what_it_leads_to_is_written(target: str, tmp_path: Path) -> None:
    folder, link = tmp_path / "elsewhere", tmp_path / "link.txt"
    folder.mkdir()
    (folder / "there.txt").write_text("old", encoding="utf-8")
    (folder / "other.txt").symlink_to("there.txt")
    link.symlink_to(Path("elsewhere", target))
    write(link)
    assert link.is_symlink()
    assert (folder / target).read_text(encoding="utf-8") == "new"
    assert (folder / "other.txt").is_symlink()
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".part"] == []


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_link_that_leads_nowhere_is_refused_and_stays(tmp_path: Path) -> None:
    circle, lost = tmp_path / "circle.txt", tmp_path / "lost.txt"
    circle.symlink_to(circle)
    lost.symlink_to("no/such.txt")
    with pytest.raises(LogError, match=r"circle\.txt: expected .*, found a link to itself"):
        write(circle)
    with pytest.raises(LogError, match=r"lost\.txt: cannot be written: No such file"):
        write(lost)
    assert circle.is_symlink()
    assert lost.is_symlink()
