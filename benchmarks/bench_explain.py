"""Explaining a run, against simulating it once: identification and shares are many simulations."""

import sys
from collections.abc import Iterator

import turtlelog as tl
from benchmarks.table import ROOT, Cost, Row, run_alone, time_calls, time_commands
from turtlelog.explain import attribute_run, identify_run

RECORDING = ROOT / "recordings" / "paper" / "kp10.mcap"


def measure(share: float = 1.0) -> Iterator[Row]:
    run = tl.read_recording(RECORDING)
    scenario = tl.load_scenario("paper-kp10")
    identified = identify_run(run)
    repeats = max(1, round(3 * share))
    identify, attribute, simulate = time_calls(
        lambda: identify_run(run),
        lambda: attribute_run(run, identified=identified),
        lambda: tl.simulate_run(scenario),
        repeats=repeats,
    )
    command = [sys.executable, "-m", "turtlelog"]
    explain, run_once = time_commands(
        [*command, "explain", str(RECORDING)],
        [*command, "metrics", str(RECORDING)],
        repeats=repeats,
    )
    samples = len(run.samples)
    peer = Cost("one run", simulate / samples, is_yardstick=True)
    yield Row(job="identify kp10, a sample", value=identify / samples, peer=peer)
    yield Row(job="share out its error, a sample", value=attribute / samples, peer=peer)
    other = Cost("metrics", run_once, is_yardstick=True)
    yield Row(job="explain kp10, the command", value=explain, peer=other)


if __name__ == "__main__":
    run_alone(measure)
