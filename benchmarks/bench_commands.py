"""Whole commands: start-up against importing numpy, with compiled files and without, and the demo.

Two copies of the package are measured: warm with its compiled files, cold without any, as after an
installation that compiled nothing; numpy and all else are compiled in both.
"""

import math
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.table import ROOT, Cost, Row, build_warm_environment, run_alone, time_commands

RUNS = 7
RECORDING = ROOT / "recordings" / "paper" / "kp10.mcap"
AIMS = {"--help": 1.3, "info": 2.0, "metrics": 2.0}


def measure(share: float = 1.0) -> Iterator[Row]:
    runs = max(1, round(RUNS * share))
    module = [sys.executable, "-m", "turtlelog"]
    commands = [
        [sys.executable, "-c", "import numpy"],
        [*module, "--help"],
        *([*module, name, str(RECORDING)] for name in ("info", "metrics")),
    ]
    with tempfile.TemporaryDirectory() as name:
        folder, bare = Path(name, "warm"), Path(name, "cold")
        for copy in (folder, bare):
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / "turtlelog", copy / "turtlelog", ignore=ignored)
        env = {**build_warm_environment(), "PYTHONPATH": str(folder)}
        cold_env = {**env, "PYTHONPATH": str(bare), "PYTHONDONTWRITEBYTECODE": "1"}
        warm, cold = ([math.inf] * len(commands) for _ in range(2))
        time_commands(*commands, repeats=1, env=env, folder=folder)  # compiles
        for _ in range(runs):
            times = time_commands(*commands, repeats=1, env=env, folder=folder)
            warm = list(map(min, warm, times))
            times = time_commands(*commands, repeats=1, env=cold_env, folder=bare)
            cold = list(map(min, cold, times))
        demo = [*module, "demo", "-o", str(folder / "out")]
        (demo_s,) = time_commands(demo, repeats=min(runs, 3), env=env, folder=folder)
    for state, (numpy_s, *times) in (("warm", warm), ("cold", cold)):
        for (command, aim), time_s in zip(AIMS.items(), times, strict=True):
            yield Row(
                job=f"start {command}, {state}",
                value=time_s,
                peer=Cost("import numpy", numpy_s, is_yardstick=True),
                aim=aim if state == "warm" else None,
            )
    yield Row(job="demo, four runs and their view", value=demo_s)


if __name__ == "__main__":
    run_alone(measure)
