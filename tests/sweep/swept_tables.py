"""Tables of sweeps whose metrics a test computes itself."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import turtlelog as tl
from turtlelog.parts import split_key_unit
from turtlelog.sweep import ResultColumn, ResultTable, SweepPlan, build_plan, write_result_table
from turtlelog.sweep.result_table import choose_type

Compute = Callable[..., float | str]
"""Of the values of the keys: a value, or the status that there is none."""


def write_table(
    path: Path,
    plan: SweepPlan | Sequence[str],
    metrics: Mapping[str, Compute],
    *,
    preset: str = "textbook",
    units: Mapping[str, str] | None = None,
    changes: Mapping[str, Any] | None = None,
) -> Path:
    """Write a table as `turtlelog sweep` does, without a simulation."""
    plan = plan if isinstance(plan, SweepPlan) else build_plan(plan)
    base = tl.override_scenario(tl.load_scenario(preset), dict(changes or {}))
    rows = [plan.find_values(row) for row in range(plan.row_count)]
    columns = [ResultColumn(name="row", type="whole", cells=range(len(rows)))]
    for key, cells in zip(plan.keys, zip(*rows, strict=True), strict=True):
        unit = split_key_unit(key)[1] or None
        columns.append(ResultColumn(name=key, type=choose_type(cells), cells=cells, unit=unit))
    for name, compute in metrics.items():
        found = [compute(*values) for values in rows]
        numbers = [None if isinstance(one, str) else one for one in found]
        statuses = [one if isinstance(one, str) else "ok" for one in found]
        unit = (units or {}).get(name, "1")
        columns.append(ResultColumn(name=name, type="real", cells=numbers, unit=unit))
        columns.append(ResultColumn(name=f"{name}.status", type="text", cells=statuses))
    none = [None] * len(rows)
    columns += [
        ResultColumn(name=name, type="text", cells=none) for name in ("stop_reason", "failed")
    ]
    facts = {
        "base": tl.format_scenario(base),
        "plan": plan.describe(),
        "varied": json.dumps(plan.keys),
    }
    write_result_table(ResultTable(kind="sweep", columns=tuple(columns), facts=facts), path)
    return path
