"""A row of a table of results, chosen in place of a scenario."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import LawOptions, Whole, apply_options, load_changed_scenario
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import Scenario


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RowOptions:
    """A row of a table in place of SCENARIO.

    Attributes:
        table: Run the scenario of a row of this table, which `turtlelog sweep` wrote.
        row: Its number, in the column `row`.
    """

    table: Annotated[Path | None, Parameter(name="--from", metavar="FILE")] = None
    row: Annotated[Whole | None, Parameter(metavar="NUMBER")] = None

    def load(self, scenario: str | None, options: LawOptions | None) -> "Scenario":
        """Return the scenario that is to run, with the options applied."""
        if self.table is None:
            if self.row is not None:
                raise UsageError("--row: expected --from beside it, found none")
            return load_changed_scenario(scenario, options)
        if scenario is not None:
            raise UsageError(f"--from: expected no scenario beside it, found {scenario}")
        if self.row is None:
            raise UsageError("--from: expected --row beside it, found none")
        return apply_options(tl.sweep.load_row_scenario(self.table, self.row), options)
