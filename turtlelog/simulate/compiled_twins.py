"""Compiled twins of Python functions: numba compiles the same source, inlined, without markers.

A function is rebuilt with the functions that it calls replaced by their twins. The function may
call named functions of a module, functions of `math`, and builtins. Objects that numba would freeze
silently (other modules, objects, closures, defaults) are rejected.

Some functions of `arithmetic` have a second implementation that returns the same values. Compiled
loops contain the second implementation; ordinary Python never calls it.
"""

import builtins
import dataclasses
import dis
import hashlib
import math
import os
import re
import sys
import typing
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType
from typing import Any, Final

import numpy as np
from numpy import (
    ceil as ceil_of_numpy,
    float32,
    float64,
    floor as floor_of_numpy,
    fmod as fmod_of_numpy,
    rint,
)

from turtlelog import arithmetic
from turtlelog.run import angles

Function = Callable[..., Any]

_PLAIN: Final = (int, float, bool, str, type(None))


class TwinError(TypeError):
    """A function that numba cannot compile."""


def _find_globals(function: FunctionType) -> dict[str, Any]:
    """Return the names that a function without closure and defaults looks up in its module."""
    if function.__closure__ or function.__defaults__ or function.__kwdefaults__:
        place = f"{function.__code__.co_filename}, line {function.__code__.co_firstlineno}"
        what = f"{function.__qualname__} has default values, or names of an outer function"
        raise TwinError(f"{place}: {what}; {_ALLOWED}")
    codes = [function.__code__]
    for code in codes:
        codes += [one for one in code.co_consts if isinstance(one, CodeType)]
    found = [one for code in codes for one in dis.get_instructions(code)]
    names = {one.argval for one in found if one.opname == "LOAD_GLOBAL"}
    scope = function.__globals__
    return {name: scope[name] for name in sorted(names) if name in scope}


def take_twin(thing: Any) -> Any:
    """Return the compiled replacement of a function or another object."""
    if isinstance(thing, FunctionType):
        thing = getattr(thing, "twin", thing)
    return _TWINS.get(thing, thing) if callable(thing) else thing


def stamp_functions(functions: typing.Iterable[Function], *more: Any) -> str:
    """Return a stamp of all code and constants that functions use, and of what compiles them.

    Raises:
        TwinError: If a function uses an object that numba would freeze silently.
    """
    stamp = _Stamp()
    stamp.add_text(*_read_compiler(), *more)
    for function in functions:
        stamp.add(function, "")
    return stamp.digest.hexdigest()[:16]


def _read_compiler() -> list[bytes | None]:
    """Return the sources of this file and of the compiler; empty where there are no sources."""
    from pkgutil import get_data

    try:
        return [get_data(__name__, f"{name}.py") for name in ("compiled_twins", "twin_compiler")]
    except OSError:  # numba stores nothing then
        return []


class _Stamp:
    """A digest of code and constants of functions."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self._seen: set[Any] = set()

    def add(self, thing: Any, place: str) -> None:
        """Add a function with all objects that it uses, or the object at a place in a function."""
        thing = take_twin(thing)
        if isinstance(thing, FunctionType):
            if thing not in self._seen:
                self._seen.add(thing)
                self._add_function(thing)
        elif isinstance(thing, CodeType):
            self._add_code(thing, None, place)
        elif isinstance(thing, tuple):
            self.add_text(len(thing))
            for one in thing:
                self.add(one, place)
        else:
            self.add_text(_describe(thing, place))

    def add_text(self, *things: Any) -> None:
        """Add objects by their text form."""
        self.digest.update(repr(things).encode())

    def _add_function(self, function: FunctionType) -> None:
        code = function.__code__
        place = f"{code.co_filename}, line {code.co_firstlineno}: {function.__qualname__}"
        self.add_text(getattr(function, "is_called", False), hasattr(function, "is_inlined"))
        self._add_code(code, function.__doc__, place)
        for name, one in _find_globals(function).items():
            self.add(one, f"{place}: {name}")

    def _add_code(self, code: CodeType, doc: str | None, place: str) -> None:
        self.add_text(code.co_name, code.co_code, code.co_names, code.co_varnames)
        for one in code.co_consts:
            if one is not doc or doc is None:
                self.add(one, place)


def _describe(thing: Any, place: str) -> tuple[str, Any]:
    """Return the type and value of a constant in the form of compiled code."""
    if isinstance(thing, _PLAIN):
        return type(thing).__name__, thing
    if thing is math or isinstance(thing, BuiltinFunctionType | np.ufunc | type):
        return "name", thing.__name__
    raise TwinError(f"{place} is {thing!r:.60}; {_ALLOWED}")


class Twins:
    """Compiler of functions and of the functions that they call."""

    def __init__(
        self,
        compiler: Any = None,
        *,
        inline: bool = True,
        wide: frozenset[str] = frozenset(),
    ) -> None:
        """Load numba and store the options.

        Args:
            compiler: Class that compiles them; None: numba's own compiler.
            inline: Whether functions are inlined into their callers; otherwise LLVM decides.
            wide: Names of first parameters with dozens of fields. Passing so many fields takes
                longer to compile than the function, so such functions are inlined.
        """
        from numba import njit

        # Python never calls these functions, so wrappers, which take a third of the time, are left
        # out. Without `_nrt`, numba does not count references to arrays, and refuses code that
        # allocates memory, as a set does. Counting took two thirds of the loop's time.
        options: dict[str, Any] = {
            "error_model": "numpy",
            "no_cpython_wrapper": True,
            "no_cfunc_wrapper": True,
            "_nrt": False,
        }
        if compiler is not None:
            options["pipeline_class"] = compiler
        self._call = njit(**options)
        self._inline = njit(forceinline=True, **options) if inline else self._call
        self._part = njit(inline="always", **options)
        self._wide, self._known = wide, dict[Function, Any]()

    def compile(self, function: Function) -> Any:
        """Return the compiled twin of a Python function without closure and defaults."""
        if function not in self._known:
            source = take_twin(function)
            if not isinstance(source, FunctionType):
                raise TwinError(f"expected a function of Python, found {source!r:.60}")
            scope = {name: self._take(thing) for name, thing in _find_globals(source).items()}
            # Code from the cache looks up its module, and a law's own module may have changed by
            # then.
            scope |= {"__name__": __name__, "__builtins__": builtins}
            bound = FunctionType(source.__code__, scope, source.__name__)
            is_wide = not self._wide.isdisjoint(source.__code__.co_varnames[:1])
            compiler = self._part if is_wide or hasattr(source, "is_inlined") else self._inline
            if getattr(source, "is_called", False):
                compiler = self._call
            self._known[function] = compiler(bound)
        return self._known[function]

    def _take(self, thing: Any) -> Any:
        is_ours = isinstance(thing, FunctionType) or (callable(thing) and thing in _TWINS)
        return self.compile(thing) if is_ours else thing


def compile_entry(
    entry: Any, name: str, bind: Callable[[Any], dict[str, Any]], signature: Any
) -> Any:
    """Return an entry function compiled under a name with its stamp, and for a type.

    Numba's cache finds the function by this name; older versions are removed. `bind` is a function
    of the compiler of twins that returns the names in capitals.
    """
    try:
        from turtlelog.simulate.twin_compiler import EntryCompiler, TwinCompiler

        special = {"pipeline_class": EntryCompiler}
        return _compile_entry(entry, name, bind(TwinCompiler), signature, special)
    except Exception:  # numba's compiler knows its own version, and code that ours does not
        return _compile_entry(entry, name, bind(None), signature, {})


def _compile_entry(
    entry: Any, name: str, scope: dict[str, Any], signature: Any, special: dict[str, Any]
) -> Any:
    from numba import njit

    scope = {**scope, "__name__": entry.__module__}
    bound = FunctionType(entry.__code__, scope, entry.__name__)
    bound.__qualname__, bound.__module__ = name, entry.__module__
    options = {"nogil": True, "cache": True, "error_model": "numpy", "_nrt": False, **special}
    compiler, function = njit(signature, **options), name.rpartition("_")[0]
    try:
        made = compiler(bound)
    except (ImportError, AttributeError):  # a class in the stored code's types has moved
        remove_stored(entry.__module__, function)
        made = compiler(bound)
    if not made.stats.cache_hits:
        remove_stored(entry.__module__, function, kept=name)
    return made


_CODES: Final[dict[Any, str]] = {float: "f8", int: "i8", bool: "?"}


def build_dtype(kind: type[Any]) -> np.dtype[Any]:
    """Return the record type of a dataclass of numbers, truth values and nested dataclasses."""
    hints = typing.get_type_hints(kind)
    found: list[tuple[str, Any]] = []
    for one in dataclasses.fields(kind):
        hint = hints[one.name]
        nested = dataclasses.is_dataclass(hint)
        found.append((one.name, build_dtype(hint) if nested else _CODES[hint]))
    return np.dtype(found or [("nothing", "i8")], align=True)


def _to_tuple(thing: Any) -> tuple[Any, ...]:
    """Return the values of a dataclass as a tuple, in the order of its record."""
    values = tuple(
        _to_tuple(value) if dataclasses.is_dataclass(value) else value
        for value in (getattr(thing, one.name) for one in dataclasses.fields(thing))
    )
    return values or (0,)


def as_record(thing: Any, dtype: np.dtype[Any] | None = None) -> np.ndarray[Any, Any]:
    """Return a dataclass as a record, shape (1,)."""
    return np.array([_to_tuple(thing)], build_dtype(type(thing)) if dtype is None else dtype)


_ALLOWED: Final = (
    "a step is compiled of numbers, `if`, `while`, `for` over a `range`, `math`, functions of"
    " turtlelog.arithmetic and of its own file"
)

_PLACES: Final = (
    re.compile(r'File "([^"]+)", line (\d+)'),
    re.compile(r" at (\S.*) \((\d+)\)$", re.M),
)
"""Patterns for the place of an error; the default is numba's context."""

_MEMORY: Final = "NRT required"  # text of numba's error for code that allocates memory

_HEADS: Final = ("Failed in", "During", "File", "[", "-", "^", "<", "There are", "Overload")


def describe_numba_error(text: str) -> str:
    """Return numba's error for a function that cannot be compiled in one line, with the place."""
    found = [one for pattern in _PLACES for one in pattern.findall(text)]
    places = [one for one in found if "numba" not in Path(one[0]).parts]
    lines = [line.strip() for line in text.splitlines()]
    said = [line for line in lines if line and not line.startswith(_HEADS)]
    reason = said[0] if said else "numba cannot compile it"
    if _MEMORY in reason:
        reason = "a list, a set or an array would be made in each step"
    place = f"{Path(places[0][0]).resolve()}, line {places[0][1]}: " if places else ""
    return f"{place}{reason}; {_ALLOWED}"


_SPLIT: Final = 134217729.0  # 2**27 + 1: halves the digits of a double
_TINY_M, _HUGE_M = 1e-100, 1e100  # far from values whose squares lose digits


def _nearest(value: float) -> Any:
    return rint(value) + 0.0


def _nearest_int(value: float) -> int:
    return int(rint(value))


def _fmod(value: float, by: float) -> Any:
    return fmod_of_numpy(value, by)


def _floor(value: float) -> Any:
    return floor_of_numpy(value)


def _ceil(value: float) -> Any:
    return ceil_of_numpy(value) + 0.0


def _to_float32(value: float) -> float:
    return float64(float32(value))


def _pose_to_float32(x_m: float, y_m: float, heading_rad: float) -> tuple[float, float, float]:
    return float64(float32(x_m)), float64(float32(y_m)), float64(float32(heading_rad))


def _message_to_float32(
    x_m: float, y_m: float, heading_rad: float, speed: float, turn_rate: float
) -> tuple[float, float, float, float, float]:
    x_m, y_m, heading_rad = _pose_to_float32(x_m, y_m, heading_rad)
    return x_m, y_m, heading_rad, _to_float32(speed), _to_float32(turn_rate)


def _begin_row(rows: Any, new: Any, number: int) -> Any:
    rows[number] = new
    return rows[number]


def _square(value: float) -> tuple[float, float]:
    """Return a square as a sum of two doubles, exactly (Dekker's product)."""
    product = value * value
    large = _SPLIT * value
    high = large - (large - value)
    low = value - high
    return product, ((high * high - product) + 2.0 * high * low) + low * low


def _find_hypot(x: float, y: float) -> float:
    """Return the nearest double to the hypotenuse, as CPython does.

    The method is one Newton step from the root of the rounded squares, with the exact remainders.
    """
    large, small = abs(x), abs(y)
    if large < small:
        large, small = small, large
    if small == 0.0 or not math.isfinite(large):
        return large
    # Scaled by a power of two, which keeps all digits: no square overflows or loses digits.
    scale = 1.0
    if not _TINY_M < large < _HUGE_M:
        scale = math.ldexp(1.0, -max(math.frexp(large)[1], -1000))
    large, small = large * scale, small * scale
    square, rest = _square(large)
    other, other_rest = _square(small)
    root = math.sqrt(square + other)
    root_square, root_rest = _square(root)
    total = square + other
    lost = other - (total - square)
    left = (total - root_square) + (lost + (rest + other_rest - root_rest))
    return (root + left / (2.0 * root)) / scale


_TWINS: Final[Mapping[Callable[..., Any], Callable[..., Any]]] = {
    arithmetic.hypot: _find_hypot,
    arithmetic.fmod: _fmod,
    arithmetic.floor: _floor,
    arithmetic.ceil: _ceil,
    arithmetic.nearest: _nearest,
    arithmetic.nearest_int: _nearest_int,
    arithmetic.to_float32: _to_float32,
    arithmetic.pose_to_float32: _pose_to_float32,
    arithmetic.message_to_float32: _message_to_float32,
    arithmetic.begin_row: _begin_row,
    angles.wrap_angle: arithmetic.wrap_angle,
}
"""Functions of compiled code that replace Python functions."""


def is_kept(module: str, function: str) -> bool:
    """Return whether numba's cache has the code of an entry function, without loading its module.

    The name of the function contains the stamp of all that it is compiled from. In addition, numba
    checks the entry function's own file.
    """
    source = _find_source(module)
    python = f"py{sys.version_info.major}{sys.version_info.minor}"
    try:
        changed_s = source.stat().st_mtime
        return any(
            index.stat().st_mtime >= changed_s
            for folder in _list_cache_folders(source)
            for index in folder.glob(f"{source.stem}.{function}*.{python}*.nbi")
        )
    except OSError:
        return False


def remove_stored(module: str, function: str, *, kept: str | None = None) -> None:
    """Remove all versions of a function from numba's cache, except one with the name `kept`."""
    source = _find_source(module)
    for folder in _list_cache_folders(source):
        with suppress(OSError):
            for file in folder.glob(f"{source.stem}.{function}_*.nb?"):
                if kept is None or kept not in file.name:
                    file.unlink(missing_ok=True)


def _find_source(module: str) -> Path:
    found = find_spec(module)
    return Path((found and found.origin) or "").absolute()


def _list_cache_folders(source: Path) -> list[Path]:
    """Return the folders in which numba stores compiled code of a module, without loading it.

    The folder is NUMBA_CACHE_DIR if set, or else the module's folder. If that is not writable, it
    is the user's cache, whose place is unknown here on Windows and macOS.
    """
    from hashlib import sha1  # most commands do not need it

    hashed = sha1(str(source.parent).encode(), usedforsecurity=False).hexdigest()
    name = f"{source.parent.name}_{hashed}"
    if folder := os.environ.get("NUMBA_CACHE_DIR"):
        return [Path(folder) / name]
    of_user = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return [source.parent / "__pycache__", of_user / "numba" / name]
