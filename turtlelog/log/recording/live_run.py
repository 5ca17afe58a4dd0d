"""Live simulation into sinks, and their recorder, whose file is readable up to the last second."""

import struct
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from os import fstat
from os.path import samestat
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, Final, Protocol, Self

import msgspec

from turtlelog.errors import LogError, SimulationError
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.log.file_access import (
    StopRequest,
    catch_stop,
    exit_on_terminate,
    hold_stop,
    mark_live,
    name_write_error,
)
from turtlelog.log.mcap_writer import McapFile
from turtlelog.log.recording.head import HEAD, SCENARIO_FILE, describe_scenario, format_head
from turtlelog.log.recording.tick_records import TickRecords, measure_tick
from turtlelog.run import Event, Run
from turtlelog.run.stop_reasons import INTERRUPTED
from turtlelog.scenario import Scenario, format_scenario, resolve_scenario
from turtlelog.simulate import Tick, collect_run, declare_scenario, iterate_ticks
from turtlelog.simulate.step_budget import STEP_BUDGET_S

CHUNK_BYTES: Final = 2**16
"""Approximate chunk size in a live recording [bytes]."""

_FLUSH_S: Final = 1.0
"""Time after which a chunk is written even if it is not full, by the wall clock [s]."""

_INTERRUPTIONS: Final = (KeyboardInterrupt, SystemExit)
_NO_NOTES: Final[Mapping[str, str]] = MappingProxyType({})


class Sink(Protocol):
    """A receiver of live ticks, such as a recorder or a viewer."""

    def receive(self, tick: Tick) -> None:
        """Receive one tick. The last tick contains the stop reason."""
        ...

    def close(self, notes: Mapping[str, str]) -> None:
        """Finish, also after a failed run; `notes` are the notes of the run."""
        ...


class Pacer(Protocol):
    """A clock for pacing a run, like the module `time`."""

    def monotonic(self) -> float:
        """Return the time since a fixed instant [s], which never decreases."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Wait for at least a time [s]."""
        ...


class Pace:
    """Pacing of ticks: each tick waits for its time on the clock, relative to the first tick.

    A late loop continues without waiting until it has caught up, so that the end of a run does not
    drift. Ticks that are more than one period late are counted, because the recording does not show
    them.

    Attributes:
        late_ticks: Number of ticks that came late.
        greatest_lag_s: Largest delay of a tick [s].
    """

    def __init__(self, clock: Pacer, period_s: float) -> None:
        """Set the period of the plant [s], above which a delayed tick counts as late."""
        self._period_s = period_s
        self.late_ticks, self.greatest_lag_s = 0, 0.0
        self._clock, self._start_s = clock, 0.0

    def wait(self, tick: Tick) -> None:
        """Wait until the tick's time has come."""
        now_s = self._clock.monotonic()
        if not tick.time_ns:
            self._start_s = now_s
        deadline_s = self._start_s + tick.time_ns / 1e9
        if now_s < deadline_s:
            self._clock.sleep(deadline_s - now_s)
        elif now_s - deadline_s > self._period_s:
            self.late_ticks += 1
            self.greatest_lag_s = max(self.greatest_lag_s, now_s - deadline_s)

    def describe(self) -> dict[str, str]:
        """Return the notes for a run; empty if no tick was late."""
        if not self.late_ticks:
            return {}
        return {"late_ticks": f"{self.late_ticks}, by up to {self.greatest_lag_s:.3f} s"}


def run_live(
    scenario: Scenario,
    sinks: Sequence[Sink] = (),
    *,
    realtime: bool,
    clock: Pacer = time,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> Run:
    """Simulate a scenario, pass every tick to the sinks at once, and return the run.

    Ctrl-C, SIGTERM, SIGHUP and SIGQUIT end the run with the stop reason `interrupted` at the next
    tick; a second signal ends the run at once. The sinks are closed in any case.

    Args:
        scenario: Scenario to simulate.
        sinks: Receivers of the ticks. Each tick goes to them in the order of the list.
        realtime: Whether each tick waits for its time on the clock.
        clock: Clock used with `realtime`.
        step_budget_s: Longest computing time of the law per step [s]; None: no limit.

    Raises:
        ScenarioError: If the law cannot be loaded or may not run.
        SimulationError: If the law fails; the error's `run` is the run so far. The sinks have
            received the tick of the failure, with the stop reason `law_failed`, or `step_budget` if
            the law exceeded its time. The sinks are closed.
        KeyboardInterrupt: If the run was interrupted before the first sample.
        LogError: If a recorder cannot write.
    """
    scenario = resolve_scenario(scenario)
    if not isinstance(sinks, Sequence) or not all(hasattr(sink, "receive") for sink in sinks):
        raise SimulationError(f"sinks: expected a list of them, found {sinks!r:.60}")
    pace = Pace(clock, scenario.plant.facts.period_s) if realtime else None
    notes: dict[str, str] = {}
    with catch_stop() as request, ExitStack() as closing:
        for sink in reversed(sinks):
            closing.callback(sink.close, notes)
        try:
            ticks = iterate_ticks(scenario, step_budget_s=step_budget_s, one_by_one=realtime)
            run = collect_run(scenario, _drive(ticks, sinks, pace, request))
        except SimulationError as err:
            notes.update(pace.describe() if pace else {})
            err.run = err.run and replace(err.run, notes=notes)
            raise
        notes.update(pace.describe() if pace else {})
    return replace(run, notes=notes)


def _drive(
    ticks: Iterable[Tick], sinks: Sequence[Sink], pace: Pace | None, request: StopRequest
) -> Iterator[Tick]:
    is_answered = False
    for tick in ticks:
        if pace is not None:
            pace.wait(tick)
        is_answered = is_answered or bool(tick.computed)
        is_over = request.signal_number is not None and tick.stop_reason is None
        last = _end(tick) if is_over else tick
        for sink in sinks:
            sink.receive(last)
        if is_over and not is_answered:
            raise KeyboardInterrupt  # a run needs at least one sample
        yield last
        if is_over:
            return


def _end(tick: Tick) -> Tick:
    event = Event(time_ns=tick.time_ns, kind="stop", text=f"The run ended: {INTERRUPTED}.")
    return msgspec.structs.replace(tick, stop_reason=INTERRUPTED, events=(*tick.events, event))


def create_file(path: Path) -> BinaryIO:
    """Create a new file and return it unbuffered."""
    return path.open("xb", buffering=0)


class Recorder:
    """Recorder of the ticks of a running loop in a new file, visible under its name at once.

    Ticks are buffered until 64 KiB are full or a second has passed, and then written to the
    operating system as one self-contained chunk. A killed process therefore loses about the last
    second; a power failure may also lose data not yet written to disk. Nothing runs in the
    background: if the loop blocks, buffered ticks are written with the next tick.

    As a context manager, the recorder finishes the file at exit, also after Ctrl-C, SIGTERM, SIGHUP
    or SIGQUIT. An existing file is refused, also if another recorder is writing it. If the file is
    deleted, moved or replaced, the recording ends with the next chunk, because later data would be
    lost.
    """

    def __init__(
        self,
        path: str | Path,
        scenario: Scenario,
        *,
        flush_s: float = _FLUSH_S,
        create: Callable[[Path], BinaryIO] = create_file,
    ) -> None:
        """Create the file and write the metadata of the scenario.

        Args:
            path: The file, which must not exist.
            scenario: Scenario that runs.
            flush_s: Longest time that a tick is buffered [s].
            create: Function that creates the file, like `create_file`.

        Raises:
            LogError: If the file exists or cannot be written.
            ScenarioError: If the law cannot be loaded or may not run.
            LawError: If the law's declaration is invalid.
        """
        if isinstance(make_path(path), RemotePath):
            raise LogError(f"{make_path(path)}: expected a local file to record live, found a URL")
        scenario = resolve_scenario(scenario)
        self._path, self._scenario, self._flush_s = Path(path), scenario, flush_s
        self._declaration = declare_scenario(scenario)
        self._records = TickRecords(scenario, self._declaration)
        self._ticks: list[Tick] = []
        self._size, self._oldest_s = 0, 0.0
        self._safe_ns: int | None = None
        self._stop_reason: str | None = None
        self._exits, self._error_before = ExitStack(), sys.exception()
        with ExitStack() as undoing:
            with hold_stop():
                self._stream = self._create(create)
                undoing.callback(self._discard)
                self._place = self._path.absolute()  # the process may change its folder
                mark_live(self._stream)
                self._file, self._is_open = McapFile(self._stream), True
                with self._guard():
                    self._file.begin()
                    self._add_head(_NO_NOTES)
                    self._file.add_attachment(SCENARIO_FILE, format_scenario(scenario).encode())
            undoing.pop_all()

    def __enter__(self) -> Self:
        self._exits.enter_context(exit_on_terminate())
        return self

    def __exit__(self, *_: object) -> None:
        with self._exits:
            self.close()

    def receive(self, tick: Tick) -> None:
        """Record a tick.

        Raises:
            LogError: If the file cannot be written. The file is then closed, and readable up to
                that point.
        """
        if not self._is_open:
            raise LogError(f"{self._path}: expected a recording in progress, found a closed one")
        now_s = time.monotonic()
        if not self._ticks:
            self._oldest_s = now_s
        self._ticks.append(tick)
        self._size += measure_tick(tick)
        if self._size >= CHUNK_BYTES or now_s - self._oldest_s >= self._flush_s:
            self.flush()

    def flush(self) -> None:
        """Write buffered ticks to the operating system.

        Raises:
            LogError: As for `receive`, or if the file was moved, deleted or replaced.
        """
        self._write_ticks()
        loss = self._find_loss() if self._is_open else None
        if loss is not None:
            self._give_up(f"the file was {loss}")
            raise self._describe_loss(loss)

    def close(self, notes: Mapping[str, str] = _NO_NOTES) -> None:
        """Finish the file. A second call does nothing.

        A recording closed by Ctrl-C or an exit gets the stop reason `interrupted`.

        Args:
            notes: Notes of the run, as in `Run`.
        """
        with hold_stop():
            self._write_ticks()
            if not self._is_open:
                return
            error = sys.exception()
            if error is not self._error_before and isinstance(error, _INTERRUPTIONS):
                self._stop_reason = self._stop_reason or INTERRUPTED
            with self._guard():
                self._add_head(notes)
                self._file.finish()
            self._is_open = False
            loss = self._find_loss()
            try:
                self._stream.close()
            except OSError as err:
                raise LogError(
                    f"{self._path}: expected the system to keep the file, found: {err.strerror}"
                ) from err
            if loss is not None:
                raise self._describe_loss(loss)

    def _write_ticks(self) -> None:
        if self._is_open and self._ticks:
            with self._guard():
                self._file.add_chunk(self._records.encode(self._ticks))
                self._safe_ns = self._ticks[-1].time_ns
                self._stop_reason = self._ticks[-1].stop_reason or self._stop_reason
                self._ticks, self._size = [], 0

    def _find_loss(self) -> str | None:
        """Return what happened to the file if its name no longer leads to it; else None."""
        try:
            own = fstat(self._stream.fileno())
            with suppress(FileNotFoundError, NotADirectoryError):
                if samestat(own, self._place.stat()):
                    return None
        except OSError:  # not a regular file, or a folder that is no longer readable
            return None
        return "moved" if own.st_nlink else "deleted"

    def _describe_loss(self, loss: str) -> LogError:
        until = f"{(self._safe_ns or 0) / 1e9:.3f} s"
        rest = f"its {until} are lost" if loss == "deleted" else f"{until} are safe where it is now"
        return LogError(f"{self._path}: expected a file that stays, found it {loss}: {rest}")

    def _discard(self) -> None:
        """Remove a file that will not be finished."""
        with suppress(OSError):
            self._stream.close()
        self._path.unlink(missing_ok=True)

    def _create(self, create: Callable[[Path], BinaryIO]) -> BinaryIO:
        try:
            format_scenario(self._scenario).encode()
            return create(self._path)
        except FileExistsError as err:
            raise LogError(
                f"{self._path}: expected a new file, found one: a live recording replaces nothing"
            ) from err
        except OSError as err:
            raise LogError(f"{self._path}: cannot be written: {err.strerror or err}") from err
        except UnicodeEncodeError as err:
            raise name_write_error(self._path, err) from err

    def _add_head(self, notes: Mapping[str, str]) -> None:
        head = describe_scenario(
            self._scenario,
            self._declaration,
            stop_reason=self._stop_reason,
            nan_columns=self._records.nan_columns,
            more_topics=self._records.more_topics,
            notes=notes,
        )
        self._file.add_metadata(HEAD, format_head(head))

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """Delay signals until a write ends. If the write fails, close the readable file."""
        try:
            with hold_stop():
                yield
        except (OSError, UnicodeEncodeError, struct.error) as err:
            reason = (isinstance(err, OSError) and err.strerror) or str(err)
            self._give_up(reason)
            safe = (
                "its head alone is" if self._safe_ns is None else f"{self._safe_ns / 1e9:.3f} s are"
            )
            raise LogError(
                f"{self._path}: no room for the recording: {reason}: {safe} safe"
            ) from err

    def _give_up(self, reason: str) -> None:
        """Remove an incomplete record, finish the file if there is room, and close it."""
        self._is_open = False
        try:
            self._file.cut_back()
            self._add_head({"recording_failed": reason})
            self._file.finish()
        except OSError:
            with suppress(OSError):
                self._file.cut_back()
        with suppress(OSError):
            self._stream.close()
