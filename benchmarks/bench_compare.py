"""Comparing two runs of a million samples with a tube, against pyfunnel and np.interp.

pyfunnel widens a curve by the same tolerance in time and value, and writes what it finds as CSV.
np.interp reads one curve at the rows of both, which is a part of a comparison without a tube.
"""

import tempfile
from collections.abc import Iterator
from functools import partial

import numpy as np
import pyfunnel

import turtlelog as tl
from benchmarks.table import Cost, Row, run_alone, time_calls
from turtlelog.compare.common_clock import align_runs, lay_grid
from turtlelog.compare.difference import _measure_rows, compare_aligned_signals
from turtlelog.run import CommandColumns, PoseColumns, SampleColumns

ROWS = 1_000_000
PART = 20_000  # of them, that pyfunnel reads: it takes long enough
REPEATS = 3
TUBES = (("x", 0.032), ("speed", 0.032), ("speed", 100.0))
PERIOD_NS = 16_000_000


def make_run(seed: int, late_ns: int, count: int) -> tl.Run:
    """Return a run of that many poses and samples: slow curves with noise."""
    rng = np.random.default_rng(seed)
    time_ns = np.arange(count) * PERIOD_NS + late_ns
    curve = 5.0 + 3.0 * np.sin(np.arange(count) / 1000.0) + rng.normal(0.0, 1e-4, count)
    speed = np.sign(np.sin(np.arange(count) / 3.0)) + rng.normal(0.0, 1e-4, count)
    rows, zeros = np.arange(count), np.zeros(count)
    return tl.Run(
        name=f"run-{seed}",
        source="benchmark",
        poses=PoseColumns(
            time_ns=time_ns, xy_m=np.stack([curve, curve], axis=1), heading_rad=curve % 3.0
        ),
        commands=CommandColumns(
            time_ns=time_ns.copy(),
            speed_m_s=speed.copy(),
            lateral_speed_m_s=zeros.copy(),
            turn_rate_rad_s=zeros.copy(),
        ),
        samples=SampleColumns(
            time_ns=time_ns.copy(),
            sequence=rows,
            pose_sequence=rows.copy(),
            phase=np.full(count, 2),
            bearing_rad=zeros.copy(),
            heading_error_rad=zeros.copy(),
            error_xy_m=np.ones((count, 2)),
            distance_m=zeros.copy(),
            speed_m_s=speed,
            turn_rate_rad_s=zeros.copy(),
            world_velocity_m_s=np.zeros((count, 2)),
        ),
    )


def find_errors(runs: tuple[tl.Run, tl.Run], name: str, time_s: float, part: int) -> None:
    """Compare the first rows of a signal with pyfunnel."""
    columns = []
    for run in runs:
        signal = tl.read_signal(run, name)
        assert signal is not None
        times_s = (signal.time_ns[:part] - signal.time_ns[0]) / 1e9
        columns += [times_s, signal.values[:part]]
    with tempfile.TemporaryDirectory() as folder:
        failed = pyfunnel.compareAndReport(
            *columns, outputDirectory=folder, atolx=time_s, atoly=1e-3
        )
        assert failed == 0


def measure(share: float = 1.0) -> Iterator[Row]:
    rows, part = round(ROWS * share), round(PART * share)
    reference, run = make_run(1, 0, rows), make_run(2, 5_000_000, rows)
    clock = align_runs(reference, run, "recorded")

    def compare(name: str, tolerance: tl.Tolerance) -> object:
        signals = [tl.read_signal(found, name) for found in (reference, run)]
        assert signals[0] is not None
        assert signals[1] is not None
        placed = clock.place_signal(signals[0], reference), clock.place_signal(signals[1], run)
        grid = lay_grid(placed[0].time_ns, placed[1].time_ns, clock.span)
        return _measure_rows(placed, grid, tolerance, clock, [])

    for name, time_s in TUBES:
        ours, peer = time_calls(
            partial(compare, name, tl.Tolerance(abs=1e-3, time_s=time_s)),
            partial(find_errors, (reference, run), name, time_s, part),
            repeats=REPEATS,
        )
        scaled = Cost("pyfunnel", peer * rows / part)
        yield Row(job=f"tube of {name} within {time_s:g} s", value=ours, peer=scaled)
    close = tl.Tolerance(abs=1e-3, time_s=0.032)
    tolerances = {
        name: close if name in {"x", "y", "speed"} else tl.Tolerance() for name in tl.SIGNALS
    }
    at = np.sort(np.concatenate([reference.poses.time_ns, run.poses.time_ns]), kind="stable")
    xp, fp = reference.poses.time_ns, reference.poses.xy_m[:, 0].copy()
    names = [name for name in tl.SIGNALS if tl.measure.find_signal(run, name) is not None]
    ours, interp = time_calls(
        lambda: compare_aligned_signals(reference, run, clock, tolerances),
        lambda: np.interp(at, xp, fp),
        repeats=REPEATS,
    )
    by_hand = Cost("numpy interp", interp * len(names), is_yardstick=True)
    yield Row(job=f"compare all {len(names)} signals", value=ours, peer=by_hand)


if __name__ == "__main__":
    run_alone(measure)
