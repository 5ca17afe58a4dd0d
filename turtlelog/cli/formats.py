"""The formats that answers can be printed in."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.output import format_table, print_text
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import Table

Flag = Annotated[bool, Parameter(negative="")]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FormatOptions:
    """How to print; without any of them, tables for a terminal.

    Attributes:
        markdown: Print tables as Markdown.
        csv: Print tables as CSV, with full precision.
        latex: Print tables as LaTeX, for the booktabs package.
        json: Print one JSON value instead of tables.
    """

    markdown: Flag = False
    csv: Flag = False
    latex: Flag = False
    json: Flag = False

    def choose(self) -> str:
        """Return the one that is asked for: `txt`, `md`, `csv`, `tex` or `json`.

        Raises:
            UsageError: Where there are several.
        """
        asked = {
            "--markdown": self.markdown,
            "--csv": self.csv,
            "--latex": self.latex,
            "--json": self.json,
        }
        chosen = [name for name, is_asked in asked.items() if is_asked]
        if len(chosen) > 1:
            raise UsageError(f"{chosen[1]}: expected one format, found {chosen[0]} beside it")
        kinds = {"--markdown": "md", "--csv": "csv", "--latex": "tex", "--json": "json"}
        return kinds[chosen[0]] if chosen else "txt"


def print_tables(tables: "Sequence[Table]", kind: str) -> None:
    """Print tables in a format, an empty line between them."""
    texts = (
        format_table(table) if kind == "txt" else tl.format_table(table, kind) for table in tables
    )
    print_text("\n".join(texts), is_data=kind == "csv")
