import tracemalloc

import numpy as np
import pytest

from turtlelog.check import check_formula

MOST = 11.0  # times the columns that such a formula names, as docs/checking.md says
SAMPLES = 100_000


@pytest.mark.parametrize(
    "formula",
    [
        "always(eventually[0, 5](x > 0.5))",
        "always(x > 0.5 implies eventually[0, 5](always[0, 1](x < 0.5)))",
        "always(x > 0.5 until[0, 5] x < 0.5)",
    ],
)
def test_formula_takes_a_stated_multiple_of_its_columns(formula: str) -> None:
    random = np.random.default_rng(0)
    values = np.cumsum(random.normal(size=SAMPLES)) / 100.0
    time_ns = np.cumsum(random.integers(1, 32_000_000, SAMPLES))
    signals = {"x": (time_ns, values)}
    check_formula({"x": (time_ns[:10], values[:10])}, formula)  # what is imported on the way
    tracemalloc.start()
    check_formula(signals, formula)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / (time_ns.nbytes + values.nbytes) < MOST
