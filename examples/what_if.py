"""What if? A recording simulated again with one thing changed, and with two.

Run: python examples/what_if.py [RECORDING]
"""

import sys
from pathlib import Path

import turtlelog as tl

PAPER_KP10 = Path(__file__).parents[1] / "recordings" / "paper" / "kp10.mcap"
NO_QUEUE: dict[str, object] = {"loop.queue_policy": "newest"}
NO_PAUSE: dict[str, object] = {"law.pause_ticks": 0}
CHANGES: dict[str, dict[str, object]] = {
    "as recorded": {},
    "without the queue": NO_QUEUE,
    "without the pause": NO_PAUSE,
    "without both": {**NO_QUEUE, **NO_PAUSE},
}

run = tl.read_run(Path(sys.argv[1]) if len(sys.argv) > 1 else PAPER_KP10)
scenario = tl.scenario.restore_scenario(run)
for what, changes in CHANGES.items():
    replayed = tl.replay_loop(run, tl.override_scenario(scenario, changes)).run
    error = tl.measure_run(replayed)["final.position_error"]
    print(f"{what:<18}{error.value:8.4f} {error.unit}")
