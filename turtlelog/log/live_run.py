"""Drives a simulation live: its ticks go into sinks as they come, at wall clock where asked."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Final, Protocol

import msgspec

from turtlelog.errors import SimulationError
from turtlelog.log.interrupts import StopRequest, catch_stop
from turtlelog.log.recording.recorder import INTERRUPTED
from turtlelog.run import Event, Run
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate import Tick, collect_run, iterate_ticks
from turtlelog.simulate.step_budget import STEP_BUDGET_S


class Sink(Protocol):
    """Takes ticks while they happen: a recorder, a viewer."""

    def receive(self, tick: Tick) -> None:
        """Take one tick; the last one carries the stop reason."""
        ...

    def close(self, notes: Mapping[str, str]) -> None:
        """Come to an end, also where the run failed; `notes` are those of its `Run`."""
        ...


class Pacer(Protocol):
    """What paces a run."""

    def now(self) -> float:
        """Return the time since some moment [s], never going back."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Wait [s]; it may take longer."""
        ...


class WallClock:
    """The computer's own clock."""

    now = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)


WALL_CLOCK: Final = WallClock()


class Pace:
    """Holds every tick back until its time by the clock has come, counted from the first.

    A loop that falls behind goes on without a wait until it has caught up, so that the end of a run
    does not drift. Ticks that come more than one period late are counted: they are what an observer
    would have seen at the wrong time, and what the recording cannot show.

    Attributes:
        late_ticks: Number of ticks that came late.
        greatest_lag_s: By how much the latest [s].
    """

    def __init__(self, clock: Pacer, period_s: float) -> None:
        """Count a tick that is more than a period of the plant [s] late as late."""
        self._period_s = period_s
        self.late_ticks, self.greatest_lag_s = 0, 0.0
        self._clock, self._start_s = clock, 0.0

    def wait(self, tick: Tick) -> None:
        """Return when the tick's time has come."""
        now_s = self._clock.now()
        if not tick.time_ns:
            self._start_s = now_s
        deadline_s = self._start_s + tick.time_ns / 1e9
        if now_s < deadline_s:
            self._clock.sleep(deadline_s - now_s)
        elif now_s - deadline_s > self._period_s:
            self.late_ticks += 1
            self.greatest_lag_s = max(self.greatest_lag_s, now_s - deadline_s)

    def describe(self) -> dict[str, str]:
        """Return the notes for a run; none where every tick came in time."""
        if not self.late_ticks:
            return {}
        return {"late_ticks": f"{self.late_ticks}, by up to {self.greatest_lag_s:.3f} s"}


def run_live(
    scenario: Scenario,
    sinks: Sequence[Sink] = (),
    *,
    realtime: bool,
    clock: Pacer = WALL_CLOCK,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> Run:
    """Simulate a scenario, hand every tick to the sinks as it comes, and return the run.

    Ctrl-C, SIGTERM, SIGHUP and SIGQUIT end the run with the stop reason `interrupted` at the next
    tick, a second one at once. The sinks are closed whatever happens.

    Args:
        scenario: Scenario to simulate.
        sinks: Who sees the ticks, in this order.
        realtime: Whether ticks wait for their time by the clock.
        clock: The clock that they wait for.
        step_budget_s: Longest time for one answer of the law, by the computer's clock [s]; None: no
            limit.

    Raises:
        ScenarioError: If the law cannot be loaded or may not run.
        SimulationError: If the law fails, with the run so far as `run`. The sinks have seen the
            tick in which it did, whose stop reason is `law_failed`, or `step_budget` where it
            computed for too long, and are closed.
        KeyboardInterrupt: If it was interrupted before the first sample.
        LogError: If a recorder can take no more.
    """
    scenario = resolve_scenario(scenario)
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
            raise KeyboardInterrupt  # without a sample there is no run to return
        yield last
        if is_over:
            return


def _end(tick: Tick) -> Tick:
    event = Event(time_ns=tick.time_ns, kind="stop", text=f"The run ended: {INTERRUPTED}.")
    return msgspec.structs.replace(tick, stop_reason=INTERRUPTED, events=(*tick.events, event))
