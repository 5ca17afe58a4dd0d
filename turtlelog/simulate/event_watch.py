"""What changed since the last tick, as events."""

from collections.abc import Iterator, Mapping

from turtlelog.run import Event
from turtlelog.simulate.controller import Controller
from turtlelog.simulate.drives import Drive
from turtlelog.simulate.sensing import Sensor
from turtlelog.simulate.transport import CommandQueue, LossCount, TimedCommands


class EventWatch:
    """Turns what changed since the last tick into events."""

    def __init__(self, drive: Drive, controller: Controller, commands: CommandQueue) -> None:
        self._body, self._controller, self._commands = drive.body, controller, commands
        self._was_at_wall = False
        self._lost_poses = self._lost_commands = 0

    def find_events(
        self, time_ns: int, stop_reason: str | None, *, answered: bool
    ) -> tuple[Event, ...]:
        """Return the events of a tick, whose samples are `answered`."""
        at_wall = self._body.hit_wall
        # What a blocked controller misses becomes one event, told when it is back.
        lost_poses = (self._controller.dropped - self._lost_poses) if answered else 0
        lost_commands = self._commands.dropped - self._lost_commands
        hit_wall = at_wall and not self._was_at_wall
        self._was_at_wall = at_wall
        if not (hit_wall or lost_poses or lost_commands or stop_reason):
            return ()
        self._lost_poses += lost_poses
        self._lost_commands += lost_commands
        x_m, y_m, *_ = self._body.state
        found = {
            "wall_hit": hit_wall and describe_wall(x_m, y_m),
            "poses_dropped": lost_poses and f"The controller's queue dropped {lost_poses} poses.",
            "commands_dropped": lost_commands
            and f"The plant's queue dropped {lost_commands} commands.",
            "stop": stop_reason and self._describe_stop(stop_reason),
        }
        return tuple(
            Event(time_ns=time_ns, kind=kind, text=text) for kind, text in found.items() if text
        )

    def _describe_stop(self, stop_reason: str) -> str:
        failure = self._controller.failure
        return describe_stop(stop_reason, "" if failure is None else f": {failure}")


class StretchWatch(EventWatch):
    """Tells what is lost tick after tick once a stretch of it is over, or the run."""

    def __init__(
        self,
        drive: Drive,
        controller: Controller,
        commands: CommandQueue,
        counts: Mapping[str, LossCount],
    ) -> None:
        super().__init__(drive, controller, commands)
        self._counts = counts

    def find_events(
        self, time_ns: int, stop_reason: str | None, *, answered: bool
    ) -> tuple[Event, ...]:
        """Return the events of a tick, whose samples are `answered`."""
        if "commands_dropped" in self._counts:
            self._lost_commands = self._commands.dropped
        stretches = tuple(self._list_stretches(time_ns, is_over=stop_reason is not None))
        return stretches + super().find_events(time_ns, stop_reason, answered=answered)

    def _list_stretches(self, time_ns: int, *, is_over: bool) -> Iterator[Event]:
        for kind, count in self._counts.items():
            if is_over:
                count.end_stretch()
            finished = count.take_finished()
            if finished is None:
                continue
            since_ns, lost = finished
            yield Event(time_ns=time_ns, kind=kind, text=describe_loss(kind, since_ns, lost))


def describe_wall(x_m: float, y_m: float) -> str:
    """Return where the turtle hit the wall."""
    return f"The turtle hit the wall at x = {x_m:.3f} m, y = {y_m:.3f} m."


def describe_stop(stop_reason: str, because: str = "") -> str:
    """Return why the run ended."""
    return f"The run ended: {stop_reason.replace('_', ' ')}{because}."


def describe_loss(kind: str, since_ns: int, lost: int) -> str:
    """Return what a stretch of losses was."""
    who, what = _WORDS[kind]
    when = f"{what}s from" if lost > 1 else f"{what} at"
    return f"{who} {lost} {when} {since_ns / 1e9:.3f} s{' on' if lost > 1 else ''}."


_WORDS = {
    "poses_lost": ("Sensing lost", "pose"),
    "commands_lost": ("The transport lost", "command"),
    "commands_dropped": ("The plant's queue dropped", "command"),
}
"""Who lost what."""


def build_watch(
    drive: Drive, controller: Controller, commands: CommandQueue, sensor: Sensor | None
) -> EventWatch:
    """Return what finds the events of a loop."""
    counts: dict[str, LossCount] = {}
    if sensor is not None:
        counts["poses_lost"] = sensor.lost
    if isinstance(commands, TimedCommands):
        counts |= {"commands_lost": commands.lost, "commands_dropped": commands.pushed_out}
    if not counts:
        return EventWatch(drive, controller, commands)
    return StretchWatch(drive, controller, commands, counts)
