"""Libraries that not every installation has, and the names of packages that need them.

A library is loaded where it is needed. A public name loads on first use; where its library is not
installed, the name is not there, and who imports it is told what to install.
"""

import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

import lazy_loader  # type: ignore[import-untyped]

from turtlelog.errors import LibraryAttributeError, LibraryError, LibraryImportError

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
"""What each module's package is called, and what turtlelog needs it for."""


def load_library(module: str) -> Any:
    """Return a module of a library that a slim installation lacks.

    Raises:
        LibraryImportError: It, or another of these that it needs, is not installed; what that is
            needed for, and how to get it.
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
        "turtlelog.draw.report": ("matplotlib", "bokeh"),
        "turtlelog.draw.rerun": ("rerun", "pyarrow"),
    }
)
"""Packages without which libraries none of their names can be used."""


def attach_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], Any]]:
    """Return `__getattr__` and `__dir__` of a package whose names load on first use.

    The names are those of the `.pyi` file beside `file`. A name whose library is not installed is
    in neither `__all__` nor `dir()`; an import does not pay for that search. The `__getattr__` of
    such a name raises LibraryAttributeError, which is an AttributeError: `hasattr` is False, and
    `getattr(package, name, None)` is None. Python turns that into "cannot import name" for
    `from package import name`, but first it asks the finders of modules. One of ours then raises
    LibraryImportError, an ImportError. Both say what to install. No class can be both, because
    Python stores the two kinds differently. Both are a LibraryError.
    """
    load, _, listed = lazy_loader.attach_stub(package, file)

    @cache
    def list_names() -> list[str]:
        lacking = set(_list_lacking(package, file))
        return [name for name in listed if name not in lacking]

    def load_name(name: str) -> Any:
        if name == "__all__":
            return list_names()
        try:
            return load(name)
        except LibraryError as err:
            _Absent.tell(f"{package}.{name}", str(err))
            raise LibraryAttributeError(str(err)) from err

    return load_name, lambda: list_names().copy()


def _list_lacking(package: str, file: str) -> Iterator[str]:
    """Yield the names of a package, from its stub, whose library is not installed."""
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
    """Finds no module: what is asked for after a name was absent gets the reason for that."""

    reasons: Final[dict[str, str]] = {}

    @classmethod
    def tell(cls, name: str, reason: str) -> None:
        """Raise the reason when the name is imported from now on."""
        cls.reasons[name] = reason
        if cls not in sys.meta_path:
            sys.meta_path.append(cls)

    @classmethod
    def find_spec(cls, name: str, *_: object) -> None:
        """Raise LibraryImportError for such a name; there is no module for any other."""
        if name in cls.reasons:
            raise LibraryImportError(cls.reasons[name])
