"""What a slim installation lacks is named in one line; all else works there as elsewhere."""

import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

import turtlelog as tl
from tests.fresh_process import run_command
from turtlelog.errors import LibraryError
from turtlelog.libraries import attach_names, load_library
from turtlelog.log import read_recording

RECORDING = str(Path("recordings/paper/kp10.mcap").resolve())
OTHER = str(Path("recordings/paper/kp4.mcap").resolve())
MAIN = "from turtlelog.cli.app import main; main()"
LIBRARIES = ["rerun", "pyarrow", "matplotlib", "control", "numba"]
LACKS = f"import sys; sys.modules |= dict.fromkeys({LIBRARIES}); {MAIN}"


def run_main(code: str, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.everyday("check", "run")
@pytest.mark.parametrize(
    "words",
    [
        ("info", RECORDING),
        ("metrics", RECORDING),
        ("check", "spec.toml", RECORDING),
        ("explain", RECORDING),
        ("compare", RECORDING, OTHER),
        pytest.param(("compare", RECORDING, OTHER, "--why"), id="why"),
        ("replay", RECORDING, "--law"),
        ("run", "textbook", "-o", "run.mcap"),
        ("theory", "--kp", "4"),
        ("convert", "--recover", RECORDING, "-o", "recovered.mcap"),
    ],
    ids=lambda words: words[0],
)
def test_slim_installation_gives_the_same_output(words: tuple[str, ...], tmp_path: Path) -> None:
    """A command starts with libraries and without."""
    full = partial(run_command, *words)
    slim = partial(run_main, LACKS, *words)
    outputs = []
    for name, run in (("full", full), ("slim", slim)):
        folder = tmp_path / name
        folder.mkdir()
        spec = 'format = 1\n[checks.end]\nexpect = "final.position_error < 1"\n'
        (folder / "spec.toml").write_text(spec)
        done = run(folder=folder)
        files = {file.name: file.read_bytes() for file in folder.iterdir()}
        outputs.append((done.returncode, done.stdout, done.stderr, files))
    assert outputs[0] == outputs[1]
    assert outputs[1][0] == 0, outputs[1]


@pytest.mark.everyday("plot-matplotlib")
@pytest.mark.parametrize(
    ("words", "package"),
    [
        (("view", RECORDING, "--snapshot", "view.png"), "rerun-sdk"),
        (("plot", RECORDING, "-o", "figures"), "matplotlib"),
        (("demo", "-o", "demo"), "rerun-sdk"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else value,
)
def test_command_that_needs_more_says_what_in_one_line(
    words: tuple[str, ...], package: str, tmp_path: Path
) -> None:
    done = run_main(LACKS, *words, folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"error: {package}: needed for " in done.stderr
    assert done.stderr.endswith(f"and not installed; `pip install {package}`\n")


@pytest.mark.everyday("sweep-pyarrow", "run-rerun-sdk")
@pytest.mark.parametrize(
    ("words", "package"),
    [
        (("run", "textbook", "-o", "run.mcap", "--rrd", "run.rrd"), "rerun-sdk"),
        (("explain", RECORDING, "--scenario", "as-found.toml", "--rrd", "run.rrd"), "rerun-sdk"),
        (("compare", RECORDING, OTHER, "--rrd", "runs.rrd"), "rerun-sdk"),
        (("convert", RECORDING, "-o", "poses.csv", "-o", "poses.parquet"), "pyarrow"),
        (("sweep", "textbook", "--grid", "seed=0:1", "-o", "seeds.parquet"), "pyarrow"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else value,
)
def test_output_that_needs_more_is_refused_before_any_work(
    words: tuple[str, ...], package: str, tmp_path: Path
) -> None:
    done = run_main(LACKS, *words, folder=tmp_path)
    assert (done.returncode, done.stdout, list(tmp_path.iterdir())) == (2, "", [])
    assert done.stderr.startswith(f"turtlelog: error: {package}: needed for ")
    assert done.stderr.count("\n") == 1


@pytest.mark.thorough
def test_failures_keep_their_stretch_where_no_view_can_be_written(tmp_path: Path) -> None:
    spec = 'format = 1\n[checks.slow]\nholds = "always(speed <= 0.5)"\n'
    (tmp_path / "spec.toml").write_text(spec)
    done = run_main(LACKS, "check", "spec.toml", RECORDING, "--artifacts", "kept", folder=tmp_path)
    (kept,) = (tmp_path / "kept").iterdir()
    assert done.returncode == 1
    assert re.match(r"FAIL: \S+: slow fails, value 1 m/s, limit 0.5 m/s\n", done.stdout)
    assert len(read_recording(kept).samples) > 100
    view = Path("kept") / kept.with_suffix(".rrd").name
    assert f"{view}: no view: rerun-sdk: needed for views" in done.stderr


def test_module_that_a_library_itself_lacks_is_not_blamed_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pandas.py").write_text("import no_such_module")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pandas", raising=False)
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        load_library("pandas")


def test_library_error_is_one_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LibraryError, match=r"^pandas: needed for data frames, and not installed"):
        load_library("pandas")


ABSENT = ["open_viewer", "write_comparison_rrd", "write_figures", "write_run_rrd"]


def run_slim(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    hidden = dict.fromkeys([*LIBRARIES, "bokeh", "PIL"])
    return run_main(f"import sys; sys.modules |= {hidden}\n{code}", folder=folder)


@pytest.mark.thorough
def test_names_without_their_library_leave_the_package(tmp_path: Path) -> None:
    done = run_slim(
        f"import inspect, turtlelog as tl\nfor name in {ABSENT}:\n"
        "    assert name not in dir(tl), name\n    assert name not in tl.__all__, name\n"
        "    assert getattr(tl, name, None) is None, name\n"
        "assert callable(tl.read_run) and 'TABLE_FORMATS' in tl.draw.__all__\n"
        "help(tl); print(len(inspect.getmembers(tl)) > 70)\nfrom turtlelog import *",
        tmp_path,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("True\n")


def test_libraries_are_searched_for_only_when_names_are_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    searched: list[str] = []
    monkeypatch.setattr("importlib.util.find_spec", searched.append)
    monkeypatch.delitem(sys.modules, "matplotlib", raising=False)
    _, list_names = attach_names("turtlelog", tl.__file__)
    assert not searched
    assert "write_figures" not in list_names()
    assert "matplotlib" in searched


def test_every_public_name_of_a_slim_installation_is_there_or_says_what_to_install(
    tmp_path: Path,
) -> None:
    done = run_slim(
        "import ast, importlib, pathlib, turtlelog\n"
        "from turtlelog.errors import LibraryError\n"
        "root = pathlib.Path(turtlelog.__file__).parent\n"
        "for stub in root.rglob('__init__.pyi'):\n"
        "    place = stub.parent.relative_to(root.parent)\n"
        "    package = importlib.import_module('.'.join(place.parts))\n"
        "    for node in ast.parse(stub.read_text()).body:\n"
        "        for name in (each.asname for each in getattr(node, 'names', ())):\n"
        "            if name == '__version__': continue\n"
        "            assert hasattr(package, name) == (name in package.__all__), (stub, name)\n",
        tmp_path,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("package", ["turtlelog", "turtlelog.draw", "turtlelog.draw.figures"])
def test_import_of_a_name_without_its_library_says_what_to_install(
    package: str, tmp_path: Path
) -> None:
    done = run_slim(f"from {package} import write_figures", tmp_path)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "turtlelog.errors.LibraryImportError: matplotlib: needed for figures, and not installed;"
        " `pip install matplotlib`"
    )


def test_use_of_a_name_without_its_library_is_one_of_our_errors(tmp_path: Path) -> None:
    done = run_slim(
        "import turtlelog as tl\n"
        "try:\n    tl.write_figures\nexcept tl.errors.LibraryError as err:\n    print(err)\n"
        "try:\n    from turtlelog import open_viewer\nexcept ImportError as err:\n    print(err)\n"
        "print(hasattr(tl, 'no_such_name'))\nfrom turtlelog import no_such_name",
        tmp_path,
    )
    said = done.stdout.splitlines()
    assert [line.partition(":")[0] for line in said] == ["matplotlib", "rerun-sdk", "False"]
    assert "ImportError: cannot import name 'no_such_name' from 'turtlelog'" in done.stderr


def test_an_unknown_name_suggests_the_nearest() -> None:
    with pytest.raises(AttributeError, match="did you mean read_recording"):
        _ = tl.load_recording  # type: ignore[attr-defined]
    assert not hasattr(tl, "nothing_like_it")
