"""Why did a run miss? What its log tells, and what each cause adds to its error.

Run: python examples/explain_run.py [RECORDING]
"""

import sys
from pathlib import Path

import turtlelog as tl

PAPER_KP10 = Path(__file__).parents[1] / "recordings" / "paper" / "kp10.mcap"

run = tl.read_run(Path(sys.argv[1]) if len(sys.argv) > 1 else PAPER_KP10)
identified = tl.identify_run(run)
for key, finding in identified.findings.items():
    print(f"{key} = {finding.value} ({finding.certainty}: {finding.evidence})")

for metric in ("final.position_error", "final.heading_error"):
    found = tl.attribute_run(run, metric=metric)
    print()
    print(*tl.explain.write_sentences(found), sep="\n")
