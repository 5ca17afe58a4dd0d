import json
import re
from pathlib import Path

import pytest

import turtlelog as tl
from tests.draw.rerun.rrds import make_foreign_run
from turtlelog.cli.app import main

RECORDING = Path(__file__).parents[2] / "recordings" / "paper" / "kp4.mcap"
SHOWN = {name: kind.title for name, kind in tl.draw.FIGURES.items()}


def run_plot(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(["plot", *words])
    printed = capsys.readouterr()
    assert isinstance(ended.value.code, int)
    return ended.value.code, printed.out, printed.err


def split_answer(out: str) -> tuple[str, list[str]]:
    """Return what is shown, in one line, and the lines on files."""
    lines = out.splitlines()
    written = [line for line in lines if line.startswith("wrote ")]
    assert lines[len(lines) - len(written) :] == written
    return " ".join(lines[: len(lines) - len(written)]), written


ENDING = "paper-kp4: missed the goal by 8.52 mm (allowed: 6.69 mm) after 11.2 s."


def test_plot_writes_what_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [str(RECORDING), "-o", str(tmp_path), "--only", "heading,plane", "--format", "svg"]
    code, out, err = run_plot(capsys, *words)
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        ENDING,
        "2 figures of paper-kp4: heading, plane.",
        *(f"wrote {tmp_path / name}" for name in ("heading.svg", "plane.svg")),
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["heading.svg", "plane.svg"]


def test_many_runs_are_drawn_in_the_order_of_their_gains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(RECORDING.with_name(f"{name}.mcap")) for name in ("kp10", "kp2")]
    words = [*paths, "-o", str(tmp_path), "--only", "heading", "--format", "svg,svg"]
    code, out, _ = run_plot(capsys, *words)
    path = tmp_path / "heading.svg"
    said, written = split_answer(out)
    assert (code, written) == (0, [f"wrote {path}"])
    assert said == (
        "2 runs end 0.00101 m (paper-kp2) to 0.107 m (paper-kp10) from the goal."
        f" {path} shows the figure heading of paper-kp10 and paper-kp2: {SHOWN['heading']}."
    )
    comments = re.findall(">(paper-kp[0-9]+)</text>", (tmp_path / "heading.svg").read_text())
    assert comments == ["paper-kp2", "paper-kp10"]


def test_json_names_files_titles_and_the_paper_s_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["-o", str(tmp_path), "--only", "plant", "--format", "pdf", "--json"]
    answer = json.loads(run_plot(capsys, *words)[1])
    (figure,) = answer["figures"]
    assert figure == {
        "file": str(tmp_path / "plant.pdf"),
        "figure": "plant",
        "title": "Impulse, step and ramp response of the plant 1/s",
        "paper": "2",
    }
    assert (answer["files"], answer["tables"]) == ([], [])


def test_of_somebody_s_recording_that_is_drawn_which_it_holds_and_the_rest_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All figures that a bag allows are drawn."""
    tl.write_recording(make_foreign_run(50), tmp_path / "bag.mcap")
    words = [str(tmp_path / "bag.mcap"), "-o", str(tmp_path / "out"), "--format", "svg"]
    code, out, err = run_plot(capsys, *words)
    drawn = ["heading.svg", "position.svg", "turn-rate.svg", "speed.svg", "plane.svg", "panel.svg"]
    said, written = split_answer(out)
    assert "6 figures and 2 tables of bag: heading, position, " in said
    names = [Path(line.removeprefix("wrote ")).name for line in written]
    assert (code, names) == (0, [*drawn, "whole-runs.tex", "metrics.tex"])
    told = err.splitlines()
    assert told[0].startswith("plot: left out plant, step-responses, root-locus, ")
    assert told[0].endswith(": needs the controller's samples")
    assert all(line.startswith("plot: left out ") for line in told)
    answer = json.loads(run_plot(capsys, *words, "--json")[1])
    assert [f"plot: {line}" for line in answer["left_out"]] == told


def test_what_was_asked_for_by_name_and_is_not_held_ends_with_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tl.write_recording(make_foreign_run(50), tmp_path / "bag.mcap")
    words = [str(tmp_path / "bag.mcap"), "-o", str(tmp_path / "out"), "--only", "plant"]
    code, out, err = run_plot(capsys, *words)
    assert (code, out) == (2, "")
    assert err == "turtlelog: error: figure plant needs the law's gain\n"


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--only", "headng"], 'no figure "headng"; did you mean heading'),
        (["--only", "heading"], "figure heading needs a recording"),
        (["--only", "plant,"], "--only plant,: must be names separated by commas"),
        (["--format", "gif"], "format: expected some of pdf, png, svg, found 'gif'"),
        (["--format", ""], "--format : must be names"),
        (["--for", "wall"], "--for"),
        (["--text-width", "nan"], "text width: expected 120 to 1000 mm, found nan"),
        (["--for", "slide", "--text-width", "150"], "--text-width: needs --for column or page"),
        (
            [str(RECORDING), "--only", "gains,plant", "--to", "3"],
            "--to: needs a figure over time, not gains, plant",
        ),
        (["--dpi", "200", "--format", "pdf,svg"], "--dpi: is for png files, not pdf, svg"),
        (["--dpi", "601", "--format", "png"], "dpi: expected 50 to 600, found 601"),
        (["--from", "nan"], "--from nan: must be a finite time [s]"),
        (["--to", "inf"], "--to inf: must be a finite time [s]"),
        (["--from", "3", "--to", "3"], "from: expected a time before 3 s, where it ends, found 3"),
        (["--to", "3"], "to: needs a recording to cut"),
        ([str(RECORDING), "--to", "99"], "s, for which the runs last, found 99 s"),
        ([str(RECORDING), "--from", "-1"], "s, for which the runs last, found -1 s"),
        (["none.mcap"], "none.mcap"),
    ],
)
def test_bad_words_are_one_line(
    words: list[str], match: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run_plot(capsys, "-o", str(tmp_path / "new"), *words)
    assert (code, out) == (2, "")
    assert match in err
    assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_a_file_in_place_of_the_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    code, _, err = run_plot(capsys, "-o", str(tmp_path / "file"))
    assert code == 2
    assert "file: is a file; name a folder, or a figure that ends in .pdf, .png or .svg" in err


def test_a_file_holds_one_figure_that_gives_an_overview(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run_plot(capsys, str(RECORDING), "-o", str(tmp_path / "kp4.png"))
    path = tmp_path / "kp4.png"
    said, written = split_answer(out)
    assert (code, written) == (0, [f"wrote {path}"])
    assert said == f"{ENDING} {path} shows the figure panel of paper-kp4: {SHOWN['panel']}."
    assert err == "plot: the figure panel; --only chooses another (turtlelog list figures)\n"
    assert (tmp_path / "kp4.png").read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["kp4.png"]


def test_a_file_holds_the_figure_that_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(RECORDING), "-o", str(tmp_path / "a.SVG"), "--only", "heading", "--json"]
    code, out, err = run_plot(capsys, *words)
    assert (code, err) == (0, "")
    (figure,) = json.loads(out)["figures"]
    assert (figure["file"], figure["figure"]) == (str(tmp_path / "a.SVG"), "heading")
    assert "<svg" in (tmp_path / "a.SVG").read_text()


def test_without_recordings_a_file_shows_theory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run_plot(capsys, "-o", str(tmp_path / "a.pdf"))
    assert code == 0
    assert "plot: the figure step-responses" in err


@pytest.mark.thorough
def test_a_folder_gets_each_figure_once_and_table_1_after_the_final_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All usual figures are drawn, as PDF."""
    assert run_plot(capsys, str(RECORDING), "-o", str(tmp_path / "out"))[0] == 0
    written = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert written == sorted(
        [
            *(f"{name}.pdf" for name, kind in tl.draw.FIGURES.items() if kind.is_usual),
            "metrics.tex",
            "table1.tex",
            "whole-runs.tex",
        ]
    )


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["-o", "a.png", "--only", "plane,heading"], "--only: a.png has room for one figure"),
        (
            ["-o", "a.png", "--format", "pdf"],
            "--format: leave it out",
        ),
        (["-o", "no/a.png"], "no/a.png: there is no such folder"),
        (["-o", "a.png", "--only", "headng"], "did you mean heading"),
        (["-o", "folder.png"], "folder.png: this is a folder; name a file to write"),
    ],
)
def test_a_bad_file_is_one_line(
    words: list[str],
    match: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder.png").mkdir()
    code, out, err = run_plot(capsys, str(RECORDING), *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert match in err
    assert [path.name for path in tmp_path.iterdir()] == ["folder.png"]


def test_a_preset_or_a_scenario_file_is_simulated_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "mine.toml"
    scenario.write_text("[law]\nkp_angular = 4.0\n")
    for word, name in (("paper-kp10", "paper-kp10"), (str(scenario), "textbook")):
        target = tmp_path / "bode.svg"
        code, out, _ = run_plot(capsys, word, "-o", str(target), "--only", "bode")
        said, written = split_answer(out)
        assert (code, written) == (0, [f"wrote {target}"])
        assert said.startswith(
            (f"{name}: missed the goal by ", f"{name}: reached the goal within ")
        )
        assert said.endswith(f" {target} shows the figure bode of {name}: {SHOWN['bode']}.")
    code, out, err = run_plot(capsys, "nix.toml", "-o", str(tmp_path / "a.svg"))
    assert (code, out) == (2, "")
    assert "nix.toml: no such file" in err


@pytest.mark.thorough
def test_the_attribution_is_that_of_explain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kp10 = str(RECORDING.with_name("kp10.mcap"))
    words = [kp10, "-o", str(tmp_path / "why.svg"), "--only", "attribution", "--json"]
    code, out, err = run_plot(capsys, *words, "--metric", "final.heading_error")
    assert (code, err) == (0, "")
    assert json.loads(out)["figures"][0]["figure"] == "attribution"
    with pytest.raises(SystemExit):
        main(["explain", kp10, "--metric", "final.heading_error", "--json"])
    found = json.loads(capsys.readouterr().out)["attribution"]
    texts = re.findall(r">([^<]+)</text>", (tmp_path / "why.svg").read_text("utf-8"))
    assert f"what caused {found['as_logged']:.3f} deg" in texts
    (share,) = [one["contribution"] for one in found["contributions"] if one["cause"] == "pause"]
    assert any(f"{-share:.3f} deg".replace("-", "\N{MINUS SIGN}") in text for text in texts)


@pytest.mark.thorough
def test_the_luck_of_a_metric_is_drawn_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    kp10, target = str(RECORDING.with_name("kp10.mcap")), tmp_path / "luck.svg"
    words = [kp10, "-o", str(target), "--only", "luck", "--metric", "final.heading_error"]
    code, out, err = run_plot(capsys, *words, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["figures"][0]["figure"] == "luck"
    texts = re.findall(r">([^<]+)</text>", target.read_text("utf-8"))
    assert any(text.startswith("final.heading_error: 0.39 to 4.8 deg with all") for text in texts)


def test_a_violation_has_the_moments_of_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kp10, formula = str(RECORDING.with_name("kp10.mcap")), "always(abs(cross_track) <= 0.05)"
    target = tmp_path / "outside.svg"
    words = [kp10, "-o", str(target), "--only", "violation", "--expect", formula]
    code, out, err = run_plot(capsys, *words)
    assert (code, split_answer(out)[1], err) == (0, [f"wrote {target}"], "")
    with pytest.raises(SystemExit):
        main(["check", kp10, "--expect", formula, "--json"])
    (result,) = json.loads(capsys.readouterr().out)["results"]
    texts = re.findall(r">([^<]+)</text>", target.read_text("utf-8"))
    worst, first = f"at {result['value_s']:.3f} s", f"at {result['first_violation_s']:.3f} s"
    assert {f"worst -{result['value']:.5g} m", worst, first} < {*texts}


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--metric", "overshoot"], "--metric: needs --only attribution, gains, luck or strips"),
        (["--only", "plane", "--metric", "a"], "--metric: needs --only attribution"),
        (["--only", "plane", "--expect", "speed < 1"], "--expect: needs --only violation"),
        (["--only", "violation"], "--only violation: needs --expect FORMULA"),
        (["--only", "violation", "--expect", "speed <"], "--expect"),
        (["--only", "gains", "--metric", "overshot"], "overshot"),
        (["--only", "gains", "--metric", "a,"], "--metric a,: must be names separated by commas"),
        (["--only", "attribution", "--metric", "final.speed"], "final.speed"),
        (["--only", "luck", "--metric", "final.speed"], "final.speed"),
    ],
)
def test_figures_that_are_asked_in_vain_are_one_line(
    words: list[str], match: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run_plot(capsys, str(RECORDING), "-o", str(tmp_path / "new"), *words)
    assert (code, out) == (2, "")
    assert match in err
    assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_dots_are_for_files_that_have_some(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "plant.png"
    code, _, err = run_plot(capsys, "-o", str(picture), "--only", "plant", "--dpi", "72")
    assert (code, err) == (0, "")
    assert int.from_bytes(picture.read_bytes()[16:20]) == 513
    words = ["-o", str(tmp_path / "all"), "--only", "plant", "--dpi"]
    refused = [
        (["72"], "--dpi: is for png files, not pdf"),
        (["49", "--format", "png"], "dpi: expected 50 to 600, found 49"),
    ]
    for more, line in refused:
        code, out, err = run_plot(capsys, *words, *more)
        assert (code, out) == (2, "")
        assert line in err
        assert err.count("\n") == 1
    assert not (tmp_path / "all").exists()


@pytest.mark.parametrize(
    ("words", "pixels"),
    [
        (["--for", "slide"], (1920, 1080)),
        (["--for", "slide", "--dpi", "72"], (960, 540)),
        (["--for", "page", "--dpi", "100"], (712, 442)),
    ],
)
def test_a_png_has_the_pixels_that_are_asked_for(
    words: list[str],
    pixels: tuple[int, int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "a.png"
    code, _, err = run_plot(capsys, str(RECORDING), "-o", str(path), "--only", "heading", *words)
    assert (code, err) == (0, "")
    width, height = (int.from_bytes(path.read_bytes()[at : at + 4], "big") for at in (16, 20))
    assert width == pixels[0]
    assert height == pytest.approx(pixels[1], abs=0 if "slide" in words else 60)


def test_a_number_of_processes_below_one_is_refused_for_one_figure_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(RECORDING), "-o", str(tmp_path / "one.png"), "--jobs", "0"]
    line = "turtlelog: error: --jobs 0: must be at least 1\n"
    assert run_plot(capsys, *words) == (2, "", line)
