import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from turtlelog.errors import MeasureError
from turtlelog.measure import read_reference_path, references
from turtlelog.measure.reductions import measure_way
from turtlelog.measure.references import compute_path_distances, compute_straightness

POINTS = arrays(np.float64, st.tuples(st.integers(2, 40), st.just(2)), elements=st.floats(-9, 9))


def measure_length(xy_m: np.ndarray) -> float:
    """Return the length of the line through points."""
    return measure_way(xy_m[:, 0], xy_m[:, 1], None)


def measure_nearest(point: np.ndarray, path: np.ndarray) -> float:
    """The distance by a plain search over the parts of the path."""
    best = math.inf
    for start, end in pairwise(path):
        way = end - start
        square = float(way @ way)
        share = min(max(float((point - start) @ way) / square, 0.0), 1.0) if square else 0.0
        best = min(best, math.dist(point, start + share * way))
    return best


def test_an_arc_is_as_long_as_its_chords() -> None:
    angle = np.linspace(0.0, math.pi, 10_001)
    arc = np.column_stack([np.cos(angle), np.sin(angle)])
    assert measure_length(arc) == pytest.approx(math.pi, rel=1e-8)
    assert compute_straightness(arc) == pytest.approx(math.pi / 2.0, rel=1e-8)


def test_a_straight_way_has_straightness_one() -> None:
    way = np.linspace(0.0, 1.0, 1001)[:, None] * np.array([[3.0, 4.0]])
    assert compute_straightness(way) == pytest.approx(1.0, rel=1e-12)


def test_a_way_back_to_its_start_has_no_straightness() -> None:
    assert compute_straightness(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]])) is None
    assert compute_straightness(np.array([[1.0, 2.0]])) is None


@given(POINTS, POINTS)
def test_distances_are_those_of_a_plain_search(points: np.ndarray, path: np.ndarray) -> None:
    expected = [measure_nearest(point, path) for point in points]
    assert compute_path_distances(points, path) == pytest.approx(expected, abs=1e-9)


def test_long_paths_leave_out_only_what_is_too_far() -> None:
    rng = np.random.default_rng(0)
    points = np.cumsum(rng.normal(0.0, 0.05, (3000, 2)), axis=0)
    path = np.cumsum(rng.normal(0.0, 0.2, (1300, 2)), axis=0)
    found = compute_path_distances(points, path)
    some = rng.integers(0, len(points), 40)
    expected = [measure_nearest(points[row], path) for row in some]
    assert found[some] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
def test_a_robot_that_stands_is_compared_with_few_parts_of_a_path(
    noise_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    pairs, measure_parts = [0], references._measure_parts

    def measure(points: np.ndarray, *parts: np.ndarray) -> np.ndarray:
        pairs[0] += len(points) * len(parts[0])
        return measure_parts(points, *parts)

    monkeypatch.setattr(references, "_measure_parts", measure)
    rng = np.random.default_rng(0)
    points, standing = (rng.normal(5.0, noise_m, (count, 2)) for count in (20_000, 2_000))
    found = compute_path_distances(points, standing)
    assert found[7] == pytest.approx(measure_nearest(points[7], standing), abs=1e-12)
    assert pairs[0] < 12e6  # of 40 million


@given(POINTS, st.floats(0.01, 100.0), st.floats(-math.pi, math.pi))
def test_length_scales_with_the_unit_and_straightness_does_not(
    points: np.ndarray, scale: float, turn: float
) -> None:
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    moved = scale * points @ rotation.T + 3.0
    length = measure_length(points)
    assert measure_length(moved) == pytest.approx(scale * length, rel=1e-6, abs=1e-9)
    straightness = compute_straightness(points)
    if straightness is not None and math.dist(points[0], points[-1]) > 1e-3:
        assert compute_straightness(moved) == pytest.approx(straightness, rel=1e-6)


@pytest.mark.parametrize("head", ["", "x,y\n", "x [m],y [m]\n\n"])
def test_a_reference_path_is_read_with_or_without_its_head(tmp_path: Path, head: str) -> None:
    file = tmp_path / "path.csv"
    file.write_text(f"{head}0,0\n1.5,2\n")
    assert read_reference_path(file).tolist() == [[0.0, 0.0], [1.5, 2.0]]


@pytest.mark.parametrize(
    ("head", "point"),
    [("x [mm],y (cm)", [0.0015, 0.02]), ("x_mm,y_mm", [0.0015, 0.002]), ("a,b", [1.5, 2.0])],
)
def test_the_head_of_a_reference_path_may_name_units(
    tmp_path: Path, head: str, point: list[float]
) -> None:
    file = tmp_path / "path.csv"
    file.write_text(f"{head}\n0,0\n1.5,2\n")
    assert read_reference_path(file)[1] == pytest.approx(point)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x [ft],y [ft]\n0,0\n1,1\n", "line 1: column x .ft.: expected a unit of m, cm, mm, found"),
        ("y [m],x [m]\n0,0\n1,1\n", "line 1: expected x,y, found 'y .m.,x .m.'"),
        ("0,0\n1,nan\n", "line 2: expected x,y in metres, found '1,nan'"),
        ("x,y\n0,0\n1,2,3\n", "line 3: expected x,y in metres, found '1,2,3'"),
        ("0,0\nfar,away\n", "line 2: expected x,y in metres, found 'far,away'"),
        ("0,0\n1,1\n,\n", "line 3: expected x,y in metres"),
        ("x,y\n0,0\n", "expected two points or more, found 1"),
        ("", "expected two points or more, found 0"),
    ],
)
def test_a_bad_reference_path_is_refused_with_its_line(
    tmp_path: Path, text: str, line: str
) -> None:
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(MeasureError, match=line):
        read_reference_path(file)


def test_a_reference_path_that_is_no_text_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(MeasureError, match="found: no CSV text"):
        read_reference_path(file)
    with pytest.raises(MeasureError, match="found: No such file"):
        read_reference_path(tmp_path / "none.csv")
