"""Live runs: simulated into sinks, and read from a growing recording."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Protocol, Self

import msgspec
from mcap.opcode import Opcode

from turtlelog.errors import SimulationError
from turtlelog.log.engine.blocks import build_walked_block
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.decode import Rows, Selection, read_piece
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.records import MCAP0_MAGIC, check_start
from turtlelog.log.engine.walk import Section, walk_growing
from turtlelog.log.file_access import is_live, name_file, open_file
from turtlelog.log.recording import topics
from turtlelog.log.recording.reader import build_run, reconcile_contents
from turtlelog.log.recording.topics import build_contents
from turtlelog.processes import catch_stop
from turtlelog.run import Event, Run
from turtlelog.run.stop_reasons import INTERRUPTED
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate import Tick, collect_run, iterate_ticks
from turtlelog.simulate.step_budget import STEP_BUDGET_S


class Sink(Protocol):
    """A receiver of live ticks, such as a recorder or a viewer."""

    def receive(self, tick: Tick) -> None:
        """Receive one tick. The last tick contains the stop reason."""

    def close(self, notes: Mapping[str, str]) -> None:
        """Finish, also after a failed run; `notes` are the notes of the run."""


class Pacer(Protocol):
    """A clock for pacing a run, like the module `time`."""

    def monotonic(self) -> float:
        """Return the time since a fixed instant [s], which never decreases."""

    def sleep(self, duration_s: float) -> None:
        """Wait for at least a time [s]."""


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
            received the tick of the failure, with the stop reason `law_failed` or `step_budget`.
        KeyboardInterrupt: If the run was interrupted before the first sample.
        LogError: If a recorder cannot write.
    """
    scenario = resolve_scenario(scenario)
    if not isinstance(sinks, Sequence) or not all(hasattr(sink, "receive") for sink in sinks):
        raise SimulationError(f"sinks: expected a list of them, found {sinks!r:.60}")
    pace = Pace(clock, scenario.plant.facts.period_s) if realtime else None
    notes: dict[str, str] = {}
    with catch_stop() as caught, ExitStack() as closing:
        for sink in reversed(sinks):
            closing.callback(sink.close, notes)
        try:
            ticks = iterate_ticks(scenario, step_budget_s=step_budget_s, one_by_one=realtime)
            run = collect_run(scenario, _drive(ticks, sinks, pace, caught))
        except SimulationError as err:
            notes.update(pace.describe() if pace else {})
            err.run = err.run and replace(err.run, notes=notes)
            raise
        notes.update(pace.describe() if pace else {})
    return replace(run, notes=notes)


def _drive(
    ticks: Iterable[Tick], sinks: Sequence[Sink], pace: Pace | None, caught: Sequence[int]
) -> Iterator[Tick]:
    is_answered = False
    for tick in ticks:
        if pace is not None:
            pace.wait(tick)
        is_answered = is_answered or bool(tick.computed)
        is_over = bool(caught) and tick.stop_reason is None
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


_EVERYTHING: Final = Selection()
_ANY_SIZE: Final = 2**40  # bytes; the final size is unknown


class RecordingTail:
    """An open turtlelog recording that may still grow.

    Attributes:
        is_finished: Whether the end of the recording has been read.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the recording.

        Raises:
            LogError: If the file cannot be read, or is not an MCAP file.
        """
        self.is_finished = False
        self._path, self._place = Path(path), len(MCAP0_MAGIC)
        self._catalogue = Catalogue(Allowance(_ANY_SIZE))
        self._records: list[Any] = []
        self._parts: dict[str, list[Rows]] = {}
        with ExitStack() as closing, name_file(path, expected="a turtlelog recording"):
            self._stream = closing.enter_context(open_file(self._path))
            check_start(self._stream)
            closing.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    @property
    def is_live(self) -> bool:
        """Whether a program still writes to the recording; False if there are no file locks."""
        return is_live(self._path)

    def read_run(self) -> Run | None:
        """Return the run so far; None if nothing is new since the last call, or there is no pose.

        Raises:
            LogError: If the file is not a recording by turtlelog.
        """
        with name_file(self._path, expected="a turtlelog recording"):
            has_grown = False
            for section, place in walk_growing(self._stream, self._place):
                self._place = place
                has_grown |= section is not None and self._take(section)
            return self._build() if has_grown and topics.POSE.name in self._parts else None

    def read_last_run(self) -> Run:
        """Return the run so far, even if it is incomplete.

        Raises:
            LogError: If the file is not a recording by turtlelog, or contains no pose.
        """
        self.read_run()
        with name_file(self._path, expected="a turtlelog recording"):
            return self._build()

    def _build(self) -> Run:
        # `build_contents` empties its parts, which are needed again here.
        parts = {topic: [dict(rows) for rows in found] for topic, found in self._parts.items()}
        contents = build_contents(self._records, self._catalogue, parts, ())
        return build_run(reconcile_contents(contents)[0])

    def _take(self, section: Section) -> bool:
        """Add a section, and return whether it contains new data for a run."""
        if section.opcode == Opcode.DATA_END:
            self.is_finished = True
            return False
        block = build_walked_block(self._catalogue, section)
        self._records += block.rest
        piece = read_piece(self._catalogue, _EVERYTHING, block, block.offsets)
        for topic, rows in piece.rows.items():
            self._parts.setdefault(topic, []).append(rows)
        return True
