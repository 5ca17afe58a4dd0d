import json

import numpy as np
import pytest

from tests.explain.truth import LISTS, Truth, make_log
from tests.log.runs import find_shared


@pytest.mark.parametrize("kp", [1, 4])
def test_the_generator_makes_the_papers_logs_bit_for_bit(kp: int) -> None:
    data = json.loads(find_shared("paper", f"kp{kp}_210.json").read_text())["data"]
    log = make_log(Truth(kp_angular=float(kp), kp_linear=float(kp)))
    made = dict(zip(LISTS, map(list, zip(*log.rows, strict=True)), strict=True))
    for name in LISTS[1:]:
        assert made[name] == data[name], name


def test_the_generators_truth_shows_in_its_log() -> None:
    log = make_log(Truth(cut_s=2.0, pause=0, delay=2, backlog=1))
    assert (log.read[:3], log.answered[:3], log.reason) == ([0, 1, 2], [0, 1, 2], "cut")
    poses = log.to_recording().poses.heading_rad
    # The command of sample 1 is taken three ticks later, and turns in that tick.
    assert (poses[3], poses[4], log.taken[1]) == (0.0, np.float32(0.016), 4)
