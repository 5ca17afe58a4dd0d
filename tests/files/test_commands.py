import json
from pathlib import Path

import pytest

import turtlelog as tl
from tests.files.conftest import SIGNED
from tests.files.range_server import RangeServer
from tests.sweep.swept_tables import write_table
from turtlelog.cli.app import main


def _run(words: list[str]) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code


@pytest.mark.parametrize(
    "words",
    [
        ["info", "--json"],
        ["metrics", "--json"],
        ["replay", "--json"],
    ],
    ids=" ".join,
)
def test_a_command_answers_as_of_the_local_file(
    words: list[str], server: RangeServer, capsys: pytest.CaptureFixture[str]
) -> None:
    path, url = "recordings/paper/kp4.mcap", server.url("signed.mcap")
    assert _run([*words, url + SIGNED]) == 0
    remote = json.loads(capsys.readouterr().out.replace(url, path))
    assert _run([*words, path]) == 0
    local = json.loads(capsys.readouterr().out)
    if words[0] == "info":
        # How a run ended takes its poses, which info does not fetch unasked.
        assert (remote[0].pop("ending"), local[0].pop("ending")[:6]) == (None, "missed")
        assert (remote[0].pop("verdict"), local[0].pop("verdict")) == (None, "missed")
    assert remote == local


def test_a_row_of_a_map_is_run_again_from_its_url(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_table(
        tmp_path / "t.parquet", ["law.kp_linear=1:4"], {"run.duration": lambda kp: 9 - kp}
    )
    with RangeServer(files={f"t.parquet{SIGNED}": table.read_bytes()}) as server:
        url = server.url("t.parquet")
        assert _run(["plot", url + SIGNED, "-o", str(tmp_path / "map.html")]) == 0
        told = capsys.readouterr().out.splitlines()
        assert any(line.endswith(f" run --from {url} --row 3") for line in told)
        assert "SECRET" not in (tmp_path / "map.html").read_text("utf-8")
        output = tmp_path / "row.mcap"
        assert _run(["run", "--from", url + SIGNED, "--row", "3", "-o", str(output)]) == 0
    assert tl.read_recording(output).parameters["law.kp_linear"] == 4.0


@pytest.mark.thorough
def test_a_report_of_a_signed_url_holds_no_signature(server: RangeServer, tmp_path: Path) -> None:
    """A report is written from what a server sends."""
    page = tmp_path / "report.html"
    assert _run(["report", server.url("signed.mcap") + SIGNED, "-o", str(page)]) == 0
    assert "signed.mcap" in page.read_text("utf-8")
    assert "SECRET" not in page.read_text("utf-8")


def test_info_does_not_fetch_the_poses_of_a_bag_unasked(
    server: RangeServer, large_mcap: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(["info", server.url("large.mcap")]) == 0
    assert "not looked at, it is behind a URL: info --clock does" in capsys.readouterr().out
    assert server.sent < 0.025 * len(large_mcap)  # as of test_info_of_a_large_recording


def test_a_server_without_ranges_is_told_in_one_line(
    large_mcap: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    with RangeServer(files={"large.mcap": large_mcap}, has_ranges=False) as server:
        url = server.url("large.mcap")
        assert _run(["info", url]) == 0
    assert capsys.readouterr().err == f"{url}: the server sends no ranges, so all of it is read\n"


def test_an_error_is_one_line_with_the_url(capsys: pytest.CaptureFixture[str]) -> None:
    assert _run(["metrics", "memory://bucket/none.mcap"]) == 2
    assert capsys.readouterr().err == (
        "turtlelog: error: memory://bucket/none.mcap: no object or file of this name\n"
    )


def test_a_topic_stands_behind_a_url() -> None:
    path, topic = tl.log.split_topic("https://host:8080/bag.mcap:/odom")
    assert (str(path), topic) == ("https://host:8080/bag.mcap", "/odom")
    path, topic = tl.log.split_topic("https://host:8080/bag.mcap")
    assert (str(path), topic) == ("https://host:8080/bag.mcap", None)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["metrics", "memory://a/run.mcap", "-o", "t.parquet"], "on a disk, found a URL"),
        (["metrics", "memory://a"], "memory://a: no object or file of this name"),
    ],
)
def test_a_table_of_what_lies_behind_urls_is_refused_in_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    told = capsys.readouterr()
    assert (ended.value.code, told.out, told.err.count("\n")) == (2, "", 1)
    assert said in told.err


SECRET_URLS = [
    "https://me:SECRET@127.0.0.1:1/x.mcap",
    "https://me:SE/SECRET@127.0.0.1:1/x.mcap",
    "http://127.0.0.1:1/x.mcap:/odom?sig=SECRET",
    "s3://key:SECRET@bucket",
    "s3://key:SECRET/SECRET@bucket/x.mcap",
    "async_wrapper::http://me:SECRET@127.0.0.1:1/x.mcap",
    "nosuch://me:SECRET@host/x.mcap",
]
KP4 = "recordings/paper/kp4.mcap"


@pytest.mark.parametrize("url", SECRET_URLS)
def test_no_line_of_a_command_shows_a_password_or_a_signature(
    url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Clients of storage try again before they give up."""
    for words in (["info", url], ["metrics", "--json", url], ["run", url], ["theory", url], [url]):
        assert _run(words) == 2
    assert _run(["info", KP4, f"--time={url}"]) == 2
    assert _run(["run", "paper", "--set", f"law.kind={url}"]) == 2
    told = capsys.readouterr()
    assert "SECRET" not in told.out + told.err
    assert told.err.count("\n") == 7


def test_the_address_of_a_scheduler_is_shown_without_its_password(
    capsys: pytest.CaptureFixture[str],
) -> None:
    address = "tcp://me:SECRET@127.0.0.1:1"
    assert _run(["metrics", KP4, KP4, "--scheduler", address]) == 2
    assert "SECRET" not in capsys.readouterr().err


def test_an_error_in_python_shows_no_password() -> None:
    with pytest.raises(tl.TurtlelogError, match="127") as caught:
        tl.read_run(SECRET_URLS[1])
    assert "SECRET" not in str(caught.value)


@pytest.mark.thorough
def test_a_report_of_checks_of_a_signed_url_names_it_without_its_signature(
    server: RangeServer, tmp_path: Path
) -> None:
    """A report is written from what a server sends."""
    page, spec = tmp_path / "report.html", tmp_path / "spec.toml"
    spec.write_text('format = 1\n[checks.end]\nexpect = "final.position_error < 1"\n')
    url = server.url("signed.mcap")
    assert _run(["check", str(spec), url + SIGNED, "--report", str(page)]) == 0
    assert url in page.read_text("utf-8")
    assert "SECRET" not in page.read_text("utf-8")
