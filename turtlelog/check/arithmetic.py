"""Arithmetic of what stands for a number: its results are plain floats."""

from abc import ABC, abstractmethod
from typing import Any


class FloatArithmetic(ABC):
    """Computes as its float does; numpy leaves the comparison with it to it."""

    __array_ufunc__ = None

    @abstractmethod
    def __float__(self) -> float:
        """Return the number."""

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
