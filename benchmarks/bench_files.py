"""Writing and reading a run of 1,265 samples, against the libraries' own row-by-row ways."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import rerun as rr
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import turtlelog as tl
from benchmarks.table import Cost, Row, run_alone, time_calls

REPEATS = 9


def decode_rows(path: Path) -> int:
    """Read every message through mcap-ros2-support's decoder."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages())


def log_rows(run: tl.Run, path: Path) -> None:
    """Log five signals of a run to Rerun, value by value."""
    samples, names = run.samples, ("bearing_rad", "heading_error_rad", "distance_m")
    columns = [getattr(samples, name) for name in (*names, "speed_m_s", "turn_rate_rad_s")]
    with rr.RecordingStream("turtlelog") as stream:
        stream.save(path)
        for row, time_ns in enumerate(samples.time_ns.tolist()):
            stream.set_time("sim_time", duration=time_ns / 1e9)
            for number, column in enumerate(columns):
                stream.log(f"signal{number}", rr.Scalars(column[row]))


def measure(share: float = 1.0) -> Iterator[Row]:
    scenario = tl.load_scenario("paper-kp1")
    # The whole run is over before.
    scenario = tl.override_scenario(scenario, {"max_duration_s": 25.0 * share})
    run = tl.simulate_run(scenario)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mcap, rrd = folder / "run.mcap", folder / "run.rrd"
        tl.write_run_rrd(run, rrd)  # the first call loads Rerun
        write, read, decode, show, rows = time_calls(
            lambda: tl.write_recording(run, mcap),
            lambda: tl.read_recording(mcap),
            lambda: decode_rows(mcap),
            lambda: tl.write_run_rrd(run, rrd),
            lambda: log_rows(run, folder / "rows.rrd"),
            repeats=REPEATS,
        )
    samples = f"{len(run.samples):,} samples"
    yield Row(job=f"write {samples}", value=write)
    yield Row(job=f"read {samples}", value=read, peer=Cost("mcap_ros2", decode))
    by_row = Cost("rr.log", rows, is_yardstick=True)
    yield Row(job=f".rrd of {samples}", value=show, peer=by_row)


if __name__ == "__main__":
    run_alone(measure)
