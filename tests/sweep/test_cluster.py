"""A Dask scheduler and workers in processes of their own, on 127.0.0.1."""

import gc
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest

import turtlelog as tl
import turtlelog.sweep.cluster
from tests.laws.test_law_files import write_law
from turtlelog.cli.app import main
from turtlelog.errors import LawError, ProcessError
from turtlelog.laws import WorkWithLaws, name_given_law
from turtlelog.laws.given_laws import find_given_law
from turtlelog.processes import map_in_processes
from turtlelog.sweep.cluster import connect_cluster


class Weave:
    """A law without a name in a module, once it is made in a function."""

    def __init__(self, rate_rad_s: float) -> None:
        self.rate_rad_s = rate_rad_s

    def step(self, time_ns: int, pose: Any) -> tuple[float, float]:
        return 0.5, self.rate_rad_s if time_ns % 2_000_000_000 < 1_000_000_000 else 0.0


FILES = [f"recordings/paper/kp{gain}.mcap" for gain in (1, 4, 7, 10)]


@contextmanager
def _start(
    kind: str, *words: str, folder: Path | None = None
) -> Iterator["subprocess.Popen[bytes]"]:
    """Start a part of a cluster, which is ended by its own handle.

    Args:
        kind: scheduler or worker.
        words: Its options.
        folder: It finds modules there first.
    """
    paths = os.pathsep.join([*([] if folder is None else [str(folder)]), str(Path.cwd())])
    env = {**os.environ, "PYTHONPATH": paths}
    command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"]
    log = subprocess.DEVNULL
    command += ["--host", "127.0.0.1"]
    with subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, env=env) as process:
        try:
            yield process
        finally:
            process.kill()


def _start_worker(address: str) -> "ExitStack[bool | None]":
    started = ExitStack()
    started.enter_context(_start("worker", address, "--nthreads", "1", "--no-nanny"))
    return started


@contextmanager
def _start_scheduler(folder: Path) -> "Iterator[tuple[str, subprocess.Popen[bytes]]]":
    import json

    file = folder / "scheduler.json"
    with _start("scheduler", "--port", "0", "--scheduler-file", str(file)) as process:
        deadline_s = time.monotonic() + 60
        while not file.exists() and time.monotonic() < deadline_s:
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"], process


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with _start_scheduler(tmp_path_factory.mktemp("cluster")) as (address, _):
        yield address


@pytest.fixture(scope="module")
def cluster(scheduler: str) -> Iterator[str]:
    with _start_worker(scheduler), _start_worker(scheduler):
        with connect_patiently(scheduler, workers=2):
            pass
        yield scheduler


@contextmanager
def connect_patiently(address: str, *, workers: int) -> Iterator[None]:
    import distributed

    with distributed.Client(address, timeout=60, set_as_default=False) as client:
        client.wait_for_workers(workers, timeout=60)
        yield


def _wait_less(number: int) -> int:
    time.sleep((7 - number) / 50)
    return number


def _square_slowly(number: int) -> tuple[int, int]:
    """Return a square, and the process that computed it."""
    time.sleep(0.03)
    return number**2, os.getpid()


def _run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code, *capsys.readouterr()


def test_a_scheduler_without_workers_is_one_line(
    scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turtlelog.sweep.cluster, "_CONNECT_S", 1.0)
    with (
        pytest.raises(ProcessError, match=r"tcp://\S+: the scheduler has no worker after 1 s"),
        connect_cluster(scheduler),
    ):
        pass


def test_a_scheduler_that_is_not_there_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert turtlelog.sweep.cluster._CONNECT_S < 10
    monkeypatch.setattr(turtlelog.sweep.cluster, "_CONNECT_S", 0.5)
    began_s = time.monotonic()
    code, out, err = _run(capsys, "metrics", FILES[0], "--scheduler", "tcp://127.0.0.1:1")
    assert time.monotonic() - began_s < 10
    assert (code, out) == (2, "")
    assert err == (
        "turtlelog: error: --scheduler tcp://127.0.0.1:1: no Dask scheduler answers within 0.5 s;"
        " start one (dask scheduler), or type its address, such as tcp://host:8786\n"
    )


NO_ADDRESS = "this is not the address of a Dask scheduler; type one such as tcp://host:8786"
NO_USE = "Dask cannot use this address ("
NO_SECRETS = "the address of a Dask scheduler has no user, password or query; type it without them"
ADDRESSES = {
    "": f"'': {NO_ADDRESS}",
    "nowhere": f"nowhere: {NO_ADDRESS}",
    "tcp://127.0.0.1": f"tcp://127.0.0.1: {NO_ADDRESS}",
    "host:x": f"host:x: {NO_ADDRESS}",
    "127.0.0.1:0": f"127.0.0.1:0: {NO_ADDRESS}",
    "tcp://127.0.0.1:65536": f"tcp://127.0.0.1:65536: {NO_ADDRESS}",
    "tcp://127.0.0.1:1?key=PW": f"tcp://127.0.0.1:1: {NO_SECRETS}",
    "tls://127.0.0.1:1": f"tls://127.0.0.1:1: {NO_USE}",
    "ucx://127.0.0.1:1": f"ucx://127.0.0.1:1: {NO_USE}",
    "http://127.0.0.1:1": f"http://127.0.0.1:1: {NO_USE}",
    "tcp://U:PW@127.0.0.1:1": f"tcp://127.0.0.1:1: {NO_SECRETS}",
    "U:P/W://PW@127.0.0.1:1": f"127.0.0.1:1: {NO_SECRETS}",
    "tcp://U:PW@nowhere": f"tcp://nowhere: {NO_ADDRESS}",
}


@pytest.mark.everyday("tcp://U:PW@127.0.0.1:1", "tcp://127.0.0.1:65536")
@pytest.mark.parametrize("address", ADDRESSES)
def test_an_address_that_is_none_is_one_line_without_its_password(
    address: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = _run(capsys, "metrics", FILES[0], "--scheduler", address)
    gc.collect()  # nothing of a client that never connected is left to fail later
    assert (code, out, err.count("\n"), capsys.readouterr().err) == (2, "", 1, "")
    assert err.startswith(f"turtlelog: error: --scheduler {ADDRESSES[address]}")
    assert "PW" not in err


@pytest.mark.thorough
@pytest.mark.parametrize("end", ["SIGTERM", "SIGKILL"])
@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in other ways")
def test_a_scheduler_that_ends_is_one_line_and_the_sweep_goes_on(end: str, tmp_path: Path) -> None:
    """A scheduler and a worker start, end, and start again."""
    rows = tl.sweep.build_plan(["law.kp_linear=1:9:0.02"])
    base = tl.override_scenario(tl.load_scenario("paper-kp4"), {"max_duration_s": 4.0})
    sweep = tl.sweep.prepare_sweep(base, rows, metrics=["rotate.dead_time"])
    output, done = tmp_path / "t.parquet", [0]

    def end_scheduler(count: int) -> None:
        done.append(count)
        if count > 40:
            process.send_signal(getattr(signal, end))

    with _start_scheduler(tmp_path) as (address, process), _start_worker(address):
        with connect_patiently(address, workers=1):
            pass
        line = rf"^--scheduler {address}: the Dask scheduler ended before the work was done; start"
        with pytest.raises(ProcessError, match=line), connect_cluster(address) as cluster:
            tl.sweep.run_sweep(sweep, output, jobs=cluster, watch=end_scheduler)
    assert 40 < done[-1] < 401
    again: list[int] = []
    tl.sweep.run_sweep(sweep, output, jobs=1, watch=again.append)
    assert (again[0], again[-1]) == (done[-1], 401)


@pytest.mark.parametrize(
    "words",
    [
        ["metrics", "--json"],
        ["metrics", "--csv"],
        ["check", "--json", "--expect", "rotate.overshoot < 5"],
    ],
    ids=" ".join,
)
def test_a_cluster_answers_as_this_computer_does(
    words: list[str], cluster: str, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(Path(file).absolute()) for file in [*FILES, "recordings/none.mcap"]]
    here = _run(capsys, *words, *files, "--jobs", "1")
    assert _run(capsys, *words, *files, "--scheduler", cluster) == here
    assert len(here[1]) > 300


@pytest.mark.thorough
def test_a_cluster_tunes_as_this_computer_does(
    cluster: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        *("tune", "paper-kp4", "--grid", "law.kp_linear=1:12", "--minimise", "run.path_length"),
        *("--evaluations", "12", "--monte-carlo", "3", "--set", "max_duration_s=4", "--json"),
    ]
    here = _run(capsys, *words, "--jobs", "1")
    assert here[0] == 0
    assert _run(capsys, *words, "--scheduler", cluster) == here


def test_a_cluster_imports_the_helpers_beside_a_law(
    cluster: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kinds = [write_law(tmp_path / name, speed) for name, speed in (("a", 0.5), ("b", 0.25))]
    grid = ["--grid", f"law.kind={','.join(kinds)}", "--grid", "start.heading_rad=0,1"]
    words = ["sweep", "--set", "max_duration_s=0.5", "--law", kinds[0], *grid]
    output = tmp_path / "t.parquet"
    assert _run(capsys, *words, "-o", str(output), "--scheduler", cluster)[0] == 0
    assert pyarrow.parquet.read_table(output).column("failed").to_pylist() == [None] * 4


def test_who_says_nothing_is_no_scheduler(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(turtlelog.sweep.cluster, "_CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        code, _, err = _run(capsys, "metrics", FILES[0], "--scheduler", address)
    assert code == 2
    assert f"--scheduler {address}: no Dask scheduler answers" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["sweep", "paper-kp4", "--grid", "law.kp_linear=1:12", "--set", "max_duration_s=3"],
        ["metrics", *FILES[:2], "--metric", "final.*"],
        ["check", *FILES[:2], "--expect", "final.position_error < 0.005"],
    ],
    ids=lambda words: words[0],
)
def test_a_cluster_writes_the_same_table(
    words: list[str], cluster: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(Path(word).absolute()) if word.endswith(".mcap") else word for word in words]
    here, there = tmp_path / "here.parquet", tmp_path / "there.parquet"
    code = _run(capsys, *words, "-o", str(here), "--jobs", "1")[0]
    assert _run(capsys, *words, "-o", str(there), "--scheduler", cluster)[0] == code
    assert there.read_bytes() == here.read_bytes()


def test_results_stand_in_the_order_of_the_items(cluster: str) -> None:
    with connect_cluster(cluster) as executor:
        found = map_in_processes(_wait_less, range(8), executor)
        assert list(found) == list(range(8))


def test_an_error_of_the_work_is_raised_here(cluster: str) -> None:
    with connect_cluster(cluster) as executor, pytest.raises(ZeroDivisionError):
        list(map_in_processes(lambda n: 1 // (n - 3), range(8), executor))


def test_a_worker_that_is_killed_in_the_middle_loses_nothing(cluster: str) -> None:
    """Workers start, one is killed, and what it did is done again."""
    with _start("worker", cluster, "--nthreads", "1", "--no-nanny") as doomed:
        with connect_patiently(cluster, workers=3):
            pass
        with connect_cluster(cluster) as executor:
            found = map_in_processes(_square_slowly, range(90), executor)
            first = [next(found) for _ in range(12)]
            doomed.kill()
            results = [*first, *found]
        assert doomed.pid in {process for _, process in first}
        assert [square for square, _ in results] == [n * n for n in range(90)]


def test_another_turtlelog_on_a_worker_is_one_line(
    cluster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = tl.__version__
    monkeypatch.setattr(turtlelog.sweep.cluster, "__version__", "99.0")
    expected = rf"^{cluster}: expected turtlelog 99\.0 on every worker, found {theirs} on tcp://"
    with pytest.raises(ProcessError, match=expected), connect_cluster(cluster):
        pass


@pytest.mark.thorough
def test_a_worker_with_another_turtlelog_that_joins_late_does_nothing(
    scheduler: str, tmp_path: Path
) -> None:
    """A worker with a package of its own starts and joins."""
    shutil.copytree("turtlelog", tmp_path / "turtlelog")
    libraries = tmp_path / "turtlelog" / "libraries.py"
    text = libraries.read_text()
    assert text.count(f'__version__ = "{tl.__version__}"\n') == 1
    libraries.write_text(text.replace(f'"{tl.__version__}"', '"99.0"'))
    expected = rf"^{scheduler}: expected turtlelog {tl.__version__} on every worker, found 99\.0 on"
    done: list[int] = []

    def work_beside_another() -> None:
        with connect_cluster(scheduler) as executor:
            late.enter_context(
                _start("worker", scheduler, "--nthreads", "1", "--no-nanny", folder=tmp_path)
            )
            for square, _ in map_in_processes(_square_slowly, range(3000), executor):
                done.append(square)

    with ExitStack() as late, _start_worker(scheduler):
        with connect_patiently(scheduler, workers=1):
            pass
        with pytest.raises(ProcessError, match=expected):
            work_beside_another()
    assert done == [number**2 for number in range(len(done))]


def test_a_cluster_that_gives_up_is_one_line_with_the_item() -> None:
    from distributed.scheduler import KilledWorker

    class GivesUp(Executor):
        def submit(self, work: object, item: Any, /) -> "Future[Any]":  # type: ignore[override]
            future: Future[Any] = Future()
            future.set_exception(item)
            return future

    for found in (KilledWorker("task", "worker", 3), CancelledError()):
        with pytest.raises(ProcessError, match=r"^a\.mcap: no result") as caught:
            list(map_in_processes(str, [found], GivesUp(), name=lambda _: "a.mcap"))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["metrics", FILES[0], "--jobs", "2"], "--jobs: the cluster of --scheduler has its own"),
        (
            ["check", FILES[0], "--expect", "rotate.overshoot < 5", "--report", "r.html"],
            "--report: leave out --scheduler",
        ),
    ],
)
def test_what_has_no_place_beside_a_cluster_is_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = _run(capsys, *words, "--scheduler", "tcp://U:PW@127.0.0.1:1")
    assert code == 2
    assert said in err
    assert "PW" not in err


def make_weaving(rate_rad_s: float) -> Any:
    def weave(time_ns: int, pose: Any, goal: Any) -> tuple[float, float]:
        return 0.5, rate_rad_s if time_ns % 2_000_000_000 < 1_000_000_000 else 0.0

    return weave


GRID = {"limits.speed_m_s": [0.1 * number for number in range(1, 7)], "max_duration_s": [3.0]}


@pytest.mark.thorough
@pytest.mark.parametrize("make", [make_weaving, Weave])
def test_workers_get_a_law_of_this_session_with_their_work(
    cluster: str, make: Callable[[float], Any]
) -> None:
    """Starts a cluster, and simulates plain: 5 s."""
    for rate_rad_s in (0.3, 0.6):
        law = make(rate_rad_s)
        here = tl.sweep_scenario("textbook", GRID, law=law, metrics=["run.path_length"], jobs=1)
        with connect_cluster(cluster) as jobs:
            there = tl.sweep_scenario(
                "textbook", GRID, law=law, metrics=["run.path_length"], jobs=jobs
            )
        assert there.failed == 0
        assert there.to_arrow().equals(here.to_arrow())


def test_a_law_that_cannot_be_sent_is_refused_before_the_work() -> None:
    law = Weave(0.3)
    law.lock = threading.Lock()  # type: ignore[attr-defined]
    kind = name_given_law(law)
    with pytest.raises(LawError, match=f"{kind} cannot be sent .*write it to a file"):
        WorkWithLaws(len, [kind])


def test_a_worker_uses_one_law_of_a_name_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two sessions may each have a law `session:weave`; here one task waits inside the other."""
    laws = make_weaving(0.3), make_weaving(0.6)
    kinds = [name_given_law(law) for law in laws]
    works = [WorkWithLaws(read_rate, [kind]) for kind in kinds]
    given: dict[str, Any] = {}
    monkeypatch.setattr("turtlelog.laws.given_laws._OWN", "another session")
    monkeypatch.setattr("turtlelog.laws.given_laws._GIVEN", given)
    monkeypatch.setattr("turtlelog.laws.given_laws._LENT", {})
    first, second = works[0]._packed[kinds[0]], works[1]._packed[kinds[1]]
    works[0]._packed, works[1]._packed = {"session:weave": first}, {"session:weave": second}
    assert [work("session:weave") for work in (*works, works[0])] == [0.3, 0.6, 0.3]

    def use_other(kind: str) -> float:
        works[1](kind)
        return 0.0

    works[0].work = use_other
    with pytest.raises(LawError, match="this worker uses a law of that name of another session"):
        works[0]("session:weave")
    assert works[1]("session:weave") == 0.6
    given["session:own"] = laws[0]
    works[1]._packed = {"session:own": second}
    with pytest.raises(LawError, match="session:own: this worker uses a law of that name"):
        works[1]("session:own")


def read_rate(kind: str) -> float:
    return float(find_given_law(kind)(0, None, None)[1])
