"""The same formulas and traces through rtamt's dense-time monitor, another implementation.

It too holds each value until the next and the last one for ever. What is compared: all temporal
and logical operators, nested, bounded and not, over <, <=, >, >=, ==, != of +, -, * and abs of two
signals with uneven times of their own, at every half second of the trace and beyond its end.
"""

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from tests.check.formulas import HALF_NS, Column, formulas, signals, write_for_rtamt
from turtlelog.check import compute_robustness
from turtlelog.expressions import Node, format_expression, parse_expression

with warnings.catch_warnings():
    # Its parser's runtime reads typing.io, which newer Pythons do not have.
    warnings.filterwarnings("ignore", "typing.io is deprecated", DeprecationWarning)
    rtamt = pytest.importorskip("rtamt", exc_type=ImportError)


def monitor(formula: str, trace: dict[str, Column]) -> list[Any]:
    specification = rtamt.StlDenseTimeSpecification()
    for name in trace:
        specification.declare_var(name, "float")
    specification.spec = formula
    specification.parse()
    rows = {name: np.column_stack((column[0] / 1e9, column[1])) for name, column in trace.items()}
    found: list[Any] = specification.evaluate(*([name, rows[name].tolist()] for name in trace))
    return found


@pytest.mark.thorough
@settings(deadline=None)
@given(formulas, signals)
def test_margins_agree_with_rtamt_at_every_moment(tree: Node, trace: dict[str, Column]) -> None:
    steps = monitor(write_for_rtamt(tree), trace)
    times, values = np.array(steps).T
    expression = parse_expression(format_expression(tree))
    found = compute_robustness(trace, expression, window_ns=(0, 60 * HALF_NS))
    for moment in np.arange(0.0, 31.0, 0.5):
        ours = found.values[found.find_piece(round(moment * 1e9))]
        assert ours == values[np.searchsorted(times, moment, side="right") - 1]
