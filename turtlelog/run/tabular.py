"""Values that are a table: as pandas, polars and Arrow read them."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NoReturn

from turtlelog.libraries import load_library


class Tabular(ABC):
    """A value that pandas, polars and Arrow read as a table with units.

    `polars.DataFrame(value)`, `pyarrow.table(value)` and `pandas.DataFrame.from_arrow(value)` read
    it through the Arrow protocol; `pandas.DataFrame(value)` does not know that, and raises an error
    (`value.to_pandas()` is the same table).
    """

    __slots__ = ()

    @abstractmethod
    def _tabulate(self) -> Mapping[str, Any]:
        """Return its columns by name, all of one length: arrays, or lists with None for none."""

    def _list_units(self) -> Mapping[str, str]:
        """Return the units of columns by name."""
        return {}

    def to_pandas(self) -> Any:
        """Return the table as a `pandas.DataFrame`; its `attrs` hold the `units` of its columns.

        Raises:
            LibraryError: pandas is not installed; turtlelog does not install it.
        """
        columns = self._tabulate()
        frame = load_library("pandas").DataFrame(
            {name: _list_rows(cells) for name, cells in columns.items()}
        )
        frame.attrs = {"units": dict(self._list_units())}
        return frame

    def to_arrow(self) -> Any:
        """Return the table as a `pyarrow.Table`; the metadata of a column holds its `unit`.

        Raises:
            LibraryError: pyarrow is not installed.
        """
        pa = load_library("pyarrow")
        units = self._list_units()
        arrays = {name: pa.array(_list_rows(cells)) for name, cells in self._tabulate().items()}
        fields = [
            pa.field(name, cells.type, metadata={"unit": units[name]} if name in units else None)
            for name, cells in arrays.items()
        ]
        return pa.table([*arrays.values()], schema=pa.schema(fields))

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """Hand the table over to polars, Arrow and pandas."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)


def refuse_array(value: object) -> NoReturn:
    """Refuse to be a numpy array, for tables that numpy and pandas would read as their names."""
    kind = type(value).__name__
    raise TypeError(f"{kind} is a table, not an array: to_pandas() and to_arrow() return it")


def _list_rows(cells: Any) -> Any:
    """Return a column of rows that are arrays as a list of them."""
    return list(cells) if getattr(cells, "ndim", 1) > 1 else cells
