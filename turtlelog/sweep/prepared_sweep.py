"""What a sweep is of: a base scenario, its rows and metrics, checked before any is simulated."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from turtlelog.errors import ScenarioError
from turtlelog.laws import is_given, read_law_source
from turtlelog.laws.law_files import list_law_files
from turtlelog.measure import choose_metrics
from turtlelog.scenario import (
    Scenario,
    flatten_scenario,
    format_scenario,
    parse_scenario,
    resolve_scenario,
)
from turtlelog.simulate import declare_scenario
from turtlelog.simulate.step_budget import STEP_BUDGET_S
from turtlelog.sweep.plan import KP, SweepPlan, build_row_scenario
from turtlelog.sweep.simulate_rows import RowChunk, RowRecords, require_condition
from turtlelog.version import __version__


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """A prepared sweep; `prepare_sweep` makes one that can run.

    Attributes:
        base: The scenario that the rows vary, as text.
        plan: Its rows.
        metrics: Ids or patterns; None: the essential ones of each row's law but `dead_time`.
        records: Runs that are recorded; None: no run.
        law_code: A checksum of the files of a law that is not built in; empty otherwise.
        step_budget_s: Time that a law may compute for one answer [s]; another one goes on with the
            rows that are done.
    """

    base: str
    plan: SweepPlan
    metrics: tuple[str, ...] | None = None
    records: RowRecords | None = None
    law_code: str = ""
    step_budget_s: float = STEP_BUDGET_S

    def list_facts(self) -> dict[str, str]:
        """Return what makes two sweeps the same, as file metadata have it."""
        where = None if self.records is None else (self.records.folder, self.records.where)
        return {
            "base": self.base,
            "plan": self.plan.describe(),
            "metrics": json.dumps(self.metrics),
            "records": json.dumps(where),
            "law_code": self.law_code,
            "version": __version__,
        }

    def cut_chunk(self, first: int, count: int, *, ahead: int = 0, threads: int = 1) -> RowChunk:
        """Return the work on some rows."""
        rows = range(first, first + count)
        columns = [self.plan.list_values(rows, key) for key in self.plan.keys]
        return RowChunk(
            base=self.base,
            keys=self.plan.keys,
            first=first,
            values=tuple(zip(*columns, strict=True)),
            metrics=self.metrics,
            records=self.records,
            ahead=ahead,
            threads=threads,
            step_budget_s=self.step_budget_s,
        )


def prepare_sweep(  # noqa: PLR0913  (all but the first two have defaults)
    base: Scenario,
    plan: SweepPlan,
    *,
    metrics: Sequence[str] | None = None,
    records: RowRecords | None = None,
    trust_law: bool = False,
    step_budget_s: float = STEP_BUDGET_S,
    source: str = "grid",
) -> Sweep:
    """Return a sweep of a base scenario, after the first, the middle and the last row were built.

    Args:
        base: Scenario that the rows vary.
        plan: The rows; the key `kp` means all gains of the law.
        metrics: Ids or patterns; None: the essential ones of each row's law but `dead_time`.
        records: Runs that are recorded.
        trust_law: Whether a law that a recording names may run, too.
        step_budget_s: Time that a law may compute for one answer [s]; a row whose law takes longer
            fails.
        source: Begins error lines about the values of a row.

    Raises:
        SweepError: If `kp` varies, and the law declares no gain or other keys go together.
        ScenarioError: If none of these rows makes a scenario, or the law may not run.
        MeasureError: If a metric is not known.
        ExpressionError: If the condition of the recordings cannot be judged.
    """
    trusted = True if trust_law else None
    if KP in plan.keys:
        declared = declare_scenario(resolve_scenario(base, trust_law=trust_law))
        plan = plan.spread_gains(declared.list_gains())
    found, errors = [], []
    for row in plan.list_probes():
        try:
            scenario = build_row_scenario(
                base, plan.keys, plan.find_values(row), row, source=source, trust_law=trusted
            )
            found.append(resolve_scenario(scenario, trust_law=trust_law))
        except ScenarioError as err:
            errors.append(err)
    if not found:
        raise errors[0]
    known = [flatten_scenario(one) for one in found]
    real = {key for key in plan.keys if any(isinstance(one.get(key), float) for one in known)}
    if metrics is not None:
        for one in found:
            choose_metrics(metrics, declare_scenario(one))
    first = dict(zip(plan.keys, plan.find_values(0), strict=True))
    require_condition(records, {**known[0], **first})
    kinds = {one.law.kind for one in found} | {str(one.get("law.kind")) for one in known}
    return Sweep(
        base=format_scenario(base),
        plan=plan.with_reals(real),
        metrics=None if metrics is None else tuple(metrics),
        records=records,
        law_code=_sum_up_code(sorted(kinds)),
        step_budget_s=step_budget_s,
    )


def _sum_up_code(kinds: Sequence[str]) -> str:
    """Return a checksum of the files of laws and of what they import from beside them.

    Of a law that only this session has, of its text. Empty where all are built in or modules.
    """
    texts = [text for kind in kinds if (text := read_law_source(kind)) is not None]
    laws = [Path(kind.rpartition(":")[0]) for kind in kinds if ".py:" in kind]
    files = [file for law in laws for file in list_law_files(law)]
    parts = [*(path.read_bytes() for path in files), *(text.encode() for text in texts)]
    return hashlib.sha256(b"".join(parts)).hexdigest() if parts else ""


def list_given_laws(sweep: Sweep) -> tuple[str, ...]:
    """Return the laws of the rows that only this process and its forks find."""
    kinds = [parse_scenario(sweep.base).law.kind]
    for one in (*sweep.plan.grid, *sweep.plan.zipped):
        kinds += [*one.values] if one.key == "law.kind" else []
    return tuple(dict.fromkeys(filter(is_given, kinds)))
