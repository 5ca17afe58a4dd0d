from dataclasses import replace

import pytest

from turtlelog.scenario import LoopSettings, Scenario
from turtlelog.simulate import PlainLoop, SampleRow, loop


class Queue:
    """The plant's queue of a loop without a controller: commands are put and taken by hand."""

    def __init__(self, *, depth: int = 7, newest_only: bool = False, delay_ticks: int = 0) -> None:
        settings = LoopSettings(
            command_queue=depth,
            queue_policy="newest" if newest_only else "one-per-tick",
            transport_delay_ticks=delay_ticks,
        )
        self._loop = PlainLoop(replace(Scenario(), loop=settings))
        self._names: list[int] = []

    def put(self, tick: int, name: int) -> None:
        made, number = self._loop, len(self._names)
        self._names.append(name)
        made.rows.samples[number] = SampleRow(sequence=number)
        loop.send_command(made.settings, made.state, made.rows, made.parts, tick, number)

    def take(self, tick: int) -> int | None:
        found = loop.take_command(self._loop.settings, self._loop.now, self._loop.rows, tick)
        return None if found < 0 else self._names[found]

    @property
    def dropped(self) -> int:
        return int(self._loop.now.commands_dropped)


def make_queue(*, depth: int = 7, newest_only: bool = False, delay_ticks: int = 0) -> Queue:
    return Queue(depth=depth, newest_only=newest_only, delay_ticks=delay_ticks)


def put_commands(queue: Queue, tick: int, *names: int) -> None:
    for name in names:
        queue.put(tick, name)


def take_commands(queue: Queue, ticks: range) -> list[int | None]:
    return [queue.take(tick) for tick in ticks]


def test_empty_queue_has_no_command() -> None:
    assert make_queue().take(0) is None


def test_commands_are_taken_one_per_tick_in_order() -> None:
    queue = make_queue()
    put_commands(queue, 0, 1, 2, 3)
    assert take_commands(queue, range(1, 6)) == [1, 2, 3, None, None]
    assert queue.dropped == 0


def test_full_queue_drops_the_oldest() -> None:
    queue = make_queue(depth=7)
    put_commands(queue, 0, *range(11))
    assert take_commands(queue, range(1, 9)) == [4, 5, 6, 7, 8, 9, 10, None]
    assert queue.dropped == 4


def test_newest_command_wins_and_empties_the_queue() -> None:
    queue = make_queue(newest_only=True)
    put_commands(queue, 0, 1, 2, 3)
    assert take_commands(queue, range(1, 3)) == [3, None]


def test_backlog_never_drains_while_one_command_comes_per_tick() -> None:
    queue = make_queue()
    put_commands(queue, 0, 0, 1, 2, 3, 4)
    delays = []
    for tick in range(1, 50):
        command = queue.take(tick)
        delays.append(tick + 4 - (command or 0))
        put_commands(queue, tick, tick + 4)
    assert set(delays) == {5}


@pytest.mark.parametrize("delay_ticks", [0, 1, 5])
def test_command_arrives_after_its_transport(delay_ticks: int) -> None:
    queue = make_queue(delay_ticks=delay_ticks)
    put_commands(queue, 10, 1)
    taken = take_commands(queue, range(11, 20))
    assert taken.index(1) == delay_ticks


def test_commands_in_transport_keep_their_order() -> None:
    queue = make_queue(delay_ticks=3)
    for tick in range(5):
        put_commands(queue, tick, tick)
    assert take_commands(queue, range(1, 9)) == [None, None, None, 0, 1, 2, 3, 4]


def test_commands_in_transport_take_no_place_in_the_queue() -> None:
    queue = make_queue(depth=1, delay_ticks=5)
    for tick in range(5):
        put_commands(queue, tick, tick)
    assert take_commands(queue, range(6, 11)) == [0, 1, 2, 3, 4]
    assert queue.dropped == 0


def test_burst_overflows_the_queue_after_its_transport() -> None:
    queue = make_queue(depth=2, delay_ticks=1)
    put_commands(queue, 0, 1, 2, 3)
    assert take_commands(queue, range(1, 5)) == [None, 2, 3, None]
    assert queue.dropped == 1
