"""The version, libraries that not every installation has, and names that load on first use.

A library is loaded when it is needed. A public name loads on first use. If the library of a name is
not installed, the package does not have the name, and the import error says what to install.
"""

import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

import lazy_loader  # type: ignore[import-untyped]

from turtlelog.errors import LibraryAttributeError, LibraryError, LibraryImportError

__version__ = "0.1.0"
"""The version of turtlelog, which recordings contain."""

_PURPOSES: Final = MappingProxyType(
    {
        "bokeh": ("bokeh", "reports"),
        "cloudpickle": ("cloudpickle", "laws of this session in other processes"),
        "control": ("control", "these responses and margins"),
        "cv2": ("opencv-python-headless", "movies in .mp4"),
        "distributed": ("distributed", "work on a Dask cluster"),
        "fsspec": ("turtlelog[remote]", "files behind URLs"),
        "matplotlib": ("matplotlib", "figures"),
        "PIL": ("pillow", "movies in .gif"),
        "pandas": ("pandas", "data frames"),
        "pyarrow": ("pyarrow", "views, Arrow tables and Parquet files"),
        "xarray": ("xarray", "labelled arrays"),
        "rerun": ("rerun-sdk", "views, pictures of them and .rrd files"),
        "rerun_notebook": ("turtlelog[notebook]", "the widget of a notebook"),
    }
)
"""Package name of each module, and the features of turtlelog that need it."""


def load_library(module: str) -> Any:
    """Return a module of a library that a slim installation does not have.

    Raises:
        LibraryImportError: If the library, or another library that it needs, is not installed. The
            message says what needs the library and how to install it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as err:
        missing = (err.name or "").partition(".")[0]
        if missing not in _PURPOSES:
            raise
        package, purpose = _PURPOSES[missing]
        raise LibraryImportError(
            f"{package}: needed for {purpose}, and not installed; `pip install {package}`"
        ) from err


_NEEDED: Final = MappingProxyType(
    {
        "turtlelog.draw.figures": ("matplotlib",),
        "turtlelog.draw.movie": ("matplotlib",),
        "turtlelog.draw.report_file": ("matplotlib", "bokeh"),
        "turtlelog.draw.rerun": ("rerun", "pyarrow"),
    }
)
"""Libraries without which none of a package's names can be used."""


def attach_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], Any]]:
    """Return `__getattr__` and `__dir__` of a package whose names load on first use.

    The names are read from the `.pyi` file beside `file`. A name whose library is not installed is
    in neither `__all__` nor `dir()`. `__getattr__` of such a name raises LibraryAttributeError, a
    subclass of AttributeError: `hasattr` returns False, and `getattr(package, name, None)` returns
    None. For `from package import name`, Python would turn this error into "cannot import name",
    but first asks the module finders. Our finder then raises LibraryImportError, a subclass of
    ImportError. Both errors are a LibraryError and say what to install. No class can be both an
    AttributeError and an ImportError, because Python stores the two kinds differently.
    """
    load, _, listed = lazy_loader.attach_stub(package, file)

    @cache
    def list_names() -> list[str]:
        lacking = set(_list_lacking(package, file))
        return [name for name in listed if name not in lacking]

    def load_name(name: str) -> Any:
        if name == "__all__":
            return list_names()
        if name not in listed and not name.startswith("_"):
            raise _UnknownNameError(package, name, list_names())
        try:
            return load(name)
        except LibraryError as err:
            _Absent.tell(f"{package}.{name}", str(err))
            raise LibraryAttributeError(str(err)) from err

    return load_name, lambda: list_names().copy()


class _UnknownNameError(AttributeError):
    """A name that a package does not have. Its message, with the nearest name, is seldom read."""

    def __str__(self) -> str:
        if len(self.args) < 3:
            return super().__str__()
        from difflib import get_close_matches

        package, name, known = self.args
        nearest = get_close_matches(name, known, n=1)
        advice = f"; did you mean {nearest[0]}?" if nearest else ""
        return f"No {package} attribute {name}{advice}"


def _list_lacking(package: str, file: str) -> Iterator[str]:
    """Yield the names in the stub of a package whose library is not installed."""
    rooms = (room for room in _NEEDED if room.startswith(f"{package}."))
    lacking = [room for room in rooms if not all(map(_is_installed, _NEEDED[room]))]
    if not lacking:
        return
    import ast  # A full installation never needs these.
    from pathlib import Path

    for node in ast.parse(Path(file).with_suffix(".pyi").read_text("utf-8")).body:
        if not isinstance(node, ast.ImportFrom) or node.module is None:
            continue
        home, names = f"{package}.{node.module}", {alias.name for alias in node.names}
        if any(f"{home}.".startswith(f"{room}.") for room in lacking):
            yield from names
        elif any(room.startswith(f"{home}.") for room in lacking):
            init = Path(file).parent.joinpath(*node.module.split("."), "__init__.py")
            yield from names.intersection(_list_lacking(home, str(init)))


def _is_installed(library: str) -> bool:
    from importlib.util import find_spec  # Only for `__all__` and `dir()`.

    if library in sys.modules:
        return sys.modules[library] is not None
    return find_spec(library) is not None


class _Absent:
    """Finder that finds no module, but gives the reason why a name is missing."""

    reasons: Final[dict[str, str]] = {}

    @classmethod
    def tell(cls, name: str, reason: str) -> None:
        """Raise this reason whenever the name is imported from now on."""
        cls.reasons[name] = reason
        if cls not in sys.meta_path:
            sys.meta_path.append(cls)

    @classmethod
    def find_spec(cls, name: str, *_: object) -> None:
        """Raise LibraryImportError for a missing name; find no module for any other name."""
        if name in cls.reasons:
            raise LibraryImportError(cls.reasons[name])
