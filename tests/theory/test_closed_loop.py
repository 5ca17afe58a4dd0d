import math

import pytest

from turtlelog.errors import TheoryError
from turtlelog.theory import (
    compute_exact_settling_time,
    compute_settling_time,
    compute_time_constant,
)


@pytest.mark.parametrize(("kp", "tau_s"), [(1.0, 1.0), (2.0, 0.5), (4.0, 0.25), (10.0, 0.1)])
def test_the_ideal_loop_has_the_time_constants_of_table_1(kp: float, tau_s: float) -> None:
    assert compute_time_constant(kp) == tau_s
    assert compute_settling_time(kp) == 4.0 * tau_s
    assert compute_exact_settling_time(kp) == pytest.approx(3.912023005428146 * tau_s)


@pytest.mark.parametrize("kp", [0.0, -1.0, math.nan])
def test_a_gain_that_is_not_positive_has_no_time_constant(kp: float) -> None:
    with pytest.raises(TheoryError, match="kp: expected a gain > 0, found"):
        compute_time_constant(kp)
