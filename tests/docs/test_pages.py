"""What the pages say is run: Python blocks, console blocks, links and tables."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest

import turtlelog as tl
from tests.fresh_process import run_code
from turtlelog.cli.app import main

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
ALL_PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
Command = Callable[..., str]

LONG_PAGES: Final = {
    *("classroom", "comparing-laws", "effects", "figures", "gallery", "paper"),
    *("report", "rerun", "theory"),
}
"""Pages whose blocks simulate or draw for seconds what others show once: they are thorough."""


def find_pages(language: str) -> list[object]:
    """Return the blocks of each page that has some of a language, and its files."""
    pages = [(page, list_blocks(page, language)) for page in PAGES]
    return [make_case(page, found) for page, found in pages if found]


def make_case(page: Path, found: list[Any]) -> object:
    """Return what a page shows, and its files, as parameters of a test."""
    marks = [pytest.mark.thorough] if page.stem in LONG_PAGES else []
    return pytest.param(found, find_files(page), id=page.stem, marks=marks)


def list_blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)


def find_files(page: Path) -> dict[str, str]:
    """Return the files that blocks of Python and of TOML on a page name first."""
    text = page.read_text("utf-8")
    pattern = r"^```(?:python|toml)\n# (\w+\.(?:py|toml))\n(.*?)^```$"
    return dict(re.findall(pattern, text, re.M | re.S))


def write_files(files: dict[str, str], folder: Path) -> None:
    for name, text in files.items():
        (folder / name).write_text(f"# {name}\n{text}", encoding="utf-8")


def list_console(page: Path) -> list[tuple[str, str]]:
    """Return the commands of a page, and what it shows of what each prints."""
    blocks = re.findall(r"^```console\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)
    return re.findall(r"^\$ turtlelog (.*)\n((?:(?!\$ ).*\n)*)", "".join(blocks), re.M)


def find_consoles() -> list[object]:
    """Return the commands of each page, and its files; those of README run in test_everyday.py."""
    pages = [(page, list_console(page)) for page in PAGES if page != README]
    return [make_case(page, found) for page, found in pages if found]


def run_python(*words: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "Traceback" not in done.stderr
    return done.stdout if done.returncode == 0 else done.stdout + done.stderr


@pytest.mark.parametrize(("blocks", "files"), find_pages("python"))
def test_python_blocks_run_as_they_stand(
    blocks: list[str], files: dict[str, str], tmp_path: Path
) -> None:
    """Blocks run as a reader runs them, a page's one after the other: some simulate for seconds."""
    write_files(files, tmp_path)
    answer = run_code(*blocks, folder=tmp_path)
    assert answer.returncode == 0, answer.stderr
    promised = re.findall(r"print\(.*\)  # (.*)$", "".join(blocks), re.M)
    lines = answer.stdout.splitlines()
    assert len(lines) == len(promised)
    # What stands behind a colon may be a remark.
    for line, promise in zip(lines, promised, strict=True):
        assert line in {promise, promise.partition(":")[0]}


@pytest.fixture
def run_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Command]:
    """Run a command in this process, in a folder of its own: most of a short one is its start."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def run(*words: str) -> str:
        with pytest.raises(SystemExit) as stop:
            main(words)
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return out if stop.value.code == 0 else out + err

    yield run
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None)).startswith(str(tmp_path)):
            del sys.modules[name]


def matches_shown(shown: str, printed: str) -> bool:
    """Return whether a page shows what is printed, of which `...` leaves something out."""
    pattern = "".join(
        r"(?:.*\n)*?" if line == "..." else re.escape(line) + "\n" for line in shown.splitlines()
    ).replace(re.escape("..."), ".*")
    return re.fullmatch(pattern, printed) is not None


@pytest.mark.parametrize(("commands", "files"), find_consoles())
def test_console_blocks_print_what_they_show(
    commands: list[tuple[str, str]], files: dict[str, str], tmp_path: Path, run_here: Command
) -> None:
    """Commands run as a reader runs them: pages with many take seconds."""
    write_files(files, tmp_path)
    for command, shown in commands:
        assert shown.strip() != "...", f"{command}: expected some of its output, found none"
        printed = run_here(*shlex.split(command))
        assert matches_shown(shown, printed), printed
        assert ("turtlelog: error: " in shown) == ("turtlelog: error: " in printed)


def test_the_test_of_a_law_of_ones_own_passes(tmp_path: Path) -> None:
    """A test session of its own starts."""
    write_files(find_files(ROOT / "docs" / "own-law.md"), tmp_path)
    options = ("-m", "pytest", "-p", "turtlelog.check.pytest_plugin", "-p", "no:hypothesispytest")
    assert " 1 passed" in run_python(*options, "test_my_law.py", folder=tmp_path)


def list_anchors(page: Path) -> set[str]:
    """Return where links into a page may lead: its headings, as GitHub names them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.M | re.S)
    plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    headings = re.findall(r"^#+ (.+)$", plain, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in headings}


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text("utf-8"), flags=re.S)
    lost = []
    for link in re.findall(r"\]\((?!https?:)([^)]+)", text):
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        if not target.exists() or (anchor and anchor not in list_anchors(target)):
            lost.append(link)
    assert lost == []


def test_the_example_law_reaches_the_goal(tmp_path: Path) -> None:
    kind = f"{ROOT / 'examples' / 'turn_and_drive.py'}:TurnAndDrive"
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": kind})
    assert tl.simulate_run(scenario).stop_reason == "within_tolerance"


@pytest.mark.parametrize(
    "path", sorted((ROOT / "examples" / "scenarios").glob("*.toml")), ids=lambda path: path.stem
)
def test_example_scenarios_come_to_an_end(path: Path) -> None:
    assert tl.simulate_run(tl.load_scenario(path)).is_complete


def test_the_scenario_on_its_page_is_the_preset() -> None:
    text = (ROOT / "docs" / "scenarios.md").read_text("utf-8")
    match = re.search(r"^```toml\n(.*?)^```$", text, re.M | re.S)
    assert match is not None
    path = ROOT / "docs" / "scenarios.md"
    assert tl.parse_scenario(match[1], source=str(path)) == tl.load_scenario("paper-kp10")


@pytest.mark.parametrize("name", [*tl.SIGNALS, *tl.METRICS])
def test_every_signal_and_metric_stands_on_its_page(name: str) -> None:
    page = (ROOT / "docs" / "metrics.md").read_text("utf-8")
    kind = tl.SIGNALS[name] if name in tl.SIGNALS else tl.METRICS[name]
    assert re.search(rf"^\| `{re.escape(name)}` \| {re.escape(kind.unit)} \|", page, re.M)
    assert kind.meaning in page
