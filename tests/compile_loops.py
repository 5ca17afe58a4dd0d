"""Compiles loops before the tests, whose workers would each do so: python -m tests.compile_loops"""

import sys

from turtlelog.scenario import get_preset
from turtlelog.simulate.many import ANY_LOOP, LOOP
from turtlelog.sweep.batch import ANY_BATCH, BATCH, measure_rows


def compile_loops(preset: str) -> None:
    """Compile what simulates and measures a preset, into the cache of numba."""
    loop, batch = (ANY_LOOP, ANY_BATCH) if preset == "lagged" else (LOOP, BATCH)
    if loop.load() is not None and batch.load() is not None:
        # Rows without end, as far as the batch knows, are worth whatever loading takes.
        measure_rows(
            get_preset(preset), {"law.kp_linear": [1.0, 2.0]}, ["run.duration"], ahead=10**12
        )


if __name__ == "__main__":
    compile_loops(sys.argv[1])
