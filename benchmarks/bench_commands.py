"""Whole commands: start-up against importing numpy, and the demo's time on one core."""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time

RUNS = 7


def measure(command: list[str]) -> tuple[float, float]:
    """Return the median wall and processor time of a command [s]."""
    walls, cores = [], []
    for _ in range(RUNS):
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        walls.append(time.perf_counter() - start)
        cores.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return statistics.median(walls), statistics.median(cores)


def main() -> None:
    module = [sys.executable, "-m", "turtlelog"]
    numpy_wall, numpy_core = measure([sys.executable, "-c", "import numpy"])
    help_wall, help_core = measure([*module, "--help"])
    print(f"import numpy      {numpy_wall:.3f} s wall, {numpy_core:.3f} s of a core")
    print(f"turtlelog --help  {help_wall:.3f} s wall, {help_core:.3f} s of a core")
    print(f"ratio             {help_wall / numpy_wall:.2f} wall, {help_core / numpy_core:.2f} core")
    with tempfile.TemporaryDirectory() as folder:
        wall, core = measure([*module, "demo", "-o", os.path.join(folder, "out")])  # noqa: PTH118
    print(f"turtlelog demo    {wall:.3f} s wall, {core:.3f} s of a core")


if __name__ == "__main__":
    main()
