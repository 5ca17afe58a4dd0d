"""How much memory a replay takes: a robot that stands for hours has a million poses."""

import tracemalloc

import pytest

from tests.torture.bombs import chunk, describe, message, whole
from turtlelog.log import read_run
from turtlelog.replay import replay_plant
from turtlelog.run import Run

POSES = 10_000


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Run:
    file = tmp_path_factory.mktemp("memory") / "a.mcap"
    pose = b"\0\1\0\0" + bytes(20)
    rows = (message(1, pose, number * 16_000_000) for number in range(POSES))
    file.write_bytes(whole(chunk([describe("/turtle1/pose"), *rows])))
    return read_run(file)


def test_a_replay_takes_less_than_160_bytes_a_pose(standing: Run) -> None:
    replay_plant(standing)  # loads what it needs
    tracemalloc.start()
    assert replay_plant(standing).samples == POSES
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 160 * POSES
