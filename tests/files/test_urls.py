import pickle
import subprocess
import sys
import time
from pathlib import Path

import pytest

import turtlelog as tl
from turtlelog.errors import TurtlelogError
from turtlelog.escapes import hide_secrets, show_url
from turtlelog.files import RemotePath, is_url, make_path


@pytest.mark.parametrize(
    "text",
    [
        "s3://b/x.mcap",
        "https://host/x.mcap",
        "memory://x",
        "simplecache::s3://b/x",
        "gs://b/x",
        "async_wrapper::http://h/x",
    ],
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
        ("https://me:p/w@host/a.mcap", "https://host/a.mcap"),
        ("s3://key:se/cr/et@bucket/a.mcap?sig=a@b", "s3://bucket/a.mcap"),
        ("https://me:p?w#x@host:80/a", "https://host:80/a"),
        ("https://me:p::w@host/a", "https://host/a"),
        ("s3://key:secret/a.mcap", "s3://.../a.mcap"),
        ("https://[::1]:80/a@b", "https://[::1]:80/a@b"),
        ("https://host:80/a@b", "https://host:80/a@b"),
        ("s3://arn:aws:s3:eu:1:accesspoint/x/a@b", "s3://arn:aws:s3:eu:1:accesspoint/x/a@b"),
        ("async_wrapper::http://me:pw@host/x?y", "async_wrapper::http://host/x"),
        ("tcp://me:pw@host:8786", "tcp://host:8786"),
    ],
)
def test_a_url_is_shown_without_what_is_secret(url: str, shown: str) -> None:
    assert show_url(url) == str(RemotePath(url)) == shown


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ('Invalid bucket name "key:SE/CRET@bucket": no', 'Invalid bucket name "...bucket": no'),
        (
            "no host in https://key:SE/CRET@bucket/x?a=1, twice",
            "no host in https://bucket/x, twice",
        ),
        ("SignatureDoesNotMatch: you sent a%3DSIG", "SignatureDoesNotMatch: you sent ..."),
        ("you sent a=SIG", "you sent ..."),
        ("at s3://b/x: expected", "at s3://b/x: expected"),
        (
            "as in tcp://host:8786, or (tcp://[::1]:1).",
            "as in tcp://host:8786, or (tcp://[::1]:1).",
        ),
        ("connect tcp://U:PW@host:1: refused", "connect tcp://host:1: refused"),
    ],
)
def test_a_message_is_shown_without_what_is_secret_in_its_url(text: str, shown: str) -> None:
    assert hide_secrets(text, "s3://key:SE/CRET@bucket/x?sig=a%3DSIG&b=1") == shown


@pytest.mark.parametrize(
    "text",
    [
        *(f"u:pa{sign}SECRET" for sign in "'\"<>`@:,;"),
        *("u:12'SECRET", "u:SE/CR'SECRET", "u:SE'CR/SECRET", "u:SE CR SECRET", "'SECRET"),
    ],
)
def test_no_letter_of_a_password_ends_what_is_hidden(text: str) -> None:
    assert hide_secrets(f"no http://{text}@host/x, as said") == "no http://host/x, as said"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("no http://host/x?sig=a'SECRET, as said", "no http://host/x, as said"),
        ("no 'http://host/x?sig=a\"SECRET'", "no 'http://host/x'"),
        ("(http://host/x'y?sig=SECRET).", "(http://host/x'y)."),
        ('is it "http://host/x"?', 'is it "http://host/x"?'),
        ('see <http://host/x#a"SECRET>', "see <http://host/x>"),
    ],
)
def test_no_quote_ends_a_query(text: str, shown: str) -> None:
    assert hide_secrets(text) == shown


@pytest.mark.parametrize("length", [990, 1010, 7000, 20_000])
def test_no_length_saves_a_password_from_being_hidden(length: int) -> None:
    password = "p" * length + "'SECRET" + "p" * 20
    shown = str(TurtlelogError(f"no http://u:{password}@host/x, as said"))
    assert shown.startswith("no http://")
    assert "pp" not in shown
    assert "SECRET" not in shown


@pytest.mark.parametrize(
    "text",
    [
        "see 'http://host/x', or ask me@b",
        "see 'http://host:80/x','me@b'",
        "no answer of tcp://host:8786: ask me@b",
        "no file http://host: ask me@b",
    ],
)
def test_a_name_with_an_at_behind_a_url_stays(text: str) -> None:
    assert hide_secrets(text) == text


@pytest.mark.parametrize("part", ["a", "ab::", "s3://h::", "s3://h:a", "s3://u:'a "])
def test_secrets_are_looked_for_in_time_linear_in_the_length(part: str) -> None:
    start_s = time.process_time()
    hide_secrets(part * (100_000 // len(part)))
    assert time.process_time() - start_s < 5.0  # without limits the first two take over 10 s


@pytest.mark.parametrize(
    ("text", "url", "topic"),
    [
        ("https://h/b.mcap:/odom?sig=1:/2", "https://h/b.mcap?sig=1:/2", "/odom"),
        ("https://h/b.mcap?sig=1:/odom", "https://h/b.mcap?sig=1", "/odom"),
        ("https://h/b.mcap?sig=1:/2/3=", "https://h/b.mcap?sig=1:/2/3=", None),
        ("https://h/b.mcap?from=http://x", "https://h/b.mcap?from=http://x", None),
        ("https://u:/p@h/b.mcap", "https://u:/p@h/b.mcap", None),
    ],
)
def test_a_topic_and_a_signature_are_told_apart(text: str, url: str, topic: str | None) -> None:
    path, found = RemotePath(text).split_topic()
    assert (path.url, found) == (url, topic)


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
        " assert not {'fsspec', 'aiohttp', 'turtlelog.files.remote_file'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
