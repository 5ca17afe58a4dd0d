"""Movies: which moment each picture shows, what moves in it, and files that can be read back."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from tests.fresh_process import run_command
from turtlelog import Run, read_run
from turtlelog.charts.time_plots import locate_run, plan_film
from turtlelog.draw import movie as movies, write_movie
from turtlelog.draw.figures.figure_curves import label_runs
from turtlelog.draw.movie import _set_stage, draw_pictures
from turtlelog.errors import ShowError

RECORDINGS = Path(__file__).parents[2] / "recordings" / "paper"


@pytest.fixture(scope="module")
def runs() -> tuple[Run, ...]:
    return tuple(read_run(RECORDINGS / f"kp{kp}.mcap") for kp in (1, 10))


def test_a_film_lasts_from_the_first_pose_to_the_last_and_then_stands_still(
    runs: tuple[Run, ...],
) -> None:
    film = plan_film(runs, timeline="sim_time", length_s=4.0, pictures_per_s=10.0)
    last_s = max((run.poses.time_ns[-1] - run.start_ns) / 1e9 for run in runs)
    assert len(film.time_s) == 40
    assert film.time_s[film.driving - 1] == film.time_s[-1] == pytest.approx(last_s)
    assert len(film.time_s) - film.driving == 12
    assert (np.diff(film.time_s[: film.driving]) > 0.0).all()
    assert film.pace == pytest.approx((last_s - film.time_s[0]) / 2.8)


@pytest.mark.parametrize(("duration_s", "whole_s"), [(0.5, 3.0), (5.0, 6.5), (20.0, 10.0)])
def test_a_film_that_nobody_told_a_length_is_real_time_where_that_can_be_watched(
    runs: tuple[Run, ...], duration_s: float, whole_s: float
) -> None:
    from turtlelog.charts.time_plots import _choose_length

    assert _choose_length(duration_s) == pytest.approx(whole_s)


def test_on_the_timeline_of_a_phase_all_runs_begin_it_at_zero(runs: tuple[Run, ...]) -> None:
    film = plan_film(runs, timeline="translate_time", length_s=None, pictures_per_s=2.0)
    for run, zero_ns in zip(runs, film.zeros_ns, strict=True):
        before, after = locate_run(run, zero_ns, np.array([-0.2, 0.5]))[0]
        assert np.hypot(*(before - run.poses.xy_m[0])) < 1e-6
        assert np.hypot(*(after - run.poses.xy_m[0])) > 0.1
    with pytest.raises(ShowError, match="expected one of sim_time, translate_time, found 'x'"):
        plan_film(runs, timeline="x", length_s=None, pictures_per_s=2.0)


def test_turtles_drive_and_in_the_end_nothing_moves(runs: tuple[Run, ...]) -> None:
    film = plan_film(runs, timeline="sim_time", length_s=2.0, pictures_per_s=5.0)
    pictures = list(draw_pictures(runs, film, size=(640, 360)))
    assert {picture.shape for picture in pictures} == {(360, 640, 3)}
    moving = [np.abs(np.diff(pair, axis=0)).any() for pair in itertools.pairwise(pictures)]
    still = len(film.time_s) - film.driving
    assert all(moving[: film.driving - 1])
    assert not any(moving[film.driving :])
    assert len(moving) - film.driving == still - 1


def test_a_gif_can_be_read_back(runs: tuple[Run, ...], tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    path = tmp_path / "run.gif"
    write_movie(runs[1:], path, length_s=1.0, on_picture=lambda *count: seen.append(count))
    with Image.open(path) as movie:
        assert movie.size == (800, 450)
        assert movie.info["duration"] == 50
        assert getattr(movie, "n_frames") > 10  # noqa: B009 (equal ones are joined)
    assert seen[-1] == (20, 20)


def test_an_mp4_can_be_read_back(
    runs: tuple[Run, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A film is coded and decoded."""
    cv2 = pytest.importorskip("cv2")
    monkeypatch.setitem(movies.PICTURES_PER_S, ".mp4", 4.0)
    path = tmp_path / "run.mp4"
    write_movie(runs, path, length_s=2.0)
    movie = cv2.VideoCapture(str(path))
    assert (movie.get(cv2.CAP_PROP_FRAME_WIDTH), movie.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (
        1280,
        720,
    )
    assert movie.get(cv2.CAP_PROP_FRAME_COUNT) == 8
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["plot", "{kp1}", "--movie", "a.avi"], "the name must end in .mp4 or .gif"),
        (["plot", "--movie", "a.gif"], "no recordings to film; name them"),
        (["plot", "{kp1}"], "plot needs a file or a folder to write: -o NAME.png or -o FOLDER"),
        (["plot", "{kp1}", "--movie", "a.gif", "--length", "nan"], "1 to 60 s for .gif, found nan"),
        (["plot", "{kp1}", "--movie", "a.gif", "--length", "0.9"], "1 to 60 s for .gif, found 0.9"),
        (["plot", "{kp1}", "--movie", "no/a.gif"], "there is no such folder to write to"),
        (["plot", "{kp1}", "-o", "x", "--length", "3"], "needs --movie NAME.mp4"),
        (["plot", "{kp1}", "-o", "x", "--timeline", "y"], "needs --movie NAME.mp4"),
        (["view", "{kp1}", "--movie", "a.gif", "--timeline", "y"], "found 'y'"),
        (["view", "{kp1}", "--movie", "a.gif", "--follow"], "--follow: leave out --save"),
    ],
)
def test_what_cannot_be_filmed_is_refused_in_a_line(
    words: list[str], found: str, tmp_path: Path
) -> None:
    """The first of these tests loads what makes films."""
    words = [word.format(kp1=RECORDINGS / "kp1.mcap") for word in words]
    done = run_command(*words, folder=tmp_path)
    assert done.returncode == 2
    assert found in done.stderr
    assert done.stderr.count("\n") == 1
    assert not [*tmp_path.iterdir()]


@pytest.mark.thorough
def test_both_commands_film(tmp_path: Path) -> None:
    """Two films are made."""
    kp1 = str(RECORDINGS / "kp1.mcap")
    reached = "paper-kp1: reached the goal within 2.52 mm after 20.5 s.\n"
    answers = {"plot": f"{reached}plot.gif shows paper-kp1 driving.\n", "view": reached}
    for command, answer in answers.items():
        done = run_command(
            command, kp1, "--movie", f"{command}.gif", "--length", "1", folder=tmp_path
        )
        said = f"{answer}wrote {command}.gif\n"
        assert (done.returncode, done.stdout + done.stderr) == (0, said)
    assert (tmp_path / "plot.gif").read_bytes() == (tmp_path / "view.gif").read_bytes()


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (("kp1", "kp10"), ["kp1", "kp10"]),
        (
            tuple(f"a-controller-with-a-long-name-{kp}-tuned" for kp in (1, 10)),
            ["Kp 1, pause 34 ticks, backlog 6", "Kp 10, pause 33 ticks, backlog 5"],
        ),
        (
            ("from-the-hall-on-a-monday-afternoon", "outdoors-in-the-rain-with-a-new-law"),
            None,
        ),
    ],
    ids=["short", "alike", "unlike"],
)
def test_every_run_is_named_above_the_picture(
    runs: tuple[Run, ...], names: tuple[str, ...], shown: list[str] | None
) -> None:
    named = [replace(run, name=name) for run, name in zip(runs, names, strict=True)]
    if shown is None:  # these differ by more than their gains, so that their names must do
        named = [replace(run, parameters={}) for run in named]
    film = plan_film(named, timeline="sim_time", length_s=1.0, pictures_per_s=2.0)
    figure = Figure(figsize=(12.8, 7.2), dpi=62.5)
    FigureCanvasAgg(figure)
    _set_stage(figure, named, film)
    told = [text.get_text() for text in figure.texts if text.get_text()]
    assert told == (label_runs(named) if shown is None else shown)
