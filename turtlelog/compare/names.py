"""Names that tell runs apart in one table or picture."""

from collections import Counter
from collections.abc import Sequence
from itertools import count

from turtlelog.compare.summary import RunSummary
from turtlelog.run import Run


def name_runs(runs: Sequence[Run | RunSummary]) -> tuple[str, ...]:
    """Return one name per run, in order, no two alike: names that clash get a number."""
    counts = Counter(run.name for run in runs)
    taken = {name for name, times in counts.items() if times == 1}
    names = []
    for run in runs:
        name = run.name
        if counts[name] > 1:
            numbered = (f"{name} ({number})" for number in count(1))
            name = next(found for found in numbered if found not in taken)
        taken.add(name)
        names.append(name)
    return tuple(names)
