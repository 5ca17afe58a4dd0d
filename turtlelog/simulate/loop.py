"""The closed loop, tick by tick, for any plant, law and effects: the source of both versions.

At equal times the plant moves first, then commands arrive, then the pose is delivered, then the
controller runs. A tick lasts until the next tick.

`parts` contains the functions of plant and law, and the chained effects of each place; `loop_parts`
creates `parts`. `rows` contains the rows of each kind by number: in Python the rows that are still
needed, in compiled code all rows.
"""

import math
from typing import Any, Final

from turtlelog.arithmetic import (
    begin_row,
    called,
    hypot,
    message_to_float32,
    pose_to_float32,
    wrap_angle,
)
from turtlelog.parts import LARGEST_FLOAT, NEVER_NS
from turtlelog.run.stop_reasons import MAX_DURATION, number_stop
from turtlelog.simulate.rows import (
    COMMAND_FAILED,
    COMMANDS_DROPPED,
    NUMBERS_FAILED,
    POSES_DROPPED,
    REFERENCE_FAILED,
    RUNS_AWAY,
    STATES_FAILED,
    STOP,
    WALL_HIT,
    add_event,
    add_losses,
    count_loss,
    end_loss_segment,
)

_TIME_IS_UP: Final = number_stop(MAX_DURATION)


def move_plant(settings: Any, state: Any, rows: Any, parts: Any, tick: int) -> None:
    """Move the plant to a tick, publish its pose, and deliver the sensed pose."""
    now, scene = state.now, settings.scene
    drive_plant(settings, state, rows, parts, tick)
    if now.failure != 0:
        return
    x_m, y_m, heading_rad, speed, turn_rate = parts.read(state.plant)
    row = begin_row(rows.ticks, rows.new[0].tick, tick)
    row.x_m, row.y_m, row.heading_rad, row.speed_m_s, row.turn_rate_rad_s = message_to_float32(
        x_m, y_m, heading_rad, speed, turn_rate
    )
    if scene.is_exact:
        row.x_m, row.y_m, row.heading_rad = x_m, y_m, heading_rad
    now.ticks += 1
    if scene.senses and not sense_pose(settings, state, rows, parts, row, tick):
        return
    if scene.delays_poses:
        send_pose(settings, state, rows, parts, row, tick)
    else:
        row.arrival_ns = 0
        queue_pose(settings, now, rows, row, tick)


def finish_tick(settings: Any, state: Any, rows: Any, parts: Any, tick: int, before: int) -> None:
    """Record the changes in a tick; before the tick there were `before` samples."""
    now = state.now
    if now.stop == 0 and tick == settings.scene.last_tick:
        now.stop = _TIME_IS_UP
    if now.has_losses:
        add_losses(now, now.lost_poses, rows, tick)
        add_losses(now, now.lost_commands, rows, tick)
        add_losses(now, now.dropped_commands, rows, tick)
    if state.plant.hit_wall != now.was_at_wall:
        now.was_at_wall = state.plant.hit_wall
        if now.was_at_wall:
            x_m, y_m = parts.read(state.plant)[:2]
            add_event(now, rows, tick, WALL_HIT, x_m, y_m)
    # Poses that a blocked controller misses become one event after the block.
    if now.samples > before and now.poses_dropped > now.poses_reported:
        dropped = float(now.poses_dropped - now.poses_reported)
        add_event(now, rows, tick, POSES_DROPPED, 0.0, dropped)
        now.poses_reported = now.poses_dropped
    if now.commands_dropped > now.commands_reported:
        if not settings.scene.is_timed:
            dropped = float(now.commands_dropped - now.commands_reported)
            add_event(now, rows, tick, COMMANDS_DROPPED, -1.0, dropped)
        now.commands_reported = now.commands_dropped
    if now.stop != 0:
        add_event(now, rows, tick, STOP, 0.0, float(now.stop))


# The plant and its inputs.


def drive_plant(settings: Any, state: Any, rows: Any, parts: Any, tick: int) -> None:
    """Move the plant to the time of a tick, with the arriving commands and disturbances."""
    now, scene = state.now, settings.scene
    time_ns = tick * scene.period_ns
    since_ns = time_ns - scene.period_ns
    if scene.acts_on_arrival:
        hold_arrived_commands(settings, state, rows, parts, time_ns)
    else:
        until = time_ns + scene.causal_ns if scene.is_timed else tick
        sample = take_command(settings, now, rows, until)
        if sample >= 0:
            row = rows.samples[sample]
            parts.hold(settings, state.plant, rows, since_ns, row.speed_m_s, row.turn_rate_rad_s)
    if scene.is_pushed:
        disturb(settings, state, rows, parts, tick, since_ns)
    if not parts.move(settings, state.plant, rows, time_ns):
        now.failure = RUNS_AWAY


@called
def disturb(settings: Any, state: Any, rows: Any, parts: Any, tick: int, since_ns: int) -> None:
    """Disturb the plant in the step to a tick, from the start of each disturbance on."""
    now, scene = state.now, settings.scene
    until_ns = since_ns + scene.period_ns
    at_ns = until_ns
    if scene.acts_in_steps:
        disturb_at(settings, state, rows, parts, tick, at_ns)
    elif tick > 0:
        at_ns = since_ns
    while at_ns < until_ns and now.failure == 0:
        disturb_at(settings, state, rows, parts, tick, at_ns)
        at_ns = parts.next_push(settings, state, rows, tick, at_ns, NEVER_NS)


@called
def disturb_at(settings: Any, state: Any, rows: Any, parts: Any, tick: int, at_ns: int) -> None:
    """Disturb the plant from a time within the step to a tick, unless nothing changes."""
    now = state.now
    speed, turn_rate = parts.push(settings, state, rows, tick, at_ns, (0.0, 0.0))
    if speed == now.disturbance_speed and turn_rate == now.disturbance_turn_rate:
        return
    now.disturbance_speed, now.disturbance_turn_rate = speed, turn_rate
    moves = True
    if not settings.scene.acts_in_steps:
        moves = parts.move(settings, state.plant, rows, at_ns)
    if not moves:
        now.failure = RUNS_AWAY
        return
    parts.apply_push(settings, state.plant, speed, turn_rate)


# Commands: transport, then the plant's queue.


def send_command(settings: Any, state: Any, rows: Any, parts: Any, tick: int, sample: int) -> None:
    """Send the command of a sample. No command overtakes another."""
    now, scene, row = state.now, settings.scene, rows.samples[sample]
    now.published += 1
    now.stop = row.stop
    row.arrivals = 1
    if not scene.is_timed:
        delay_ticks = settings.loop.transport_delay_ticks
        row.arrival_ns = tick + delay_ticks
        if delay_ticks == 0:
            queue_command(settings, now, rows, row)
            now.commands_arrived += 1
    elif parts.lose_command(settings, state, rows, sample, 0, False):  # noqa: FBT003
        row.arrivals = 0
        count_loss(now, now.lost_commands, row.published_ns)
    else:
        if now.has_losses:
            end_loss_segment(now.lost_commands)
        arrival_ns = parts.command_travel(settings, state, rows, sample, 0, row.published_ns)
        row.arrival_ns = max(arrival_ns, now.command_arrived_ns)
        now.command_arrived_ns = row.arrival_ns
        row.arrivals = parts.repeat(settings, state, rows, sample, 0, 1)


@called
def queue_arrived_commands(settings: Any, now: Any, rows: Any, until: int) -> None:
    """Queue the commands that arrive before a time."""
    while now.commands_arrived < now.published:
        row = rows.samples[now.commands_arrived]
        if row.arrivals > 0 and row.arrival_ns >= until:
            return
        for _ in range(row.arrivals):
            queue_command(settings, now, rows, row)
        now.commands_arrived += 1


def queue_command(settings: Any, now: Any, rows: Any, row: Any) -> None:
    """Queue a command. A full queue drops the oldest command."""
    if settings.scene.newest_only:
        now.newest_command, now.queue_count = row.sequence, 1
        return
    if now.queue_count == settings.loop.command_queue:
        take_oldest_command(now, rows)
        now.commands_dropped += 1
        if settings.scene.is_timed:
            count_loss(now, now.dropped_commands, row.arrival_ns)
    row.queued += 1
    now.queue_count += 1


def take_oldest_command(now: Any, rows: Any) -> int:
    """Take the oldest command from the queue and return its sample."""
    oldest: int = now.queue_first
    row = rows.samples[oldest]
    while row.queued == 0:
        oldest += 1
        row = rows.samples[oldest]
    row.queued -= 1
    now.queue_first = oldest
    now.queue_count -= 1
    return oldest


def take_command(settings: Any, now: Any, rows: Any, until: int) -> int:
    """Return the sample whose command is used from the start of a step; -1 before the first."""
    if now.commands_arrived < now.published:
        queue_arrived_commands(settings, now, rows, until)
    if now.has_losses and now.queue_count < settings.loop.command_queue:
        end_loss_segment(now.dropped_commands)
    if now.queue_count == 0:
        return -1
    if not settings.scene.newest_only:
        return take_oldest_command(now, rows)
    now.queue_count, now.queue_first = 0, now.commands_arrived
    return now.newest_command  # type: ignore[no-any-return]


@called
def hold_arrived_commands(settings: Any, state: Any, rows: Any, parts: Any, until_ns: int) -> None:
    """Pass commands that arrive before a time to the plant, without the queue."""
    now = state.now
    while now.commands_arrived < now.published:
        row = rows.samples[now.commands_arrived]
        if row.arrivals > 0 and row.arrival_ns >= until_ns:
            return
        for _ in range(row.arrivals):
            command = row.speed_m_s, row.turn_rate_rad_s
            parts.hold(settings, state.plant, rows, row.arrival_ns, command[0], command[1])
        now.commands_arrived += 1
    now.queue_first = now.commands_arrived


# Poses: transport to the controller.


def sense_pose(settings: Any, state: Any, rows: Any, parts: Any, row: Any, tick: int) -> bool:
    """Sense the pose of a tick and return whether it arrives."""
    now, scene = state.now, settings.scene
    if parts.lose_pose(settings, state, rows, tick, 0, False):  # noqa: FBT003
        count_loss(now, now.lost_poses, tick * scene.period_ns)
        return False
    if now.has_losses:
        end_loss_segment(now.lost_poses)
    pose = parts.sense(settings, state, rows, tick, 0, (row.x_m, row.y_m, row.heading_rad))
    x_m, y_m, heading_rad = pose
    # Rounding may put turtlesim's own headings slightly beyond pi: unchanged ones are kept.
    if heading_rad != row.heading_rad:
        heading_rad = wrap_angle(heading_rad)
    if not scene.is_exact:
        x_m, y_m, heading_rad = pose_to_float32(x_m, y_m, heading_rad)
    row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad = x_m, y_m, heading_rad
    return True


@called
def send_pose(settings: Any, state: Any, rows: Any, parts: Any, row: Any, tick: int) -> None:
    """Send the pose of a tick. No pose overtakes another."""
    now, time_ns = state.now, tick * settings.scene.period_ns
    arrival_ns = parts.pose_travel(settings, state, rows, tick, 0, time_ns)
    row.arrival_ns = max(arrival_ns, now.pose_arrived_ns)
    now.pose_arrived_ns = row.arrival_ns


def queue_pose(settings: Any, now: Any, rows: Any, row: Any, tick: int) -> None:
    """Queue the pose of a tick if it is an n-th pose. A full queue drops the oldest pose."""
    loop = settings.loop
    if loop.period_ticks != 1 and tick % loop.period_ticks != 0:
        row.arrival_ns = -1
        return
    if now.poses_count == loop.pose_queue:
        take_pose(now, rows)
        now.poses_dropped += 1
    now.poses_count += 1
    if now.waits_for > 0:
        now.waits_for -= 1


def take_pose(now: Any, rows: Any) -> int:
    """Take the oldest pose from the queue and return its number."""
    oldest: int = now.poses_first
    while rows.ticks[oldest].arrival_ns < 0:
        oldest += 1
    now.poses_first, now.poses_count = oldest + 1, now.poses_count - 1
    return oldest


def find_next_arrival(now: Any, rows: Any) -> int:
    """Return the arrival time of the next pose [ns]."""
    while now.poses_arrived < now.ticks:
        arrival_ns: int = rows.ticks[now.poses_arrived].arrival_ns
        if arrival_ns >= 0:
            return arrival_ns
        now.poses_arrived += 1
    return NEVER_NS


@called
def find_next_time(now: Any, rows: Any) -> int:
    """Return the time of the next arrival, timer event or end of a block [ns]."""
    next_ns = min(find_next_arrival(now, rows), now.fires_ns)
    if now.blocked >= 0:
        next_ns = min(next_ns, now.free_at)
    return next_ns  # type: ignore[no-any-return]


@called
def deliver_poses(settings: Any, now: Any, rows: Any, now_ns: int) -> None:
    """Queue the poses that have arrived, and mark an answer as due when the timer fires."""
    scene = settings.scene
    while find_next_arrival(now, rows) <= now_ns:
        pose = now.poses_arrived
        now.poses_arrived += 1
        if scene.timer_ns == 0:
            queue_pose(settings, now, rows, rows.ticks[pose], pose)
            continue
        now.newest = pose
        if now.waits_for > 0:
            now.waits_for -= 1
            now.fires_ns = NEVER_NS if now.waits_for > 0 else now_ns
    if scene.timer_ns > 0 and now.fires_ns == now_ns:
        now.is_due = True
        now.fires_ns += scene.timer_ns


# The controller.


def answer_poses(settings: Any, state: Any, rows: Any, parts: Any, tick: int) -> None:
    """Answer the poses that wait or arrive before the next tick, and publish the commands.

    While the law blocks, poses are queued, and one timer event waits.
    """
    now, scene = state.now, settings.scene
    delays_poses = scene.delays_poses
    time_ns, place = tick * scene.period_ns, tick  # place of the loop: by time or by ticks
    goes_on = True
    while goes_on:
        if delays_poses:
            time_ns = place = find_next_time(now, rows)
            if time_ns >= min((tick + 1) * scene.period_ns, scene.end_ns):
                return
            deliver_poses(settings, now, rows, time_ns)
        if now.blocked >= 0 and place >= now.free_at:
            send_command(settings, state, rows, parts, tick, now.blocked)
            now.blocked = -1
        if now.waits_for == 0 and now.blocked < 0:
            if now.is_due:
                now.poses_count, now.is_due = 1, False
            while now.poses_count > 0 and now.stop == 0 and now.blocked < 0:
                if scene.timer_ns == 0:
                    pose = take_pose(now, rows)
                else:
                    now.poses_count, pose = 0, now.newest
                blocks = answer_pose(settings, state, rows, parts, time_ns, pose)
                if now.failure != 0:
                    return
                sample = now.samples - 1
                if blocks > 0:
                    now.blocked, now.free_at = sample, place + blocks * scene.block
                else:
                    send_command(settings, state, rows, parts, tick, sample)
        goes_on = delays_poses and now.stop == 0


def answer_pose(settings: Any, state: Any, rows: Any, parts: Any, time_ns: int, number: int) -> int:
    """Create the sample of a pose and return the number of ticks for which the law blocks."""
    now, scene = state.now, settings.scene
    read, sample = rows.ticks[number], now.samples
    row = begin_row(rows.samples, rows.new[0].sample, sample)
    row.time_ns, row.sequence, row.pose_sequence = time_ns, sample, number
    if scene.senses:
        pose = read.sensed_x_m, read.sensed_y_m, read.sensed_heading_rad
    else:
        pose = read.x_m, read.y_m, read.heading_rad
    speed, turn_rate = parts.decide(settings, state, rows, row, time_ns, pose)
    row.wanted_speed_m_s, row.wanted_turn_rate_rad_s = speed, turn_rate
    # A sum is finite if all its numbers are.
    errors = row.bearing_rad + row.heading_error_rad + row.error_x_m + row.error_y_m
    errors += row.distance_m
    total = errors + row.world_v_x_m_s + row.world_v_y_m_s
    if (
        not -LARGEST_FLOAT < speed < LARGEST_FLOAT
        or not -LARGEST_FLOAT < turn_rate < LARGEST_FLOAT
        or scene.has_reference
        or not math.isfinite(total)
    ):
        if scene.has_goal and math.isnan(errors):
            complete_errors(settings.goal, row, pose)
        check_numbers(scene, now, row, speed, turn_rate)
        if now.failure != 0:
            return 0
    if scene.has_states and not parts.record(state.law, rows, sample):
        now.failure = STATES_FAILED
        return 0
    dt_s = scene.first_s if now.last_ns < 0 else (time_ns - now.last_ns) / 1e9
    now.last_ns = time_ns
    command = (speed, turn_rate)
    if scene.shapes:
        command = parts.shape(settings, state, rows, sample, dt_s, command)
        row.shaped_speed_m_s, row.shaped_turn_rate_rad_s = command
    command = parts.limit(settings, state, rows, sample, dt_s, command)
    row.speed_m_s, row.turn_rate_rad_s = command
    blocks: int = row.blocks_ticks
    row.published_ns = time_ns + blocks * scene.tick_ns
    now.samples = sample + 1
    return blocks


@called
def complete_errors(goal: Any, row: Any, pose: tuple[float, float, float]) -> None:
    """Compute the missing errors from the present position to the goal."""
    x_m, y_m = goal.x_m - pose[0], goal.y_m - pose[1]
    bearing_rad = math.atan2(y_m, x_m)
    if math.isnan(row.bearing_rad):
        row.bearing_rad = bearing_rad
    if math.isnan(row.heading_error_rad):
        row.heading_error_rad = wrap_angle(bearing_rad - pose[2])
    if math.isnan(row.error_x_m):
        row.error_x_m = x_m
    if math.isnan(row.error_y_m):
        row.error_y_m = y_m
    if math.isnan(row.distance_m):
        row.distance_m = hypot(row.error_x_m, row.error_y_m)


def check_numbers(scene: Any, now: Any, row: Any, speed: float, turn_rate: float) -> None:
    """Reject values that cannot be executed or recorded. Without a goal there are no errors."""
    reference = row.reference_x_m + row.reference_y_m + row.reference_heading_rad
    errors = row.bearing_rad + row.heading_error_rad + row.error_x_m + row.error_y_m
    if not (abs(speed) < LARGEST_FLOAT and abs(turn_rate) < LARGEST_FLOAT):
        now.failure = COMMAND_FAILED
    elif scene.has_reference and not math.isfinite(reference):
        now.failure = REFERENCE_FAILED
    elif (
        math.isinf(row.world_v_x_m_s)
        or math.isinf(row.world_v_y_m_s)
        or (scene.has_goal and not (math.isfinite(errors) and math.isfinite(row.distance_m)))
    ):
        now.failure = NUMBERS_FAILED
