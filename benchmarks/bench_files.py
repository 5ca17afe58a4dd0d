"""Writing and reading a run of 1,265 samples, against the libraries' own row-by-row ways."""

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import rerun as rr
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import turtlelog as tl

REPEATS = 9


def measure(call: Callable[[], object]) -> float:
    """Return the median time of a call [s]."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def decode_rows(path: Path) -> int:
    """Read every message through mcap-ros2-support's decoder."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages())


def log_rows(run: tl.Run, path: Path) -> None:
    """Log six signals of a run to Rerun, value by value."""
    samples, names = run.samples, ("bearing_rad", "heading_error_rad", "distance_m")
    columns = [getattr(samples, name) for name in (*names, "speed_m_s", "turn_rate_rad_s")]
    with rr.RecordingStream("turtlelog") as stream:
        stream.save(path)
        for row, time_ns in enumerate(samples.time_ns.tolist()):
            stream.set_time("sim_time", duration=time_ns / 1e9)
            for number, column in enumerate(columns):
                stream.log(f"signal{number}", rr.Scalars(column[row]))


def main() -> None:
    run = tl.simulate_run(tl.load_scenario("paper-kp1"))
    runs = [tl.simulate_run(tl.load_scenario(name)) for name in tl.scenario.PAPER_RUNS]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mcap, rrd = folder / "run.mcap", folder / "run.rrd"
        write = measure(lambda: tl.write_recording(run, mcap))
        read = measure(lambda: tl.read_recording(mcap))
        decode = measure(lambda: decode_rows(mcap))
        print(f"write_recording       {write * 1e3:7.1f} ms, {mcap.stat().st_size / 1e3:.0f} kB")
        print(f"read_recording        {read * 1e3:7.1f} ms")
        print(f"mcap_ros2 decoder     {decode * 1e3:7.1f} ms, {decode / read:.1f} times as long")
        tl.write_run_rrd(run, rrd)  # the first call loads Rerun
        show = measure(lambda: tl.write_run_rrd(run, rrd))
        both = measure(lambda: tl.write_comparison_rrd(runs, folder / "four.rrd"))
        rows = measure(lambda: log_rows(run, folder / "rows.rrd"))
        print(f"write_run_rrd         {show * 1e3:7.1f} ms, {rrd.stat().st_size / 1e3:.0f} kB")
        print(f"write_comparison_rrd  {both * 1e3:7.1f} ms for four runs")
        print(f"rr.log, five signals  {rows * 1e3:7.1f} ms, {rows / show:.1f} times as long")


if __name__ == "__main__":
    main()
