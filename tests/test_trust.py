"""A recording never chooses code: each command in a fresh process, beside a law that leaves a mark.

SECURITY.md says the same in words.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

import turtlelog as tl
from tests.fresh_process import Answer, run_code, run_command
from turtlelog.errors import ScenarioError
from turtlelog.log.recording.head import HEAD

LAW = """
import pathlib

pathlib.Path(r"{mark}").touch()
from turtlelog.laws import SequentialP


class Law(SequentialP):
    pass
"""

EVIL = "elsewhere/evil.py:Law"

SPEC = """
format = 1
reference = "run.mcap"

[checks.near]
expect = "final.position_error < 0.2"

[checks.kp]
holds = "always(abs(speed) <= law.kp_linear)"

[signals.x]
abs = 0.01
reason = "a centimetre"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Laws that leave a mark wherever they run, and a recording that names one of them."""
    folder = tmp_path_factory.mktemp("trust")
    text = LAW.format(mark=folder / "mark")
    package = folder / "package"
    for path in (folder / "elsewhere", package):
        path.mkdir()
    places = ["elsewhere/evil.py", "marking.py", "sequential-p.py", "package/__init__.py"]
    for place in places:
        (folder / place).write_text(text, encoding="utf-8")
    (package / "inner.py").write_text("from turtlelog.laws import SequentialP as Law\n")
    (folder / "spec.toml").write_text(SPEC)
    write_run(folder / "run.mcap", EVIL)
    write_run(folder / "other.mcap", EVIL)
    tl.write_recording(tl.simulate_run(tl.load_scenario("paper-kp4")), folder / "sound.mcap")
    write_table(folder / "table.parquet", EVIL)
    return folder


@pytest.fixture(autouse=True)
def no_mark(folder: Path) -> Iterator[None]:
    (folder / "mark").unlink(missing_ok=True)
    yield
    (folder / "mark").unlink(missing_ok=True)


def write_run(path: Path, kind: str, *, is_whole: bool = True) -> None:
    """Write a recording that asks for a law; the paper's law made its samples."""
    run = tl.simulate_run(tl.load_scenario("paper-kp4"))
    named = {**run.parameters, "law.kind": kind}
    tl.write_recording(
        dataclasses.replace(run, parameters=named, scenario_is_complete=is_whole), path
    )


def write_table(path: Path, kind: str) -> None:
    """Write the table of a sweep that asks for a law; the textbook's made its rows."""
    base = tl.load_scenario("textbook")
    tl.sweep.run_sweep(tl.sweep.prepare_sweep(base, tl.sweep.build_plan(["seed=0:1"])), path)
    table = tl.sweep.read_result_table(path, kind="sweep")
    asked = table.facts["base"].replace('"sequential-p"', f'"{kind}"')
    assert kind in asked
    named = dataclasses.replace(table, facts={**table.facts, "base": asked})
    tl.sweep.write_result_table(named, path)


def write_law(folder: Path, place: Path) -> str:
    """Return a law of a file that this process has not loaded yet."""
    path = place / "law.py"
    path.write_text(LAW.format(mark=folder / "mark"), encoding="utf-8")
    return f"{path.as_posix()}:Law"


def call(folder: Path, *words: str) -> Answer:
    """Run a command in a process of its own that can import what lies in the folder."""
    return run_command(*words, folder=folder, paths=[folder])


REFUSED = [
    "replay run.mcap",
    "replay run.mcap --law",
    "replay --law run.mcap",
    "replay run.mcap --kp 3",
    "replay run.mcap --goal 3,9",
    "replay run.mcap --set law.kp_linear=3",
    "replay run.mcap --law --set law.kp_linear=3 --json",
    "replay run.mcap --expect-equal -o again.mcap",
    "explain run.mcap",
    "explain run.mcap --metric run.duration --json",
    "explain run.mcap --scenario found.toml --rrd explained.rrd",
    "sweep run.mcap --grid seed=0:1 -o seeds.parquet",
    "sweep run.mcap --set law.kp_linear=3 --grid seed=0:1 -o seeds.parquet",
]
"""What would run the recorded law, and says so in one line."""

ANSWERED = [
    "replay run.mcap --plant",
    "replay run.mcap --law sequential-p",
    "replay run.mcap --set law.kind=sequential-p",
    "replay run.mcap --law --set law.kind=sequential-p",
    "replay run.mcap --scenario paper-kp4",
    "info run.mcap",
    "metrics run.mcap",
    "compare run.mcap sound.mcap --reference other.mcap",
    "check spec.toml run.mcap --artifacts artifacts",
    "check spec.toml run.mcap --reference other.mcap",
    "check --init run.mcap",
    "view run.mcap --save view.rrd",
    "plot run.mcap -o figures --format svg --only heading,plane",
    "convert run.mcap -o bag -o poses.csv",
    "convert --recover run.mcap -o whole.mcap",
]
"""What answers without the law."""

OTHER = [
    "run run.mcap",
    "scenario run.mcap",
    "import run.mcap",
    "replay sound.mcap --scenario run.mcap",
    "compare run.mcap sound.mcap --why",
    "compare sound.mcap run.mcap --why run.duration --json",
]
"""What takes no such recording, or whose answer is of no matter here."""


@pytest.mark.parametrize("words", REFUSED)
def test_a_recorded_law_is_named_and_not_run(folder: Path, words: str) -> None:
    answer = call(folder, *words.split())
    assert not (folder / "mark").exists()
    assert (answer.returncode, answer.stdout, answer.stderr.count("\n")) == (2, "", 1)
    assert answer.stderr.startswith("turtlelog: error: run.mcap: law.kind: expected a built-in law")
    assert answer.stderr.endswith(f"found '{EVIL}'\n")
    assert "--trust-law" in answer.stderr


@pytest.mark.parametrize("changes", ["", "--kp 3", "--set law.kp_linear=3"])
def test_a_law_in_a_table_is_named_and_not_run(folder: Path, changes: str) -> None:
    answer = call(folder, *f"run --from table.parquet --row 0 {changes}".split())
    assert not (folder / "mark").exists()
    assert (answer.returncode, answer.stdout, answer.stderr.count("\n")) == (2, "", 1)
    assert "law.kind: expected a built-in law, or --trust-law" in answer.stderr
    assert answer.stderr.endswith(f"found '{EVIL}'\n")


@pytest.mark.everyday(
    "replay run.mcap --plant",
    "metrics run.mcap",
    "check spec.toml run.mcap --artifacts artifacts",
    "convert --recover run.mcap -o whole.mcap",
)
@pytest.mark.parametrize("words", ANSWERED)
def test_what_needs_no_law_answers_without_it(folder: Path, words: str) -> None:
    answer = call(folder, *words.split())
    assert not (folder / "mark").exists()
    assert answer.returncode in {0, 1}, answer.stderr


@pytest.mark.parametrize("words", OTHER)
def test_nothing_else_runs_it(folder: Path, words: str) -> None:
    answer = call(folder, *words.split())
    assert not (folder / "mark").exists()
    assert answer.returncode in {0, 2}, answer.stderr


@pytest.mark.everyday(
    "replay run.mcap --trust-law",
    "run own.toml",
    "run --from table.parquet --row 0 --trust-law",
    "sweep textbook --law elsewhere/evil.py:Law --grid seed=0:1 -o named.parquet",
)
@pytest.mark.parametrize(
    "words",
    [
        "replay run.mcap --trust-law",
        "replay run.mcap --law --trust-law",
        "replay run.mcap --set law.kp_linear=3 --trust-law",
        f"replay run.mcap --law {EVIL}",
        f"replay run.mcap --set law.kind={EVIL}",
        f"replay sound.mcap --set law.kind={EVIL}",
        f"run textbook --set law.kind={EVIL}",
        "replay sound.mcap --law --scenario own.toml",
        "run own.toml",
        "run --from table.parquet --row 0 --trust-law",
        f"run --from table.parquet --row 0 --law {EVIL}",
        "sweep run.mcap --grid seed=0:1 --trust-law -o trusted.parquet",
        "compare run.mcap sound.mcap --why --trust-law",
        f"sweep textbook --law {EVIL} --grid seed=0:1 -o named.parquet",
        f"sweep textbook --grid law.kind={EVIL},posture -o varied.parquet",
    ],
)
def test_a_law_that_the_user_named_or_trusted_runs(folder: Path, words: str) -> None:
    (folder / "own.toml").write_text(f'[law]\nkind = "{EVIL}"\n')
    answer = call(folder, *words.split())
    assert (folder / "mark").exists()
    assert answer.returncode == 0, answer.stderr


@pytest.mark.parametrize(
    "kind",
    [
        "{folder}/elsewhere/evil.py:Law",
        "./elsewhere/evil.py:Law",
        "elsewhere/../elsewhere/evil.py:Law",
        "marking:Law",
        "package.inner:Law",  # importing it runs the package around it
        "sequential-p:Law",
        "sequential-p.py:Law",
    ],
)
def test_a_law_that_hides_is_not_run_either(folder: Path, tmp_path: Path, kind: str) -> None:
    kind = kind.format(folder=folder)
    write_run(tmp_path / "hides.mcap", kind)
    require_trust(folder, kind, "replay", str(tmp_path / "hides.mcap"))


@pytest.mark.parametrize("base", ["paper-kp4", "own.toml"])
def test_a_law_in_a_part_of_a_scenario_is_not_run_either(
    folder: Path, tmp_path: Path, base: str
) -> None:
    (folder / "own.toml").write_text('name = "mine"\n')
    write_run(tmp_path / "part.mcap", EVIL, is_whole=False)
    require_trust(folder, EVIL, "replay", str(tmp_path / "part.mcap"), "--scenario", base)


def require_trust(folder: Path, kind: str, *words: str) -> None:
    """Require that a command names a law and leaves it alone, and runs it where it is trusted."""
    refused = call(folder, *words)
    assert not (folder / "mark").exists()
    assert (refused.returncode, refused.stdout) == (2, "")
    assert f"found '{kind}'" in refused.stderr.splitlines()[-1]
    assert call(folder, *words, "--trust-law").returncode == 0
    assert (folder / "mark").exists()


def test_a_scenario_in_a_foreign_file_is_not_run(folder: Path, tmp_path: Path) -> None:
    """The attachment stands, the record that makes it a recording of ours does not."""
    path = tmp_path / "foreign.mcap"
    whole = (folder / "run.mcap").read_bytes()
    path.write_bytes(whole.replace(HEAD.encode(), b"somebody!"[: len(HEAD)]))
    for words in (["--law"], [], ["--scenario", "paper-kp4"], ["--law", "--trust-law"]):
        call(folder, "replay", str(path), *words)
        assert not (folder / "mark").exists()


SUITE = """
import pytest
from turtlelog.laws import SequentialP, SequentialPParameters
from turtlelog import load_scenario, override_scenario
from turtlelog.compare import Tolerance
from turtlelog.scenario import restore_scenario

@pytest.mark.recordings("{folder}/run.mcap"{trust})
def test_it(recording):
    {body}
"""


def run_suite(folder: Path, tmp_path: Path, body: str, trust: str = "") -> tuple[int, str]:
    suite = tmp_path / "test_suite.py"
    (tmp_path / "conftest.py").write_text(
        "import pytest\n@pytest.fixture\ndef recording(turtlelog_recording):\n"
        "    return turtlelog_recording\n"
    )
    suite.write_text(SUITE.format(folder=folder.as_posix(), trust=trust, body=body))
    # Hypothesis, which the suite does not use, takes as long to load as all the rest.
    words = ["-q", "-p", "no:cacheprovider", "-p", "no:hypothesispytest", str(suite)]
    words += ["--rootdir", str(tmp_path), "--turtlelog-accept"]
    code = f"import sys, pytest; sys.exit(pytest.main({words}))"
    answer = run_code(code, folder=folder)
    return answer.returncode, answer.stdout


DRIVEN = "assert recording.driven_by().matches(recording, tolerance=Tolerance(abs=1e-9))"


@pytest.mark.thorough
def test_driven_by_names_the_recorded_law_and_does_not_run_it(folder: Path, tmp_path: Path) -> None:
    code, text = run_suite(folder, tmp_path, DRIVEN)
    assert not (folder / "mark").exists()
    assert code == 1
    assert EVIL in text
    assert "trust_law=True" in text


def test_the_marker_lets_the_recorded_law_run(folder: Path, tmp_path: Path) -> None:
    code, text = run_suite(folder, tmp_path, DRIVEN, trust=", trust_law=True")
    assert (folder / "mark").exists()
    assert code == 0, text


def test_trust_that_one_test_gives_is_not_anothers(folder: Path, tmp_path: Path) -> None:
    """One session reads a recording once for both, and each must ask by itself."""
    bare = f"""{DRIVEN}


@pytest.mark.recordings("{folder.as_posix()}/run.mcap")
def test_untrusting(recording):
    (recording.path.parent / "mark").unlink()
    {DRIVEN}
"""
    code, text = run_suite(folder, tmp_path, bare, trust=", trust_law=True")
    assert code == 1
    assert "1 failed, 1 passed" in text
    assert "trust_law=True) to run the code" in text


@pytest.mark.everyday("body0", "body2")
@pytest.mark.parametrize(
    "body",
    [
        "assert recording.driven_by(SequentialP(SequentialPParameters(kp_linear=4.0,"
        " kp_angular=4.0, projection='bearing', wrap_error=False, pause_ticks=34))"
        ").matches(recording)",
        "assert recording.driven_by(load_scenario('paper-kp4')).matches(recording)",
        "assert recording.driven_by(override_scenario(restore_scenario(recording.run),"
        " {'law.kind': 'sequential-p'})).replay()",
        "assert recording.matches(recording) and recording.holds('always(speed <= 1)')",
    ],
)
def test_a_test_that_names_its_law_does_not_load_the_recorded_one(
    folder: Path, tmp_path: Path, body: str
) -> None:
    code, text = run_suite(folder, tmp_path, body)
    assert not (folder / "mark").exists()
    assert code == 0, text


@pytest.mark.parametrize("replay", [tl.replay_law, tl.replay_loop])
def test_python_asks_for_trust_as_well(folder: Path, tmp_path: Path, replay: object) -> None:
    write_run(tmp_path / "run.mcap", write_law(folder, tmp_path))
    run = tl.read_recording(tmp_path / "run.mcap")
    scenario = tl.override_scenario(tl.scenario.restore_scenario(run), {"law.kp_linear": 3.0})
    for ask in (
        lambda: replay(run),  # type: ignore[operator]
        lambda: replay(run, scenario),  # type: ignore[operator]
        lambda: tl.simulate_run(scenario),
        lambda: tl.simulate.run_live(scenario, realtime=False),
        lambda: tl.Recorder(folder / "live.mcap", scenario),
        lambda: tl.explain.attribute_scenario(scenario),
    ):
        with pytest.raises(tl.TurtlelogError):
            ask()
    assert not (folder / "mark").exists()
    assert replay(run, trust_law=True).first_difference is None  # type: ignore[operator]
    assert (folder / "mark").exists()


def test_reading_printing_and_overriding_load_no_code(folder: Path, tmp_path: Path) -> None:
    kind = write_law(folder, tmp_path)
    scenario = tl.parse_scenario(f'[law]\nkind = "{kind}"\nkp_linear = 3.0')
    changed = tl.override_scenario(scenario, {"law.kp_linear": 4.0, "seed": 1})
    assert tl.parse_scenario(tl.format_scenario(changed)) == changed
    assert tl.scenario.flatten_scenario(changed)["law.kp_linear"] == 4.0
    assert not (folder / "mark").exists()
    assert tl.scenario.resolve_scenario(changed).law.parameters.kp_linear == 4.0
    assert (folder / "mark").exists()


def test_a_wrong_key_names_all_who_wrote_into_the_law(folder: Path, tmp_path: Path) -> None:
    kind = write_law(folder, tmp_path)
    scenario = tl.parse_scenario(f'law.kind = "{kind}"', source="own.toml")
    changed = tl.override_scenario(scenario, {"law.kp_lin": 4.0}, source="--set")
    line = r"\Aown\.toml, --set: law\.kp_lin: unknown key; did you mean kp_linear\?\Z"
    with pytest.raises(ScenarioError, match=line):
        tl.scenario.resolve_scenario(changed)
