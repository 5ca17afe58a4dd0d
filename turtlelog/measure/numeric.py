"""A number with a meaning: computes and compares as the float that it holds."""

import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

OPERATORS: Final[Mapping[str, Callable[[Any, Any], bool]]] = MappingProxyType(
    {
        "<": operator.lt,
        "<=": operator.le,
        ">": operator.gt,
        ">=": operator.ge,
        "==": operator.eq,
        "!=": operator.ne,
    }
)

MIRRORED: Final = MappingProxyType(
    {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
)
"""Operators after their sides are exchanged or negated."""

_OF_NUMPY: Final = MappingProxyType(
    {
        "less": "<",
        "less_equal": "<=",
        "greater": ">",
        "greater_equal": ">=",
        "equal": "==",
        "not_equal": "!=",
    }
)


class Numeric(ABC):
    """Computes as its float does, with numpy's numbers and arrays too."""

    __slots__ = ()

    @abstractmethod
    def __float__(self) -> float:
        """Return the number."""

    def __int__(self) -> int:
        return int(float(self))

    def __array__(self, dtype: Any = None, *, copy: bool | None = None) -> NDArray[Any]:
        return np.array(float(self), dtype=dtype)

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **named: Any) -> Any:
        """Compute with its float; a comparison stays its own, whichever side it stands on."""
        compared = _OF_NUMPY.get(function.__name__)
        if compared and method == "__call__" and len(inputs) == 2 and not named:
            # numpy hands its numbers over as arrays without a dimension.
            left, right = (one[()] if isinstance(one, np.ndarray) else one for one in inputs)
            if isinstance(left, Numeric):
                return OPERATORS[compared](left, right)
            return OPERATORS[MIRRORED[compared]](right, left)
        numbers = (float(one) if isinstance(one, Numeric) else one for one in inputs)
        return getattr(function, method)(*numbers, **named)

    def __neg__(self) -> float:
        return -float(self)

    def __pos__(self) -> float:
        return float(self)

    def __round__(self, digits: int | None = None) -> float:
        return round(float(self), digits)

    def __add__(self, other: Any) -> Any:
        return float(self) + other

    def __radd__(self, other: Any) -> Any:
        return other + float(self)

    def __sub__(self, other: Any) -> Any:
        return float(self) - other

    def __rsub__(self, other: Any) -> Any:
        return other - float(self)

    def __mul__(self, other: Any) -> Any:
        return float(self) * other

    def __rmul__(self, other: Any) -> Any:
        return other * float(self)

    def __truediv__(self, other: Any) -> Any:
        return float(self) / other

    def __rtruediv__(self, other: Any) -> Any:
        return other / float(self)

    def __pow__(self, other: Any) -> Any:
        return float(self) ** other

    def __rpow__(self, other: Any) -> Any:
        return other ** float(self)
