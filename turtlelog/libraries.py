"""Libraries that not every installation has, loaded where they are needed."""

from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import LibraryError

_PURPOSES: Final = MappingProxyType(
    {
        "bokeh": ("bokeh", "reports"),
        "control": ("control", "these responses and margins"),
        "cv2": ("opencv-python-headless", "movies in .mp4"),
        "distributed": ("distributed", "work on a Dask cluster"),
        "fsspec": ("turtlelog[remote]", "files behind URLs"),
        "matplotlib": ("matplotlib", "figures"),
        "PIL": ("pillow", "movies in .gif"),
        "pandas": ("pandas", "data frames"),
        "pyarrow": ("pyarrow", "views, Arrow tables and Parquet files"),
        "rerun": ("rerun-sdk", "views, pictures of them and .rrd files"),
    }
)
"""What each module's package is called, and what turtlelog needs it for."""


def load_library(module: str) -> Any:
    """Return a module of a library that a slim installation lacks.

    Raises:
        LibraryError: Where it, or another of these that it needs, is not installed; what that is
            needed for, and how to get it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as err:
        missing = (err.name or "").partition(".")[0]
        if missing not in _PURPOSES:
            raise
        package, purpose = _PURPOSES[missing]
        raise LibraryError(
            f"{package}: needed for {purpose}, and not installed; `pip install {package}`"
        ) from err
