"""Values with their kind, and what can be done with them; numpy loads on first use.

Numbers and truths are float64 arrays of any shape, a truth being 0 or 1, and nan is unknown.
"""

from __future__ import annotations

import enum
import math
import operator as operators
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from numpy.typing import NDArray

Value = Any
"""float, int, bool, str, None, or an array of them."""


ARGUMENTS: Final[Mapping[str, tuple[int, float]]] = MappingProxyType(
    {
        "abs": (1, 1),
        "min": (2, math.inf),
        "max": (2, math.inf),
        "sqrt": (1, 1),
        "sin": (1, 1),
        "cos": (1, 1),
        "atan2": (2, 2),
        "hypot": (2, 2),
        "deg": (1, 1),
        "rad": (1, 1),
        "log": (1, 1),
    }
)
"""Smallest and largest number of arguments. Angles are in rad; `log` is the natural logarithm."""


_UFUNCS: Final = MappingProxyType(
    {"min": "minimum", "max": "maximum", "atan2": "arctan2", "deg": "degrees", "rad": "radians"}
)
"""What numpy calls a function, where it has another name there."""


class Kind(enum.Enum):
    """Kind of an operand; UNKNOWN fits everywhere."""

    NUMBER = "number"
    TEXT = "text"
    TRUTH = "truth"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Operand:
    """A value within an expression.

    Attributes:
        kind: Kind of the value.
        data: float64 with nan for unknown; of a text, strings; of UNKNOWN, nan.
    """

    kind: Kind
    data: NDArray[Any]

    def unpack(self) -> Value:
        """Return it as a user's value: a float, bool, str, None or an array."""
        if self.kind in {Kind.TRUTH, Kind.UNKNOWN}:
            return _unpack_truth(self.data)
        if self.data.shape:
            return self.data
        value = self.data.item()
        return None if isinstance(value, float) and math.isnan(value) else value


def make_operand(value: Value) -> Operand:
    """Return a user's value as an operand.

    Raises:
        TypeError: If it is neither number, truth, text nor an array of them.
    """
    import numpy as np

    if value is None:
        return Operand(kind=Kind.UNKNOWN, data=np.array(np.nan))
    data = np.asarray(value)
    if data.dtype.kind == "U":
        return Operand(kind=Kind.TEXT, data=data)
    if data.dtype.kind == "b":
        return Operand(kind=Kind.TRUTH, data=data.astype(np.float64))
    if data.dtype.kind not in "iuf":
        raise TypeError(f"expected a number, text or truth, found {type(value).__name__}")
    return Operand(kind=Kind.NUMBER, data=data.astype(np.float64, copy=False))


def compute_operator(operator: str, left: Operand, right: Operand) -> Operand:
    """Return two numbers joined by + - * / or **; nan if that has no value."""
    import numpy as np

    ufunc = {
        "+": np.add,
        "-": np.subtract,
        "*": np.multiply,
        "/": np.divide,
        "**": np.power,
    }[operator]
    with np.errstate(all="ignore"):
        data = ufunc(left.data, right.data)
        if operator == "/":
            data = np.where(right.data == 0, np.nan, data)
        if operator == "**":  # IEEE has nan**0 = 1 and 1**nan = 1
            data = np.where(np.isnan(left.data) | np.isnan(right.data), np.nan, data)
    return _make_number(data, [left, right])


def describe_arguments(function: str) -> str:
    """Return how many arguments a function takes, for messages."""
    least, most = ARGUMENTS[function]
    count = f"{least} or more" if least != most else f"{least}"
    return f"{function} to have {count} argument{'s' if count != '1' else ''}"


def compute_function(function: str, arguments: Sequence[Operand]) -> Operand:
    """Return a function of numbers; nan if it has no value."""
    import numpy as np

    ufunc = getattr(np, _UFUNCS.get(function, function))
    data = [argument.data for argument in arguments]
    with np.errstate(all="ignore"):
        if len(data) <= 2:
            return _make_number(ufunc(*data), arguments)
        return _make_number(ufunc.reduce(np.broadcast_arrays(*data)), arguments)


def compare_operands(left: Operand, operator: str, right: Operand) -> Operand:
    """Return the truth of a comparison of two operands of one kind."""
    import numpy as np

    compare = {
        "<": operators.lt,
        "<=": operators.le,
        ">": operators.gt,
        ">=": operators.ge,
        "==": operators.eq,
        "!=": operators.ne,
    }[operator]
    if Kind.UNKNOWN in {left.kind, right.kind}:
        shape = np.broadcast_shapes(left.data.shape, right.data.shape)
        return Operand(kind=Kind.TRUTH, data=np.full(shape, np.nan))
    truth = np.asarray(compare(left.data, right.data), np.float64)
    if left.kind is not Kind.TEXT:
        truth = np.where(np.isnan(left.data) | np.isnan(right.data), np.nan, truth)
    return Operand(kind=Kind.TRUTH, data=truth)


def negate_truth(operand: Operand) -> Operand:
    """Return not."""
    return Operand(kind=Kind.TRUTH, data=1.0 - operand.data)


def join_truths(operator: str, operands: Sequence[Operand]) -> Operand:
    """Return truths joined by and, or, or (two of them) implies, by Kleene's logic."""
    if operator == "implies":
        return join_truths("or", [negate_truth(operands[0]), operands[1]])
    data = operands[0].data
    for operand in operands[1:]:
        data = _conjoin(data, operand.data) if operator == "and" else _disjoin(data, operand.data)
    return Operand(kind=Kind.TRUTH, data=data)


def _conjoin(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    import numpy as np

    return np.where((left == 0) | (right == 0), 0.0, left * right)


def _disjoin(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    return 1.0 - _conjoin(1.0 - left, 1.0 - right)


def _make_number(data: NDArray[Any], sources: Sequence[Operand]) -> Operand:
    """Finite numbers that give an infinite one (an overflow, a pole) have no value."""
    import numpy as np

    data = np.asarray(data)
    if np.isinf(data).any():
        had_infinity = np.logical_or.reduce(
            np.broadcast_arrays(*(np.isinf(source.data) for source in sources))
        )
        data = np.where(np.isinf(data) & ~had_infinity, np.nan, data)
    return Operand(kind=Kind.NUMBER, data=data)


def _unpack_truth(data: NDArray[Any]) -> Value:
    import numpy as np

    unknown = np.isnan(data)
    if not data.shape:
        return None if unknown else bool(data)
    if not unknown.any():
        return data.astype(np.bool_)
    truths = data.astype(np.bool_).astype(np.object_)
    truths[unknown] = None
    return truths
