import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import turtlelog as tl
from turtlelog.remote import RemotePath, is_url, make_path, show_url


@pytest.mark.parametrize(
    "text",
    ["s3://b/x.mcap", "https://host/x.mcap", "memory://x", "simplecache::s3://b/x", "gs://b/x"],
)
def test_urls_are_urls(text: str) -> None:
    assert is_url(text)
    assert isinstance(make_path(text), RemotePath)


@pytest.mark.parametrize(
    "text", ["C:\\x.mcap", "C:/x.mcap", "C://x.mcap", "a:b.mcap", "bag:/odom", "x.mcap", "s3:/b/x"]
)
def test_files_are_no_urls(text: str) -> None:
    assert not is_url(text)
    assert type(make_path(text)) is type(Path(text))


def test_a_file_with_a_colon_in_its_name_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sys.platform == "win32":
        pytest.skip("names of files there hold no colon")
    (tmp_path / "a:b.mcap").write_bytes(Path("recordings/paper/kp4.mcap").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert tl.read_run("a:b.mcap").name == "paper-kp4"


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("https://me:pw@host:80/a/b.mcap?X-Amz-Signature=1//2#f", "https://host:80/a/b.mcap"),
        ("s3://key:secret@bucket/a@b.mcap", "s3://bucket/a@b.mcap"),
        ("simplecache::https://me:pw@host/x?sig=1", "simplecache::https://host/x"),
        ("s3://", "s3://"),
        ("http://[broken/x", "http://[broken/x"),
    ],
)
def test_a_url_is_shown_without_what_is_secret(url: str, shown: str) -> None:
    assert show_url(url) == str(RemotePath(url)) == shown


def test_a_path_of_a_url_keeps_it_whole() -> None:
    path = RemotePath("https://host/a//b/./run.mcap?sig=1//2")
    assert path.name == "run.mcap"
    assert path.suffix == ".mcap"
    assert path.with_suffix(".csv").url == "https://host/a//b/./run.csv?sig=1//2"
    assert (path.parent / "other.mcap").url == "https://host/a//b/./other.mcap?sig=1//2"
    copied = pickle.loads(pickle.dumps(path))
    assert copied == path
    assert copied.url == path.url
    # Results hold the text; other processes read the file again by it.
    shown = pickle.loads(pickle.dumps(str(path)))
    assert shown == "https://host/a//b/./run.mcap"
    assert make_path(shown) == path


def test_local_files_load_no_fsspec() -> None:
    code = (
        "import sys, turtlelog as tl; tl.read_run('recordings/paper/kp4.mcap');"
        " assert not {'fsspec', 'aiohttp', 'turtlelog.remote.ranges'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
