"""Both faces of each reduction, bit for bit: numpy's and the loop that compiled sweeps have."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog.measure import reductions, step_response
from turtlelog.simulate.compiled_twins import take_twin

ROWS = 9000
"""More than numpy's `einsum` adds in one go."""


class Memory(NamedTuple):
    """As a batch has it."""

    numbers: NDArray[np.float64]
    rows: NDArray[np.int64]


MEMORY = Memory(np.empty((reductions.USES, 2 * ROWS)), np.empty(ROWS, np.int64))


def draw(count: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return times that stand still now and then, and coarse values: some alike, and some 0."""
    random = np.random.default_rng(count)
    time_s = np.cumsum(random.integers(0, 3, count)) * 0.016
    return time_s, np.round(random.normal(size=count).cumsum() * 0.3, 1) - 0.0


def list_calls(count: int) -> list[tuple[Callable[..., Any], tuple[Any, ...]]]:
    """Return what each reduction is asked; of what takes two rows or more only then."""
    time_s, values = draw(count)
    step_s, step_error = np.diff(time_s), values[::-1]
    rows = np.arange(count + 2) + np.round(np.append(time_s, [9e3, 9e3]) / 0.016).astype(np.int64)
    calls: list[tuple[Any, tuple[Any, ...]]] = [
        *((reductions.find_furthest_row, (values, way)) for way in (1.0, -1.0)),
        *((reductions.find_first_beyond, (values, 1.5, way)) for way in (1.0, -1.0)),
        (reductions.find_last_outside, (values, -0.5, 0.5)),
        (reductions.find_last_outside, (values, -1e9, 1e9)),
        (reductions.find_bounds, (values,)),
        (reductions.find_largest, (values,)),
        *(
            (reductions.find_furthest_between, (time_s, values, low, 0.1, way))
            for low, way in ((0.0, 1.0), (0.02, -1.0), (0.2, 1.0))
        ),
        (reductions.find_rise_behind_peak, (values,)),
        (reductions.count_beyond, (values, 1.0)),
        (reductions.find_crossing_rows, (values, 0.1, MEMORY)),
        *((reductions.compare_durations, (rows, first)) for first in (0, count // 3)),
        (reductions.find_swing_ends, (time_s, values, 0.1, 0.4, 0.05)),
        (reductions.fold_at_zero, (time_s, values, MEMORY)),
        (reductions.add_values, (values, MEMORY)),
        (reductions.integrate, (step_s, values, MEMORY)),
        (reductions.add_triples, (values, values + 0.1, time_s)),
        *(
            (step_response.compute_misfit, (time_s, values, step_error, shift_s, every, MEMORY))
            for shift_s, every in ((0.0, 1), (0.03, 1), (-0.02, 3))
        ),
        (reductions.measure_way, (time_s, values, MEMORY)),
    ]
    return calls if count == 1 else [*calls, (reductions.find_largest_change, (values,))]


def tell(found: Any) -> Any:
    """Return numbers as texts that tell every bit."""
    if isinstance(found, tuple):
        return [tell(one) for one in found]
    return [float(one).hex() for one in np.atleast_1d(found)]


@pytest.mark.parametrize("count", [*range(1, 20), 127, 128, 129, 300])
def test_a_loop_finds_what_numpy_finds(count: int) -> None:
    for function, arguments in list_calls(count):
        loop = take_twin(function)
        assert loop is not function
        assert tell(loop(*arguments)) == tell(function(*arguments)), function.__name__


@pytest.mark.parametrize("count", [1000, 8191, 8192, 8193, ROWS])
def test_sums_of_many_rows_are_numpys(count: int) -> None:
    time_s, values = draw(count)
    spread = values * 10.0 ** np.random.default_rng(count).integers(-7, 8, count)
    for function, arguments in (
        (reductions.add_values, (spread, MEMORY)),
        (reductions.add_triples, (spread, values, time_s)),
    ):
        assert tell(take_twin(function)(*arguments)) == tell(function(*arguments))


def test_every_reduction_with_two_faces_is_compared() -> None:
    compared = {function for function, _ in list_calls(9)}
    known = [*vars(reductions).values(), *vars(step_response).values()]
    marked = {one for one in known if hasattr(one, "twin")}
    assert marked == compared
