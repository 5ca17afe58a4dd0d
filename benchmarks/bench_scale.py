"""What a sweep costs as it grows tenfold and a hundredfold, and what two Dask workers add.

The rows are whole runs of the paper's experiment, with noise, varied in seed and gain, with five
metrics.
Peaks and costs of a row must stay what they are: a sweep of any size is one of a thousand, again
and again. docs/scale.md calculates with what is printed here.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import turtlelog as tl
from benchmarks.bench_batch import METRICS
from benchmarks.table import Cost, Row, run_alone, run_apart, time_calls
from turtlelog.measure import measure_run

ROWS = 1_000  # to begin with
SHARED = 1_000  # by two workers, interpreted
REPEATS = 3

SWEEP = """
import contextlib, io, os, resource
from turtlelog.cli.app import main
from turtlelog.sweep.partial_table import KeptParts
close = KeptParts.close
def tell(kept, **options):
    said["partial"] = kept.path.stat().st_size / 1e6
    close(kept, **options)
KeptParts.close = tell
def read_s():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
def sweep(count, output):
    # Noise of many seeds: no two rows are alike, and the work of a row is the same in each sweep.
    words = ["sweep", "paper", "--metric", arguments[0], "--jobs", "1", "-o", output]
    words += ["--set", "sensing.noise_position_m=0.01", "--set", "sensing.noise_heading_rad=0.01"]
    words += ["--grid", f"seed=1:{count // 100}", "--grid", "law.kp_linear=0.1:10:0.1"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        main(words)
sweep(2_000, arguments[1] + ".first.parquet")  # loads and compiles
begun = read_s()
sweep(int(arguments[2]), arguments[1])
said["time"] = read_s() - begun
said["peak"] = read_peak()
said["table"] = os.path.getsize(arguments[1]) / 1e6
"""

PLAN = """
from turtlelog.scenario import load_scenario
from turtlelog.sweep import build_plan, prepare_sweep
from turtlelog.sweep.sweep_scenario import _cut_chunks
axes = [f"law.kp_{name}=1:{side}" for name, side in (("linear", 10_000), ("angular", 10_000))]
prepare_sweep(load_scenario("paper"), build_plan(["seed=0:9"]))
before = read_peak()
sweep = prepare_sweep(load_scenario("paper"), build_plan(axes))
chunks = _cut_chunks(sweep.cut_chunk, [(0, sweep.plan.row_count)], 1024)
assert chunks[len(chunks) - 1].values[-1] == (10_000.0, 10_000.0)
assert sweep.plan.row_count == 10**8
said["peak"] = read_peak() - before
"""


def measure(share: float = 1.0) -> Iterator[Row]:
    yield from _measure_growth(max(1_000, round(100 * ROWS * share)))
    plan = run_apart(PLAN)["peak"]
    yield Row(job="plan of 10^8 rows", value=plan, unit="MB", aim=50, aim_of="value")
    yield from _measure_one()
    yield _measure_workers(max(20, round(SHARED * share)))


def _measure_growth(most: int) -> Iterator[Row]:
    """Yield rows of a sweep of a thousand rows, and of the same up to a hundred times."""
    with tempfile.TemporaryDirectory() as name:
        told = [ROWS]
        told += [count for count in (10 * ROWS, 100 * ROWS) if count <= most]
        said = {
            count: run_apart(
                SWEEP, ",".join(METRICS), str(Path(name) / f"{count}.parquet"), str(count)
            )
            for count in told
        }
    first = said[ROWS]
    yield Row(job=f"sweep, a row of {ROWS:,}", value=first["time"] / ROWS)
    for count in told[1:]:
        cost = Cost(f"{ROWS:,} rows", first["time"] / ROWS)
        value = said[count]["time"] / count
        yield Row(job=f"sweep, a row of {count:,}", value=value, bound=cost, aim=1.1)
        peak = Cost(f"{ROWS:,} rows", first["peak"])
        job = f"peak of sweep, {count:,} rows"
        yield Row(job=job, value=said[count]["peak"], unit="MB", bound=peak, aim=1.2)
    for kind in ("table", "partial"):
        value = said[told[-1]][kind]
        yield Row(job=f"{kind} file of {told[-1]:,} rows", value=value, unit="MB")


def _measure_one() -> Iterator[Row]:
    """Yield what a single run costs that is interpreted, and its recording."""
    base = tl.load_scenario("paper")

    def simulate() -> None:
        measure_run(tl.simulate_run(base), only=METRICS)

    simulate()
    (value,) = time_calls(simulate)
    yield Row(job="run, interpreted and measured", value=value)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "run.mcap"
        tl.write_recording(tl.simulate_run(base), path)
        yield Row(job="recording of a run", value=path.stat().st_size / 1e6, unit="MB")


def _measure_workers(count: int) -> Row:
    """Return what rows cost on two Dask workers: that of the command, workers and scheduler."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        file = folder / "scheduler.json"
        parts = [stack.enter_context(_start("scheduler", "--scheduler-file", str(file)))]
        while not file.exists():
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        for _ in range(2):
            parts.append(
                stack.enter_context(_start("worker", address, "--nthreads", "1", "--no-nanny"))
            )
        _sweep(folder / "first.parquet", 40, "--scheduler", address)  # what is loaded once
        there, here = [], []
        for number in range(REPEATS):  # in turns: what else runs on the computer only ever adds
            begun = sum(map(_read_s, parts))
            own = _sweep(folder / f"there{number}.parquet", count, "--scheduler", address)
            there.append(own + sum(map(_read_s, parts)) - begun)
            here.append(_sweep(folder / f"here{number}.parquet", count, "--jobs", "2"))
        assert (folder / "here0.parquet").read_bytes() == (folder / "there0.parquet").read_bytes()
    peer = Cost("--jobs 2", min(here))
    return Row(job=f"{count:,} rows, two Dask workers", value=min(there), peer=peer, aim=1.25)


def _sweep(output: Path, count: int, *words: str) -> float:
    """Sweep over rows that are interpreted; return the processor time of command and children."""
    code = (
        "import resource, sys\nfrom turtlelog.cli.app import main\ntry:\n    main()\n"
        "except SystemExit as err:\n    code = err.code\n"
        "kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN\n"
        "used = [getattr(resource.getrusage(kind), name) for kind in kinds"
        " for name in ('ru_utime', 'ru_stime')]\n"
        "print('used', sum(used))\nsys.exit(code)\n"
    )
    # Without --metric every row has those of its law, which no compiled code measures.
    sweep = ["sweep", "paper", "--grid", f"seed=1:{count}", "-o", str(output)]
    command = [sys.executable, "-c", code, *sweep, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


@contextmanager
def _start(kind: str, *words: str) -> Iterator["subprocess.Popen[bytes]"]:
    """Start a part of a cluster on this computer, which ends with the block."""
    command: Sequence[str] = (
        *(sys.executable, "-m", f"distributed.cli.dask_{kind}", *words),
        *("--host", "127.0.0.1", "--no-dashboard"),
        *(("--port", "0") if kind == "scheduler" else ()),
    )
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=quiet, stderr=quiet) as process:
        try:
            yield process
        finally:
            process.kill()


def _read_s(process: "subprocess.Popen[bytes]") -> float:
    """Return the processor time of a process so far."""
    import psutil  # comes with distributed

    used = psutil.Process(process.pid).cpu_times()
    return float(used.user + used.system)


if __name__ == "__main__":
    run_alone(measure)
