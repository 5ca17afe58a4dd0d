"""What a user types wrong, and the line that says what to type instead."""

import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import Call

LFS = (
    "version https://git-lfs.github.com/spec/v1\n"
    "oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\nsize 12345\n"
)
NO_SPEC = (
    "kp10.mcap is a recording, but check needs a specification first: turtlelog check SPEC"
    ' kp10.mcap, or --expect "rotate.overshoot <= 2", or create one with --init kp10.mcap'
)


@pytest.mark.parametrize(
    ("typed", "line"),
    [
        (["check", "kp10.mcap"], NO_SPEC),
        (
            ["check", "kp10.mcap", "spec.toml"],
            "kp10.mcap is a recording; the specification goes first: turtlelog check spec.toml"
            " kp10.mcap",
        ),
        (
            ["tune", "paper"],
            "tune needs --grid KEY=A:B and --minimise or --maximise, for example: turtlelog tune"
            " paper --grid law.kp_linear=0.5:12 --minimise run.duration",
        ),
        (
            ["run", "papr"],
            'no preset or file "papr"; did you mean paper? List: turtlelog list presets',
        ),
        (
            ["run", "--set", "law.kp=4"],
            "sequential-p has no key law.kp; did you mean law.kp_angular or law.kp_linear?"
            " --kp 4 sets the gain of every loop",
        ),
        (
            ["run", "--set", "law=posture", "--set", "law.kp=4"],
            "--set: law: expected a value, found a key below it",
        ),
        (
            ["run", "--kp-linear", "2"],
            "turtlelog run has no option --kp-linear; did you mean --set law.kp_linear=2?"
            " All options: turtlelog run --help-all",
        ),
        (["run", "--goal", "8", "3"], "--goal 8 3: did you mean --goal 8,3?"),
        (["metrics", "kp10.mcap", "--goal", "8", "3"], "--goal 8 3: did you mean --goal 8,3?"),
        (["theory", "--period", "-1"], "--period -1: must be greater than 0"),
        (["theory", "--lag", "-1"], "--lag -1: must be 0 or greater"),
        (
            ["check", "kp10.mcap", "--expect", "always(sped < 1)"],
            '--expect: column 8: unknown name "sped"; did you mean speed or seed?'
            " (the law of this run has no states)",
        ),
        (
            ["plot", "kp10.mcap", "--kind", "map"],
            "kp10.mcap is a recording; --kind, --x, --y and --at need one table written by"
            " turtlelog sweep",
        ),
        (["info", "lfs.mcap"], "lfs.mcap: this is a Git LFS pointer, not the file: git lfs pull"),
        (["metrics", "kp1.mcap"], "kp1.mcap: no such file; did you mean kp10.mcap?"),
        (["metrics", "kp10"], "kp10: no such file; did you mean kp10.mcap?"),
        (["metrics", "paper-kp3"], "paper-kp3: no such file; did you mean paper-kp4, paper-kp2"),
        (
            ["metrics", "spec.toml"],
            "spec.toml: a scenario or specification, not a recording; turtlelog run FILE.toml -o"
            " FILE.mcap makes one of a scenario",
        ),
        (
            ["explain", "folder"],
            "folder: a folder of 2 recordings, not one bag (it has no readable metadata.yaml): name"
            " one of them: a.mcap, b.mcap",
        ),
        (
            ["metrics", "kp10.mcap", "--only", "x"],
            "turtlelog metrics has no option --only; did you mean --metric? All options: turtlelog"
            " metrics --help-all",
        ),
        (
            ["simulate"],
            'turtlelog has no command "simulate"; did you mean run? All commands: turtlelog --help',
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_mistake_is_answered_with_what_to_type(
    call: Call,
    kp10: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: list[str],
    line: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    for name in ("kp10.mcap", "folder/a.mcap", "folder/b.mcap"):
        shutil.copy(kp10, name)
    Path("spec.toml").write_text('format = 1\nchecks.a.expect = "run.duration < 99"\n')
    Path("lfs.mcap").write_text(LFS)
    answer = call(*typed)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert answer.err.startswith(f"turtlelog: error: {line}")


@pytest.mark.parametrize(
    "typed",
    [
        ["metrics", "paper-kp4"],
        ["compare", "paper-kp4", "paper-kp10"],
        ["check", "paper-kp4", "--expect", "rotate.overshoot <= 2"],
        ["replay", "paper-kp4"],
    ],
    ids=lambda words: words[0],
)
def test_a_preset_in_the_place_of_a_recording_is_simulated(call: Call, typed: list[str]) -> None:
    answer = call(*typed)
    assert answer.code == 0
    assert answer.err.startswith("paper-kp4: a preset, simulated first\n")


def test_a_file_of_the_name_of_a_preset_is_read(
    call: Call, kp10: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(kp10, "paper-kp4")
    (found,) = call("metrics", "paper-kp4", "--json").json
    assert found["name"] == "paper-kp10"


def test_a_folder_of_the_name_of_a_preset_is_no_scenario(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("paper").mkdir()
    assert call("scenario", "paper").code == 0
    assert call("run").code == 0


def test_a_name_that_a_recording_knows_is_judged(call: Call, kp10: Path) -> None:
    answer = call("check", kp10, "--expect", "law.kp_linear == 10")
    assert (answer.code, answer.err) == (0, "")
