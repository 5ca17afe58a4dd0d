"""A plant driven by given commands in the loop's own steps, without a law."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from turtlelog.parts import NEVER_NS
from turtlelog.plants.kinds import PLANTS
from turtlelog.run import CommandColumns
from turtlelog.scenario import LawChoice, Scenario
from turtlelog.simulate import loop
from turtlelog.simulate.plain_loop import PlainLoop, describe_runaway
from turtlelog.simulate.rows import SampleRow, TickRow
from turtlelog.simulate.streams import DrawnEvents, list_streams

State = tuple[float, float, float, float, float]
"""State: x, y [m], heading [rad], magnitude of the velocity [m/s], turn rate [rad/s]."""


class DrivenPlant:
    """The plant of a scenario with its transport, disturbances and sensing.

    Attributes:
        taken: Number of commands that the plant took so far; a duplicated command counts once.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Start at the scenario's start, on the clock of its plant."""
        made = PlainLoop(replace(scenario, law=LawChoice()))
        self._settings, self._state, self._rows = made.settings, made.state, made.rows
        self._parts, self._now, self.taken = made.parts, made.now, 0
        # Separate numbers, because poses may be sensed after all ticks, with numbers of their own.
        drawn = DrawnEvents(scenario.seed, list_streams(scenario), ticks=True)
        self._sensed_rows = replace(made.rows, drawn_ticks=drawn)
        self._last = -1
        self._acts_in_steps = PLANTS[scenario.plant.kind].acts_in_steps

    def put(self, tick: int, time_ns: int, speed: float, turn_rate: float) -> None:
        """Publish a command in a tick, at a time [ns], with speed [m/s] and turn rate [rad/s]."""
        number = self._now.samples
        row = self._rows.samples[number] = SampleRow()
        row.sequence, row.published_ns = number, time_ns
        row.speed_m_s, row.turn_rate_rad_s = speed, turn_rate
        self._now.samples += 1
        loop.publish(self._settings, self._state, self._rows, self._parts, tick, number)

    def visit(self, tick: int, times_ns: Sequence[int] = ()) -> Iterator[State]:
        """Yield the states at times since the previous tick; advance to the time of the tick [ns].

        Raises:
            SimulationError: If the plant diverges.
        """
        scene, until_ns = self._settings.scene, tick * self._settings.scene.period_ns
        since_ns = until_ns - scene.period_ns
        self._hold(tick, since_ns, until_ns)
        times, at_ns = list(times_ns), since_ns
        is_pushed = scene.is_pushed and (tick > 0 or self._acts_in_steps)
        if is_pushed and self._acts_in_steps:
            at_ns = until_ns
        while is_pushed and at_ns <= until_ns:
            self._push(tick, at_ns)
            before_ns, at_ns = at_ns, self._find_next_push(tick, at_ns)
            while times and times[0] < min(at_ns, until_ns) and times[0] >= before_ns:
                yield self._move_to(times.pop(0))
            if self._acts_in_steps or at_ns >= until_ns:
                break
        for time_ns in times:
            yield self._move_to(time_ns)
        self._move_to(until_ns)

    def read(self) -> State:
        """Return the present state of the plant."""
        state: State = self._parts.read(self._state.plant)
        return state

    def sense(self, number: int, pose: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the sensed pose for a pose, by its number."""
        row = TickRow(*pose)
        loop.sense(self._settings, self._state, self._sensed_rows, self._parts, row, number)
        return row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad

    def _hold(self, tick: int, since_ns: int, until_ns: int) -> None:
        """Pass arriving commands on to the plant."""
        settings, state, rows, parts = self._settings, self._state, self._rows, self._parts
        scene, now = settings.scene, self._now
        if scene.acts_on_arrival:
            first = now.commands_arrived
            loop.hold_arrived(settings, state, rows, parts, until_ns)
            numbers = range(first, now.commands_arrived)
            self.taken += sum(rows.samples[number].arrivals > 0 for number in numbers)
            return
        until = until_ns + scene.causal_ns if scene.is_timed else tick
        sample = loop.take(settings, now, rows, until)
        if sample >= 0:
            row = rows.samples[sample]
            parts.hold(settings, state.plant, rows, since_ns, row.speed_m_s, row.turn_rate_rad_s)
            # Commands keep their order, so duplicates are consecutive.
            self.taken += sample != self._last
            self._last = sample

    def _push(self, tick: int, at_ns: int) -> None:
        loop.push_at(self._settings, self._state, self._rows, self._parts, tick, at_ns)

    def _find_next_push(self, tick: int, at_ns: int) -> int:
        never = NEVER_NS
        found: int = self._parts.next_push(
            self._settings, self._state, self._rows, tick, at_ns, never
        )
        return found

    def _move_to(self, time_ns: int) -> State:
        if not self._parts.move(self._settings, self._state.plant, self._rows, time_ns):
            raise describe_runaway(time_ns, self.read())
        return self.read()


def list_plant_commands(commands: CommandColumns) -> list[tuple[int, float, float]]:
    """Return time [ns], speed [m/s] and turn rate [rad/s] of commands."""
    columns = (commands.time_ns, commands.speed_m_s, commands.turn_rate_rad_s)
    return [*zip(*(column.tolist() for column in columns), strict=True)]
