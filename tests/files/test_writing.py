from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.cli.app import main
from turtlelog.errors import LogError
from turtlelog.files import RemotePath

KP4 = "recordings/paper/kp4.mcap"


@pytest.fixture
def memory() -> Iterator[dict[str, object]]:
    from fsspec.implementations.memory import MemoryFileSystem

    MemoryFileSystem.store.clear()
    yield MemoryFileSystem.store
    MemoryFileSystem.store.clear()


def _run(*words: str) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code


def test_a_recording_is_written_and_read_back(memory: dict[str, object]) -> None:
    run = tl.read_run(KP4)
    tl.write_recording(run, "memory://out/kp4.mcap")
    assert list(memory) == ["/out/kp4.mcap"]
    np.testing.assert_array_equal(tl.read_run("memory://out/kp4.mcap").poses.xy_m, run.poses.xy_m)


def test_what_is_there_is_replaced_when_complete(memory: dict[str, object]) -> None:
    path = RemotePath("memory://out/x.txt")
    for text in ("first", "second"):
        with tl.log.replace_when_complete(path) as part:
            part.write_text(text)
        assert path.file.open().read() == text.encode()


def test_what_fails_leaves_what_was_there(memory: dict[str, object]) -> None:
    path = RemotePath("memory://out/x.txt")
    with tl.log.replace_when_complete(path) as part:
        part.write_text("first")
    with ExitStack() as failing:
        failing.enter_context(pytest.raises(ZeroDivisionError))
        part = failing.enter_context(tl.log.replace_when_complete(path))
        part.write_text("second")
        failing.callback(lambda: 1 / 0)
    assert path.file.open().read() == b"first"
    assert not part.parent.exists()


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (
            ["convert", KP4, "-o", "memory://o/a.mcap", "-o", "memory://o/a.csv"],
            ["a.csv", "a.mcap"],
        ),
        (["convert", KP4, "-o", "memory://o/poses.parquet"], ["poses.parquet"]),
        (["run", "paper-kp4", "-o", "memory://o/r.mcap"], ["r.mcap"]),
        (["convert", "--recover", KP4, "-o", "memory://o/r.mcap"], ["r.mcap"]),
    ],
)
def test_commands_write_to_urls(
    words: list[str], names: list[str], memory: dict[str, object]
) -> None:
    assert _run(*words) == 0
    assert sorted(memory) == [f"/o/{name}" for name in names]
    for name in names:
        assert len(tl.read_run(f"memory://o/{name}").poses)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["convert", KP4, "-o", "https://host/x.mcap?sig=SECRET"], "found one of http"),
        (["convert", KP4, "-o", "memory://o/bag"], "a URL names a file here, not a folder"),
        (
            ["convert", "memory://o/x.mcap", "-o", "memory://o/x.mcap"],
            "this is the input; name another",
        ),
        (
            ["plot", KP4, "-o", "memory://o/figures"],
            "a URL must end in .pdf, .png or .svg; folders are local",
        ),
        (["demo", "-o", "memory://o/demo"], "a URL, where only single files are written"),
        (
            ["run", "paper-kp4", "--realtime", "-o", "memory://o/x.mcap"],
            "to record live, found a URL",
        ),
        (["run", "paper-kp4", "-o", "gs://o/x.mcap"], "pip install gcsfs"),
    ],
)
def test_what_cannot_be_written_is_one_line(
    words: list[str],
    said: str,
    memory: dict[str, object],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place = Path(KP4).absolute()
    monkeypatch.chdir(tmp_path)
    assert _run(*[str(place) if word == KP4 else word for word in words]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert "SECRET" not in err
    assert not memory
    assert not list(tmp_path.iterdir())


def test_no_file_of_a_url_is_refused() -> None:
    with (
        pytest.raises(LogError, match="expected the URL of a file"),
        tl.log.replace_when_complete("memory://out/"),
    ):
        pass
