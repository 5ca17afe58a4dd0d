"""The luck of a run in the recording of its explanation."""

from pathlib import Path

import numpy as np
import pytest

from tests.draw.rerun.rrds import (
    join_strips,
    list_entities,
    make_attribution,
    read_layout,
    read_static,
    verify,
)
from tests.known import known
from tests.lucky_runs import NOISY, measure_lucky, simulate_lucky
from turtlelog.draw import write_explanation_rrd

WITHOUT = {"queue": "textbook", "pause": "paper-kp4"}
RUN = simulate_lucky("paper-kp10")


@pytest.fixture(scope="module")
def lucky_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("luck") / "luck.rrd"
    what_ifs = {name: simulate_lucky(preset) for name, preset in WITHOUT.items()}
    found = make_attribution(RUN, {"queue": 0.05, "pause": 0.05})
    write_explanation_rrd(RUN, found, what_ifs, path, luck=measure_lucky("paper-kp10"))
    return path


def test_the_value_over_the_starts_is_a_view_beside_the_steps(lucky_rrd: Path) -> None:
    verify(lucky_rrd)
    titles = list(read_layout(lucky_rrd))
    assert "With other starts" in titles
    words = read_static(lucky_rrd, "/luck/words", "Points2D:labels")
    assert words[:2] == [
        "final.position_error: 39 to 473 mm with all effects, at most 5.7 mm without queue and"
        " pause.",
        "It depends on single samples.",
    ]
    names = {"with all effects", "without queue", "without pause", "without both"}
    assert {*names, "this run: 107 mm", "-0.458", "0.458"} <= {*words}


def test_a_larger_error_stands_higher(lucky_rrd: Path) -> None:
    luck = measure_lucky("paper-kp10")
    places = read_static(lucky_rrd, "/luck/curve_4/starts", "Points2D:positions")
    across, down = np.array(places).T
    assert len(places) == 65
    assert np.corrcoef(down, luck.curves[0].values)[0, 1] == pytest.approx(-1.0)
    assert np.corrcoef(across, luck.starts_rad)[0, 1] == pytest.approx(1.0)
    ghost = join_strips(lucky_rrd, "/luck/curve_1")
    assert ghost[:, 1].min() > down.max()


def test_the_ends_are_dots_in_the_close_up(lucky_rrd: Path) -> None:
    luck = measure_lucky("paper-kp10")
    places = np.array(read_static(lucky_rrd, "/plane/close_up/luck", "Points2D:positions"))
    ends = np.concatenate([luck.curves[0].ends_xy_m, luck.curves[-1].ends_xy_m])
    np.testing.assert_allclose(places, ends, atol=1e-6)
    inside = np.abs(luck.curves[0].ends_xy_m - known(RUN.goal_xy_m)).max(axis=1) <= 0.15
    assert f"At the goal, ±150 mm, dots: {inside.sum()} of 65 starts" in read_layout(lucky_rrd)


def test_of_seeds_the_titles_say_so(tmp_path: Path) -> None:
    """Take two to three seconds: 32 seeds of each combination are simulated."""
    run = simulate_lucky("textbook", NOISY)
    what_ifs = {"noise": simulate_lucky("textbook")}
    luck = measure_lucky("textbook", NOISY)
    path = tmp_path / "seeds.rrd"
    write_explanation_rrd(run, make_attribution(run, {"noise": 0.02}), what_ifs, path, luck=luck)
    titles = list(read_layout(path))
    assert "With other seeds" in titles
    assert any(title.endswith("of 32 seeds") for title in titles)


def test_without_luck_there_is_no_view_of_it(explanation_rrd: Path) -> None:
    assert not [one for one in list_entities(explanation_rrd) if "luck" in one]
    assert not [title for title in read_layout(explanation_rrd) if "other" in title]
