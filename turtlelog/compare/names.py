"""Names that tell runs apart in one table or picture."""

from collections import Counter
from collections.abc import Sequence

from turtlelog.run import Run


def name_runs(runs: Sequence[Run]) -> tuple[str, ...]:
    """Return one name per run, in order; names that stand more than once get a number."""
    counts = Counter(run.name for run in runs)
    seen: Counter[str] = Counter()
    names = []
    for run in runs:
        seen[run.name] += 1
        number = f" ({seen[run.name]})" if counts[run.name] > 1 else ""
        names.append(f"{run.name}{number}")
    return tuple(names)
