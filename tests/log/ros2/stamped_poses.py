"""Poses with stamps of a clock and a transport that are known."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.ros2.bag_rows import BagTimes, time_rows
from turtlelog.log.ros2.stamps import Stamps
from turtlelog.run import Clock

TimesNs = NDArray[np.int64]
EPOCH_NS = 1_700_000_000_000_000_000
MS = 1_000_000


def make_times(count: int = 1200, step_ms: float = 50.0) -> TimesNs:
    """Return when a robot measured, by the recorder's clock."""
    return EPOCH_NS + (np.arange(count) * step_ms * MS).astype(np.int64)


def make_stamps(
    true_ns: TimesNs,
    *,
    pace: float = 1.0,
    offset_s: float = 0.0,
    jitter_ms: float = 5.0,
    seed: int = 0,
) -> Stamps:
    """Return messages with a random transport of at least 2 ms, in the order of their arrival."""
    delay = 2.0 + np.random.default_rng(seed).exponential(jitter_ms, len(true_ns))
    passed = true_ns - true_ns[0]
    stamp_ns = true_ns[0] + np.rint(pace * passed).astype(np.int64) - round(offset_s * 1e9)
    log_ns = true_ns + np.rint(delay * MS).astype(np.int64)
    order = np.argsort(log_ns, kind="stable")
    return Stamps(log_ns=log_ns[order], stamp_ns=stamp_ns[order])


def time_poses(poses: Stamps, time: Any = "auto", commands: Stamps | None = None) -> BagTimes:
    return time_rows(poses, commands, time)


def read_clock(times: BagTimes) -> Clock:
    assert times.clock is not None
    return times.clock
