import os
import subprocess
import sys
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.cli.app import _COMMANDS, app


def test_the_version_is_the_packages(call: Call) -> None:
    assert call("--version").out == f"turtlelog {tl.__version__}\n"


@pytest.mark.parametrize(
    "code",
    [
        "import turtlelog",
        "import turtlelog.cli.app",
        "from turtlelog.cli.app import main\ntry: main(['--version'])\nexcept SystemExit: pass",
        "from turtlelog.cli.app import main\ntry: main(['--help'])\nexcept SystemExit: pass",
    ],
    ids=["package", "command line", "version", "help"],
)
def test_starting_up_loads_nothing_heavy(code: str) -> None:
    heavy = "{'numpy', 'rerun', 'mcap', 'msgspec', 'pyarrow', 'matplotlib', 'scipy'}"
    check = f"{code}\nimport sys\nassert not {heavy} & set(sys.modules), set(sys.modules)"
    subprocess.run([sys.executable, "-c", check], check=True, timeout=60)


COUNT = """
import sys
from turtlelog.cli.app import main
try: main(sys.argv[1:])
except SystemExit: pass
loaded = [name for name in sys.modules if name.partition(".")[0] == "turtlelog"]
print(len(loaded), *sorted(loaded), file=sys.stderr)
"""


@pytest.mark.parametrize(
    ("words", "most"),
    [(["--help"], 12), (["info"], 62), (["metrics"], 106), (["plot", "nosuch.parquet"], 30)],
    ids=["help", "info", "metrics", "missing file"],
)
def test_a_command_loads_few_of_our_modules(words: list[str], most: int, kp4: Path) -> None:
    """Each takes 0.5 ms; all that there are, which one eager import may bring, are over 300.

    Help needs the modules of no command, `info` neither laws nor metrics, `metrics` neither
    importers nor laws and effects; an error about a missing file comes before all of these.
    """
    files = [str(kp4)] if words[0] in {"info", "metrics"} else []
    done = subprocess.run(
        [sys.executable, "-c", COUNT, *words, *files],
        check=True, timeout=60, capture_output=True, text=True,
    )  # fmt: skip
    count, *loaded = done.stderr.splitlines()[-1].split()
    assert int(count) <= most, loaded


SEARCHES = """
import gc, os, sys
from turtlelog.__main__ import main
searches = []
gc.callbacks.append(lambda phase, facts: searches.append(phase))
try: main()
except SystemExit: pass
print(len(searches) // 2, os.environ["OPENBLAS_NUM_THREADS"], file=sys.stderr)
"""


@pytest.mark.parametrize("given", ["", "2"], ids=["no threads set", "threads set"])
def test_a_command_loads_without_searches_for_cycles(given: str, kp4: Path) -> None:
    """Searching while modules load takes 17 ms, and threads of numpy 25 ms."""
    threads = {"OPENBLAS_NUM_THREADS": given} if given else {}
    usual = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", SEARCHES, "metrics", str(kp4)],
        check=True, timeout=60, capture_output=True, text=True, env=usual | threads,
    )  # fmt: skip
    assert done.stderr.split() == ["0", given or "1"]


UNNEEDED = (
    "html sqlite3 difflib lz4 hashlib multiprocessing tomli_w numpy.ma numpy.polynomial shutil"
    " tempfile traceback csv turtlelog.theory.sampled_loop"
)


@pytest.mark.parametrize("words", [["info"], ["metrics"]], ids=["info", "metrics"])
def test_a_command_loads_nothing_that_only_others_need(words: list[str], kp4: Path) -> None:
    code = f"{COUNT}\nassert not set('{UNNEEDED}'.split()) & set(sys.modules), set(sys.modules)"
    subprocess.run([sys.executable, "-c", code, *words, str(kp4)], check=True, timeout=60)


def test_a_table_of_metrics_is_written_without_pandas(kp4: Path, tmp_path: Path) -> None:
    """A process of its own loads pyarrow, in two seconds."""
    code = f"{COUNT}\nassert 'pyarrow' in sys.modules and 'pandas' not in sys.modules"
    words = ["metrics", str(kp4), "-o", str(tmp_path / "metrics.parquet")]
    subprocess.run([sys.executable, "-c", code, *words], check=True, timeout=60)


def test_what_help_says_of_a_command_is_how_its_docstring_begins() -> None:
    described = {name: text for of in _COMMANDS.values() for name, (_, text) in of.items()}
    for name, text in described.items():
        begin, _, _ = (app[name].default_command.__doc__ or "").partition("\n\n")
        assert " ".join(begin.split()) == text


def test_every_public_name_can_be_used() -> None:
    assert all(getattr(tl, name) is not None for name in tl.__all__)
    assert set(tl.__all__) <= set(dir(tl))
    unknown = "nosuch"
    with pytest.raises(AttributeError, match="turtlelog attribute nosuch"):
        getattr(tl, unknown)


def test_a_reader_that_goes_away_ends_the_command_quietly(tmp_path: Path) -> None:
    command = f"{sys.executable} -m turtlelog run textbook --json"
    script = f"{command} | {sys.executable} -c 'import sys; sys.stdin.read(10)'"
    done = subprocess.run(
        ["sh", "-c", script], check=True, timeout=60, capture_output=True, text=True
    )
    assert done.stderr == ""


def test_the_demo_writes_recordings_views_and_table_1(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = call("demo", "-o", "out")
    assert answer.code == 0
    runs = ("kp1", "kp2", "kp4", "kp10")
    expected = {f"{run}.{suffix}" for run in runs for suffix in ("mcap", "rrd")}
    expected |= {"comparison.rrd", "table1.txt", "table1.md", "table1.csv", "table1.tex"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == expected
    rows, _, notes = (tmp_path / "out" / "table1.txt").read_text().rpartition("\n\n")
    assert rows in answer.out
    assert " ".join(notes.split()) in answer.flat
    assert max(map(len, answer.out.partition("See the four")[0].splitlines())) <= 80
    assert "view" in answer.out.splitlines()[-4]
    told = "4 runs. paper-kp2 ends 1.01 mm from the goal, paper-kp10 0.107 m."
    assert answer.flat.startswith(f"out: {told} Table 1")


def test_the_demo_refuses_a_file_for_its_folder(call: Call, tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    answer = call("demo", "-o", tmp_path / "out")
    assert answer.code == 2
    assert "cannot be a folder: File exists" in answer.err


def test_a_full_standard_output_is_one_line() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    command = [sys.executable, "-m", "turtlelog", "scenario", "paper"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False
        )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "standard output: cannot be written" in done.stderr


def test_names_beyond_ascii_are_printed_on_an_ascii_terminal(tmp_path: Path) -> None:
    path = tmp_path / "läufer.mcap"
    tl.write_recording(tl.simulate_run(tl.load_scenario("textbook")), path)
    done = subprocess.run(
        [sys.executable, "-m", "turtlelog", "info", str(path)],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        timeout=60,
        check=True,
    )
    assert b"l\\xe4ufer.mcap" in done.stdout


def test_a_name_inside_a_recording_leads_nowhere(call: Call, tmp_path: Path) -> None:
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"name": "../../escaped"})
    tl.write_recording(tl.simulate_run(scenario), tmp_path / "a.mcap")
    answer = call("view", tmp_path / "a.mcap", "--save", tmp_path / "a.rrd")
    assert answer.code == 0
    assert [path.name for path in tmp_path.iterdir() if path.name != "a.mcap"] == ["a.rrd"]


def test_a_gain_goes_to_the_law_that_is_chosen(call: Call, tmp_path: Path) -> None:
    law = Path(__file__).parents[2] / "examples" / "turn_and_drive.py"
    words = ("--set", f"law.kind={law}:TurnAndDrive", "--kp", "2")
    answer = call("scenario", "textbook", *words)
    assert "kp_angular = 2.0" in answer.out


def test_without_docstrings_help_and_lists_say_what_is_missing() -> None:
    """Python with -OO starts in a process of its own, three times."""
    command = [sys.executable, "-OO", "-m", "turtlelog"]
    for words, is_told in ((["list", "metrics"], True), (["--help"], True), (["--version"], False)):
        done = subprocess.run(
            [*command, *words], check=True, timeout=60, capture_output=True, text=True
        )
        assert ("Python runs without docstrings" in done.stderr) is is_told
