"""The loop in ordinary Python, tick by tick, for a law in any Python, without a compiler."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from math import inf
from operator import attrgetter, le
from types import SimpleNamespace
from typing import Any, Final

import msgspec

from turtlelog import laws
from turtlelog.errors import SimulationError
from turtlelog.parts import LARGEST_FLOAT, Plant
from turtlelog.plants import PLANTS
from turtlelog.run import Event
from turtlelog.run.loops import Declaration
from turtlelog.run.stop_reasons import LAW_FAILED, STEP_BUDGET, name_stop, number_stop
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate import class_law, loop, loop_parts, step_budget
from turtlelog.simulate.rows import EventRow, SampleRow, TickRow, describe_event, find_maker

_FORGET_EVERY: Final = 64
"""Ticks between two deletions of rows that are no longer needed. Few rows stay in the processor's
cache, and deleting them more often takes longer."""

Samples = tuple[SampleRow, ...]


class Tick(msgspec.Struct, frozen=True, gc=False):
    """Results of one plant step.

    Attributes:
        time_ns: Simulated time [ns].
        row: Pose as published and as sensed.
        computed: Samples whose pose was answered in this tick, in order.
        published: Samples whose command went out in this tick, in order.
        states: States of the law for each computed sample.
        events: Other events of the tick.
        stop_reason: Stop reason if this is the last tick; otherwise None.
    """

    time_ns: int
    row: TickRow
    computed: Samples
    published: Samples
    states: tuple[tuple[float, ...], ...]
    events: tuple[Event, ...]
    stop_reason: str | None


def iterate_ticks(
    scenario: Scenario,
    plant: Plant | None = None,
    *,
    step_budget_s: float | None = step_budget.STEP_BUDGET_S,
    one_by_one: bool = False,
    made: list["PlainLoop"] | None = None,
) -> Iterator[Tick]:
    """Return the ticks of a closed loop until the law is done or `max_duration_s` has passed.

    A tick is a step of the plant, one period long; counts of ticks in the scenario refer to these
    ticks.

    Args:
        scenario: Scenario to simulate.
        plant: Plant whose clock is used. Default: the scenario's plant.
        step_budget_s: Time for computing one answer of the law, by the computer's clock [s]; None:
            unlimited. From 1 s on, the steps of built-in laws are not watched, and the loop of
            another law computes in its own thread.
        one_by_one: Whether to compute a tick when it is requested instead of some ticks ahead.
        made: List to which the loop is appended at its start.

    Raises:
        ScenarioError: If the law cannot be loaded or may not run.
        SimulationError: If the budget is not a time. While iterating, if the law fails or gives an
            invalid answer: the error is raised after the tick in which this happens. The stop
            reason of that tick is `law_failed`, or `step_budget` if the law exceeded its time.
    """
    scenario = resolve_scenario(scenario)
    if step_budget_s is not None:
        step_budget.require_budget(step_budget_s)
    made = [] if made is None else made
    ticks, kind = _iterate(scenario, plant, step_budget_s, made), scenario.law.kind
    is_ours = class_law.is_built_in(laws.find_law(kind))
    if step_budget_s is None or not step_budget.needs_watch(step_budget_s, is_built_in=is_ours):
        return ticks
    watched = step_budget.LimitedLoop(ticks, made, step_budget_s, law=kind, one_by_one=one_by_one)
    return watched.iterate()


def _iterate(
    scenario: Scenario, plant: Plant | None, step_budget_s: float | None, made: list["PlainLoop"]
) -> Iterator[Tick]:
    """Yield the ticks; `made` receives the loop at its start."""
    made.append(PlainLoop(scenario, plant, step_budget_s=step_budget_s))
    yield from made[0].iterate()


class PlainLoop:
    """The loop of a scenario in ordinary Python.

    Attributes:
        declaration: Declaration of the law.
        now: State of the loop, a `Progress`.
    """

    def __init__(
        self,
        scenario: Scenario,
        plant: Plant | None = None,
        *,
        law: laws.Law | None = None,
        step_budget_s: float | None = None,
    ) -> None:
        """Start the loop.

        Args:
            scenario: Scenario with a resolved law.
            plant: Plant whose clock is used. Default: the scenario's plant.
            law: Law to use instead of the scenario's law. If this law has an attribute
                `parameters`, its declaration uses them; otherwise the parameters of the scenario.
            step_budget_s: Time limit of a step; a step beyond it fails with a StepBudgetError. A
                short budget is measured here, a longer one by a `LimitedLoop`.
        """
        self._kind = scenario.law.kind if law is None else laws.name_law(type(law))
        parameters = getattr(law, "parameters", scenario.law.parameters)
        self._law: laws.AnyLaw = laws.find_law(self._kind) if law is None else type(law)
        self._budget_s = inf if step_budget_s is None else step_budget_s
        goal = class_law.build_goal(scenario)
        self.declaration = laws.declare_law(self._law, parameters, goal, scenario.path)
        plant = scenario.plant.facts if plant is None else plant
        _, self.settings, self.state = loop_parts.build_settings(
            scenario, self._law, self.declaration, plant
        )
        self.now = self.state.now
        self._class_law: class_law.ClassLaw | None = None
        part = PLANTS[scenario.plant.kind]
        decide, record = self._bind_law(scenario, law, goal)
        parts = loop_parts.bind_parts(part, decide, record, loop_parts.list_acting(scenario))
        self.parts = SimpleNamespace(**parts._asdict())  # reading it takes half the time of a tuple
        self.rows: Any = _build_rows(scenario, self._law, self.declaration)
        self._read_states: Callable[[Any], tuple[float, ...]] | None = None
        if names := self.declaration.states:
            read: Any = attrgetter(*names)  # returns no tuple for one name
            of_part = read if len(names) > 1 else lambda row: (read(row),)
            self._read_states = of_part if isinstance(self._law, laws.LawPart) else tuple

    def _bind_law(
        self, scenario: Scenario, law: laws.Law | None, goal: laws.Goal
    ) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Return the functions that ask the law and record its states."""
        is_timed = self._budget_s < step_budget.TIMED_BELOW_S
        if isinstance(self._law, laws.LawPart):
            decide = loop_parts.bind_step(self._law.step)
            record = loop_parts.bind_states(self.declaration.states)
            return (step_budget.StepBudget(decide, self._budget_s) if is_timed else decide), record
        law = class_law.build_law(scenario.law) if law is None else law
        self._class_law = found = class_law.ClassLaw(
            law,
            self.declaration,
            step=step_budget.StepBudget(law.step, self._budget_s) if is_timed else law.step,
            goal=goal,
            path=scenario.path,
            limits=(scenario.limits.speed_m_s, scenario.limits.turn_rate_rad_s),
        )
        return found.decide, found.record

    def iterate(self) -> Iterator[Tick]:  # noqa: C901  (each call takes 2 % of a tick)
        """Yield the ticks until the law is done or the run is over.

        Raises:
            SimulationError: If the law fails; raised after the tick in which the law fails.
        """
        settings, state, rows, parts = self.settings, self.state, self.rows, self.parts
        now, scene = self.now, settings.scene
        period_ns, delays_poses = scene.period_ns, scene.delays_poses
        move_plant, answer, finish_tick = loop.move_plant, loop.answer_poses, loop.finish_tick
        samples, ticks, states = rows.samples, rows.ticks, rows.states
        before = published = events = 0
        for tick in range(scene.last_tick + 1):
            move_plant(settings, state, rows, parts, tick)
            if now.failure != 0:
                raise describe_runaway(tick * period_ns, parts.read(state.plant))
            failure, stop = None, None
            told: tuple[Event, ...] = ()
            try:
                if now.waits_for == 0 or delays_poses:
                    answer(settings, state, rows, parts, tick)
            except KeyboardInterrupt:
                raise
            except BaseException as err:
                failure = self.describe_failure(err)
            if now.failure != 0:
                failure = self._describe_numbers()
            if failure is not None:
                is_late = isinstance(failure, step_budget.StepBudgetError)
                now.stop = number_stop(STEP_BUDGET if is_late else LAW_FAILED)
            finish_tick(settings, state, rows, parts, tick, before)
            end = now.samples
            computed = (samples[before],) if end == before + 1 else _list_rows(samples, before, end)
            is_same = published == before and now.published == end
            sent = computed if is_same else _list_rows(samples, published, now.published)
            before, published = end, now.published
            if now.events != events:
                events = now.events
                because = "" if failure is None else f": {failure}"
                found = [*rows.events.values()]
                rows.events.clear()
                told = tuple(
                    [describe_event(row, period_ns, self.stops, because=because) for row in found]
                )
                stop = name_stop(now.stop, self.stops) if now.stop != 0 else None
            own = tuple([self.take_states(one.sequence) for one in computed]) if states else ()
            yield Tick(tick * period_ns, ticks[tick], computed, sent, own, told, stop)
            if failure is not None:
                raise failure
            if stop is not None:
                return
            if tick % _FORGET_EVERY == 0:
                self._forget()

    def answer_pose(self, time_ns: int, number: int, pose: laws.Pose) -> SampleRow:
        """Return the sample for a pose from outside, such as a recorded pose; no plant moves.

        Raises:
            SimulationError: If the law fails or gives an invalid answer.
        """
        row = self.rows.ticks[number] = TickRow(pose.x_m, pose.y_m, pose.heading_rad)
        row.sensed_x_m, row.sensed_y_m = pose.x_m, pose.y_m
        row.sensed_heading_rad = pose.heading_rad
        sample = self.now.samples
        try:
            loop.answer_pose(self.settings, self.state, self.rows, self.parts, time_ns, number)
        except KeyboardInterrupt:
            raise
        except BaseException as err:
            raise self.describe_failure(err) from err
        if self.now.failure != 0:
            raise self._describe_numbers()
        del self.rows.ticks[number]
        found: SampleRow = self.rows.samples.pop(sample)
        self.rows.forgotten += 1
        return found

    def take_states(self, sample: int) -> tuple[float, ...]:
        """Return the states of a sample and delete them."""
        return () if self._read_states is None else self._read_states(self.rows.states.pop(sample))

    @property
    def asked(self) -> int:
        """Number of poses for which the law was asked."""
        asked: int = len(self.rows.samples) + self.rows.forgotten
        return asked

    @property
    def stops(self) -> Sequence[str]:
        """Stop reasons of the law, in order."""
        law = self._law if self._class_law is None else self._class_law
        return law.stops  # type: ignore[union-attr]

    def describe_late(self, what: str) -> str:
        """Return a sentence on the late answer, and how to set a longer budget."""
        number = max(self.asked - 1, 0)
        row = self.rows.samples.get(number)
        at_s = (0 if row is None else row.time_ns) / 1e9
        place = f"law {self._kind}, sample {number}"
        return f"{place} {what}, at {at_s:.3f} s; {step_budget.advise_budget(self._budget_s)}"

    def describe_failure(self, err: BaseException) -> SimulationError:
        """Return the error of a law that raised an exception."""
        if isinstance(err, step_budget.StepBudgetError | step_budget.StepEnded):
            budget_s = self._budget_s
            ended = step_budget.describe_excess(budget_s, budget_s, has_returned=False)
            what = ended if isinstance(err, step_budget.StepEnded) else str(err)
            return step_budget.StepBudgetError(self.describe_late(what))
        reason = laws.describe_law_error(err, self._law)
        failure = SimulationError(f"law {self._kind}, sample {self.now.samples}: {reason}")
        failure.__cause__ = err
        return failure

    def _describe_numbers(self) -> SimulationError:
        """Return the error of an answer that cannot be executed or recorded."""
        now, rows = self.now, self.rows
        states = {}
        if self._read_states is not None and now.samples in rows.states:
            values = self._read_states(rows.states[now.samples])
            states = dict(zip(self.declaration.states, values, strict=True))
        reason = class_law.describe_numbers(now.failure, rows.samples[now.samples], states)
        return SimulationError(f"law {self._kind}, sample {now.samples}: {reason}")

    def _forget(self) -> None:
        now, rows = self.now, self.rows
        arrived = now.poses_arrived if self.settings.scene.delays_poses else now.ticks
        if now.poses_count == 0:
            now.poses_first = arrived  # earlier poses no longer wait
        newest = now.newest if now.newest >= 0 else now.ticks
        _drop(rows.ticks, min(now.poses_first, arrived, newest))
        sample = min(now.queue_first, now.commands_arrived, now.published)
        rows.forgotten += _drop(rows.samples, sample)
        first = getattr(self.state.plant, "waiting_first", 0)
        _drop(rows.waiting, first)


def _list_rows(rows: dict[int, Any], first: int, end: int) -> Samples:
    if first + 1 == end:
        return (rows[first],)
    return tuple([rows[number] for number in range(first, end)]) if first != end else ()


@dataclass(slots=True)
class _Rows:
    """The rows of a loop that are still needed, by number, like `compiled_loop.Rows`."""

    table: Any
    pieces: Any
    drawn_ticks: loop_parts.DrawnEvents
    drawn_samples: loop_parts.DrawnEvents
    new: tuple[SimpleNamespace]  # what makes a row of each kind
    ticks: dict[int, TickRow] = field(default_factory=dict)
    samples: dict[int, SampleRow] = field(default_factory=dict)
    states: dict[int, Any] = field(default_factory=dict)
    events: dict[int, EventRow] = field(default_factory=dict)
    waiting: dict[int, Any] = field(default_factory=dict)
    forgotten: int = 0


def _drop(rows: dict[int, Any], before: int) -> int:
    """Delete the rows before a number, and return how many. Numbers of rows rise."""
    kept = list(takewhile(partial(le, before), reversed(rows)))
    count = len(rows) - len(kept)
    if count > 0:
        last = [(number, rows[number]) for number in reversed(kept)]
        rows.clear()
        rows.update(last)
    return count


def _build_rows(scenario: Scenario, law: laws.AnyLaw, declaration: Declaration) -> Any:
    used, is_part = loop_parts.list_streams(scenario), isinstance(law, laws.LawPart)
    table = law.build_table if isinstance(law, laws.LawPart) else None
    makers = SimpleNamespace(
        tick=find_maker(TickRow),
        sample=find_maker(SampleRow),
        event=EventRow,
        waiting=PLANTS[scenario.plant.kind].Waiting,
        states=loop_parts.find_states(declaration.states) if is_part else None,
    )
    return _Rows(
        table=() if table is None else table(scenario.law.parameters),
        pieces=() if scenario.path is None else scenario.path.ways,
        drawn_ticks=loop_parts.DrawnEvents(scenario.seed, used, ticks=True),
        drawn_samples=loop_parts.DrawnEvents(scenario.seed, used, ticks=False),
        new=(makers,),
    )


def describe_runaway(time_ns: int, state: tuple[float, ...]) -> SimulationError:
    """Return a sentence on a plant that is further or faster than a pose can contain."""
    return SimulationError(
        f"the robot runs away: at {time_ns / 1e9:g} s x = {state[0]:g} m,"
        f" y = {state[1]:g} m, speed {state[3]:g} m/s, turn rate {state[4]:g} rad/s;"
        f" a pose holds numbers below {LARGEST_FLOAT:g}"
    )
