"""Libraries that not every installation has, loaded where they are needed."""

from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import LibraryError

_PURPOSES: Final = MappingProxyType(
    {
        "control": ("control", "these responses and margins"),
        "matplotlib": ("matplotlib", "figures"),
        "pandas": ("pandas", "data frames"),
        "pyarrow": ("pyarrow", "Arrow tables and Parquet files"),
        "rerun": ("rerun-sdk", "views, pictures of them and .rrd files"),
    }
)
"""What each module's package is called, and what turtlelog needs it for."""


def load_library(module: str) -> Any:
    """Return a module of a library that a slim installation lacks.

    Raises:
        LibraryError: Where the library is not installed; what it is needed for, and how to get it.
    """
    library = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as err:
        if err.name is None or err.name.partition(".")[0] != library:
            raise
        package, purpose = _PURPOSES[library]
        raise LibraryError(
            f"{package}: needed for {purpose}, and not installed; `pip install {package}`"
        ) from err
