"""The closed loop of the sequential laws around turtlesim, compiled by numba.

The steps, their order and their names are those of the interpreted loop: `closed_loop`, `drives`,
`sensing`, `controller`, `law_driver`, `shaping`, `transport`, `event_watch` and the laws. Each
operation on floats is theirs, in their order, so that the numbers are theirs bit for bit. What the
interpreted loop would refuse ends the run with `has_failed`.

Queues are stretches of arrays, from a `first` to an `end` that only grow.
"""

import math
from typing import Any

import numpy as np
from numba import from_dtype, njit, typeof, types

from turtlelog.compiled_loops import sum_up_sources
from turtlelog.plants import turtlesim
from turtlelog.plants.turtlesim import _PI, _TWO_PI, WORLD_SIZE_M
from turtlelog.simulate import kernel_fields, kernel_memory, law_driver
from turtlelog.simulate.kernel_fields import SETTINGS
from turtlelog.simulate.kernel_memory import (
    COMMANDS_DROPPED,
    COMMANDS_LOST,
    MAX_DURATION,
    POSES_DROPPED,
    POSES_LOST,
    REORIENT,
    ROTATE,
    SETTLED,
    STANDSTILL,
    STATE,
    STOP,
    TIMEOUT,
    TRANSLATE,
    WALL_HIT,
    WITHIN_TOLERANCE,
    allocate,
)
from turtlelog.simulate.law_driver import LARGEST_FLOAT

_NEVER_NS = 2**63 - 1
_TURN_RAD = 2.0 * math.pi
_SPLIT = 134217729.0  # 2**27 + 1: halves the digits of a double
_TINY_M, _HUGE_M = 1e-100, 1e100  # far from where the squares of doubles lose digits
_SPEED, _TURN = 0, 1
_OF_TURTLE, _OF_LAW = 0, 1

# Without `_nrt` numba counts nobody's references to the arrays, and refuses what would allocate
# memory, as a set does: counting took two thirds of the loop's time.
_compile = njit(error_model="numpy", forceinline=True, _nrt=False)


@_compile
def _least(left: float, right: float) -> float:
    return right if right < left else left


@_compile
def _most(left: float, right: float) -> float:
    return right if right > left else left


@_compile
def _clip(value: float, limit: float) -> float:
    return _least(_most(value, -limit), limit)  # type: ignore[no-any-return]


@_compile
def _wrap_angle(angle_rad: float) -> float:
    if -math.pi <= angle_rad < math.pi:
        return angle_rad
    rest = np.fmod(angle_rad, _TURN_RAD)
    rest -= _TURN_RAD * np.floor((rest + math.pi) / _TURN_RAD)
    return -math.pi if rest >= math.pi else rest


@_compile
def _round_to_step(value: float, step: float) -> float:
    if step == 0.0:
        return value
    steps = value / step
    # Python's whole numbers know no -0.0.
    return step * (np.rint(steps) + 0.0) if math.isfinite(steps) else value


@_compile
def _find_direction(direction: Any, angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine, of the angle before as they were."""
    if angle_rad != direction.angle_rad or angle_rad == 0.0:  # there are two zeros
        direction.angle_rad = angle_rad
        direction.cosine, direction.sine = math.cos(angle_rad), math.sin(angle_rad)
    return direction.cosine, direction.sine


@_compile
def _round_to_float32(value: float) -> float:
    return np.float64(np.float32(value))


@_compile
def _square(value: float) -> tuple[float, float]:
    """Return a square as a sum of two doubles, exactly (Dekker's product)."""
    product = value * value
    large = _SPLIT * value
    high = large - (large - value)
    low = value - high
    return product, ((high * high - product) + 2.0 * high * low) + low * low


@_compile
def find_hypot(x: float, y: float) -> float:
    """Return the nearest double to the hypotenuse, as CPython does; the libm's is not always it.

    One step of Newton from the root of the rounded squares, with what is left of them exactly.
    """
    large, small = abs(x), abs(y)
    if large < small:
        large, small = small, large
    if small == 0.0 or not math.isfinite(large):
        return large
    # By a power of two, which changes no digit: no square overflows or loses digits.
    scale = 1.0
    if not _TINY_M < large < _HUGE_M:
        scale = math.ldexp(1.0, -max(math.frexp(large)[1], -1000))
    large, small = large * scale, small * scale
    square, rest = _square(large)
    other, other_rest = _square(small)
    root = math.sqrt(square + other)
    root_square, root_rest = _square(root)
    total = square + other
    lost = other - (total - square)
    left = (total - root_square) + (lost + (rest + other_rest - root_rest))
    return (root + left / (2.0 * root)) / scale  # type: ignore[no-any-return]


@_compile
def _count_lost(loss: Any, time_ns: int) -> None:
    if loss.count == 0:
        loss.since_ns = time_ns
    loss.count += 1


@_compile
def _end_stretch(loss: Any) -> None:
    if loss.count == 0:
        return
    if loss.finished == 0:
        loss.finished_since_ns = loss.since_ns
    loss.finished += loss.count
    loss.count = 0


# Commands on their way: transport, then the plant's queue.


@_compile
def _put(settings: Any, state: Any, memory: Any, tick: int, sample: int) -> None:
    """Publish a sample's command."""
    published_ns = memory.samples[sample].published_ns
    memory.samples[state.commands].published = sample
    state.commands += 1
    arrival = tick + settings.loop_transport_delay_ticks
    repeats = False
    if settings.is_timed:
        if settings.loop_loss_probability and (
            memory.samples[sample].loss < settings.loop_loss_probability
        ):
            _count_lost(memory.losses[COMMANDS_LOST], published_ns)
            return
        _end_stretch(memory.losses[COMMANDS_LOST])
        arrival = published_ns + settings.transport_ns
        if settings.transport_jitter_ns:
            arrival += int(
                np.rint(settings.transport_jitter_ns * memory.samples[sample].transport_jitter)
            )
        if settings.loop_late_probability and (
            memory.samples[sample].late < settings.loop_late_probability
        ):
            arrival += settings.late_ns
        state.command_arrived_ns = arrival = max(arrival, state.command_arrived_ns)
        repeats = bool(settings.loop_repeat_probability) and (
            memory.samples[sample].repeat < settings.loop_repeat_probability
        )
    elif settings.loop_transport_delay_ticks == 0:
        _append(settings, state, memory, sample)
        return
    for _ in range(2 if repeats else 1):
        memory.queued[state.transport_end].transport = sample
        memory.queued[state.transport_end].transport_arrival = arrival
        state.transport_end += 1


@_compile
def _append(settings: Any, state: Any, memory: Any, sample: int) -> bool:
    """Queue a command; return whether it pushes one out that the plant would have taken."""
    full = state.queue_end - state.queue_first == settings.loop_command_queue
    state.queue_first += full
    memory.queued[state.queue_end].queue = sample
    state.queue_end += 1
    drops = full and not settings.newest_only
    state.commands_dropped += drops
    return drops


@_compile
def _take(settings: Any, state: Any, memory: Any, tick: int) -> int:
    """Return the sample whose command a step begins with, -1 where none has arrived."""
    until = tick * settings.period_ns if settings.is_timed else tick
    while (
        state.transport_first < state.transport_end
        and memory.queued[state.transport_first].transport_arrival < until
    ):
        first = state.transport_first
        state.transport_first += 1
        if _append(settings, state, memory, memory.queued[first].transport) and settings.is_timed:
            _count_lost(memory.losses[COMMANDS_DROPPED], memory.queued[first].transport_arrival)
    count = state.queue_end - state.queue_first
    if count < settings.loop_command_queue:
        _end_stretch(memory.losses[COMMANDS_DROPPED])
    if count == 0:
        return -1
    if settings.newest_only:
        state.queue_first = state.queue_end
        return memory.queued[state.queue_end - 1].queue  # type: ignore[no-any-return]
    state.queue_first += 1
    return memory.queued[state.queue_first - 1].queue  # type: ignore[no-any-return]


# The plant.


@_compile
def _step(settings: Any, state: Any, memory: Any, tick: int) -> None:
    """Move the turtle for one step: watchdog, push, turn, move along the new heading, clamp."""
    sample = _take(settings, state, memory, tick)
    if sample >= 0:
        state.speed_m_s, state.turn_rate_rad_s = (
            memory.samples[sample].speed,
            memory.samples[sample].turn_rate,
        )
        state.idle_ns = 0
    else:
        state.idle_ns += settings.period_ns
    if state.idle_ns > settings.watchdog_ns:
        state.speed_m_s = state.turn_rate_rad_s = 0.0
    forward, turn_rate = state.speed_m_s, state.turn_rate_rad_s
    if settings.is_pushed:
        push, turn_push = _find_push(settings, memory, tick)
        forward, turn_rate = forward + push, turn_rate + turn_push
    left, period_s = 0.0, settings.period_s
    heading_rad = state.heading_rad + turn_rate * period_s
    heading_rad -= _TWO_PI * np.floor((heading_rad + _PI) / _TWO_PI)
    cosine, sine = _find_direction(memory.directions[_OF_TURTLE], heading_rad)
    x_m = state.x_m + (cosine * forward * period_s - sine * left * period_s)
    down_m = state.down_m - (cosine * left * period_s + sine * forward * period_s)
    state.hit_wall = not (0.0 <= x_m <= WORLD_SIZE_M and 0.0 <= down_m <= WORLD_SIZE_M)
    if state.hit_wall:
        x_m = _least(_most(x_m, 0.0), WORLD_SIZE_M)
        down_m = _least(_most(down_m, 0.0), WORLD_SIZE_M)
    state.x_m, state.down_m, state.heading_rad = x_m, down_m, heading_rad
    y_m = WORLD_SIZE_M - down_m
    if not settings.is_exact:
        x_m, y_m = _round_to_float32(x_m), _round_to_float32(y_m)
        heading_rad = _round_to_float32(heading_rad)
    memory.ticks[tick].x_m, memory.ticks[tick].y_m, memory.ticks[tick].heading_rad = (
        x_m,
        y_m,
        heading_rad,
    )
    memory.ticks[tick].applied_speed = _round_to_float32(abs(forward))
    memory.ticks[tick].applied_turn_rate = _round_to_float32(turn_rate)
    if math.isinf(memory.ticks[tick].applied_speed) or math.isinf(
        memory.ticks[tick].applied_turn_rate
    ):
        state.has_failed = 1


@_compile
def _find_push(settings: Any, memory: Any, tick: int) -> tuple[float, float]:
    time_ns = tick * settings.period_ns
    if not settings.push_from_ns <= time_ns < settings.push_to_ns:
        return 0.0, 0.0
    speed, turn_rate = settings.disturbance_speed_m_s, settings.disturbance_turn_rate_rad_s
    if settings.push_scale or settings.turn_push_scale:
        speed += settings.push_scale * memory.ticks[tick].push
        turn_rate += settings.turn_push_scale * memory.ticks[tick].turn_push
    return speed, turn_rate


# Sensing.


@_compile
def _sense(settings: Any, memory: Any, tick: int) -> bool:
    """Sense the pose of a tick; return whether it arrives at all."""
    sensed = memory.ticks[tick]
    if settings.sensing_dropout_probability and (
        memory.ticks[tick].dropout < settings.sensing_dropout_probability
    ):
        _count_lost(memory.losses[POSES_LOST], tick * settings.period_ns)
        sensed.sensed_x_m = sensed.sensed_y_m = sensed.sensed_heading_rad = np.nan
        return False
    _end_stretch(memory.losses[POSES_LOST])
    x_m = memory.ticks[tick].x_m + settings.sensing_bias_position_m
    y_m = memory.ticks[tick].y_m + settings.sensing_bias_position_m
    heading_rad = memory.ticks[tick].heading_rad + settings.sensing_bias_heading_rad
    noise_m, noise_rad = settings.sensing_noise_position_m, settings.sensing_noise_heading_rad
    if noise_m or noise_rad:
        x_m += noise_m * memory.ticks[tick].noise_x
        y_m += noise_m * memory.ticks[tick].noise_y
        heading_rad += noise_rad * memory.ticks[tick].noise_heading
    probability = settings.sensing_outlier_probability
    if probability and memory.ticks[tick].outlier_chance < probability:
        direction, side = memory.ticks[tick].outlier_direction, memory.ticks[tick].outlier_side
        x_m += settings.sensing_outlier_m * math.cos(2.0 * math.pi * direction)
        y_m += settings.sensing_outlier_m * math.sin(2.0 * math.pi * direction)
        far_rad = settings.sensing_outlier_rad
        heading_rad += far_rad if side < 0.5 else -far_rad
    x_m = _round_to_step(x_m, settings.sensing_quantum_position_m)
    y_m = _round_to_step(y_m, settings.sensing_quantum_position_m)
    heading_rad = _round_to_step(heading_rad, settings.sensing_quantum_heading_rad)
    if heading_rad != memory.ticks[tick].heading_rad:
        heading_rad = _wrap_angle(heading_rad)
    if not settings.is_exact:
        x_m, y_m = _round_to_float32(x_m), _round_to_float32(y_m)
        heading_rad = _round_to_float32(heading_rad)
    sensed.sensed_x_m, sensed.sensed_y_m, sensed.sensed_heading_rad = x_m, y_m, heading_rad
    return True


# The controller: its queue of poses, its timer, its blocking.


@_compile
def _receive(settings: Any, state: Any, memory: Any, tick: int) -> None:
    """Send the pose of a tick on its way, or queue it."""
    if not settings.delays_poses:
        _queue_pose(settings, state, memory, tick)
        return
    arrival_ns = tick * settings.period_ns + settings.sensing_delay_ns
    if settings.sensing_jitter_ns:
        arrival_ns += int(np.rint(settings.sensing_jitter_ns * memory.ticks[tick].sensing_jitter))
    state.pose_arrived_ns = arrival_ns = max(arrival_ns, state.pose_arrived_ns)
    memory.queued[state.arrivals_end].arrivals = tick
    memory.queued[state.arrivals_end].arrival_ns = arrival_ns
    state.arrivals_end += 1


@_compile
def _queue_pose(settings: Any, state: Any, memory: Any, tick: int) -> None:
    if tick % settings.loop_period_ticks:
        return
    full = state.poses_end - state.poses_first == settings.loop_pose_queue
    state.poses_dropped += full
    state.poses_first += full
    memory.queued[state.poses_end].poses = tick
    state.poses_end += 1
    if state.waits_for:
        state.waits_for -= 1


@_compile
def _answer(settings: Any, state: Any, memory: Any, tick: int) -> None:
    """Answer the poses of a tick, and publish what goes out in it."""
    if settings.delays_poses:
        _answer_timed(settings, state, memory, tick)
        return
    if state.waits_for:
        return
    if state.blocked >= 0:
        if tick < state.free_at:
            return
        _put(settings, state, memory, tick, state.blocked)
        state.blocked = -1
    _answer_waiting(settings, state, memory, tick, tick, tick * settings.period_ns)


@_compile
def _answer_waiting(
    settings: Any, state: Any, memory: Any, tick: int, now: int, time_ns: int
) -> None:
    """Answer the poses that wait, until the law blocks or ends; `now` in its unit of blocking."""
    while state.poses_first < state.poses_end:
        pose = memory.queued[state.poses_first].poses
        state.poses_first += 1
        sample = state.samples
        blocks = _ask_law(settings, state, memory, time_ns, pose)
        if state.has_failed:
            return
        if blocks > 0:
            state.free_at, state.blocked = now + blocks * settings.block, sample
            return
        _put(settings, state, memory, tick, sample)
        if state.stop_reason:
            return


@_compile
def _answer_timed(settings: Any, state: Any, memory: Any, tick: int) -> None:
    before_ns = min((tick + 1) * settings.period_ns, settings.end_ns)
    while not (state.stop_reason or state.has_failed):
        now_ns = _find_next_ns(state, memory)
        if now_ns >= before_ns:
            return
        _deliver(settings, state, memory, now_ns)
        if state.blocked >= 0:
            if now_ns < state.free_at:
                continue
            _put(settings, state, memory, tick, state.blocked)
            state.blocked = -1
        if not state.waits_for and _is_due(settings, state, memory):
            _answer_waiting(settings, state, memory, tick, now_ns, now_ns)


@_compile
def _find_next_ns(state: Any, memory: Any) -> int:
    """Return the time at which something happens next [ns]."""
    now_ns = state.fires_ns
    if state.arrivals_first < state.arrivals_end:
        now_ns = min(now_ns, memory.queued[state.arrivals_first].arrival_ns)
    return min(now_ns, state.free_at) if state.blocked >= 0 else now_ns  # type: ignore[no-any-return]


@_compile
def _is_due(settings: Any, state: Any, memory: Any) -> bool:
    """Whether poses may be answered; of a timer that fired the newest is queued."""
    if not settings.timer_ns:
        return True
    if not state.is_due or state.newest < 0:
        return False
    state.is_due = 0
    memory.queued[state.poses_end].poses = state.newest
    state.poses_end += 1
    return True


@_compile
def _deliver(settings: Any, state: Any, memory: Any, now_ns: int) -> None:
    """Take the poses that have come, and note whether the timer fires."""
    while (
        state.arrivals_first < state.arrivals_end
        and memory.queued[state.arrivals_first].arrival_ns <= now_ns
    ):
        pose = memory.queued[state.arrivals_first].arrivals
        state.arrivals_first += 1
        if not settings.timer_ns:
            _queue_pose(settings, state, memory, pose)
            continue
        state.newest = pose
        if state.waits_for:
            state.waits_for -= 1
            state.fires_ns = _NEVER_NS if state.waits_for else now_ns
    if settings.timer_ns and state.fires_ns == now_ns:
        state.is_due = 1
        state.fires_ns += settings.timer_ns


# The law.


@_compile
def _ask_law(settings: Any, state: Any, memory: Any, time_ns: int, pose: int) -> int:
    """Make the sample of a pose; return for how many ticks the law blocks."""
    sample = memory.samples[state.samples]
    state.samples += 1
    if settings.has_sensor:
        read = memory.ticks[pose]
        x_m, y_m, heading_rad = read.sensed_x_m, read.sensed_y_m, read.sensed_heading_rad
    else:
        x_m, y_m, heading_rad = (
            memory.ticks[pose].x_m,
            memory.ticks[pose].y_m,
            memory.ticks[pose].heading_rad,
        )
    error_x_m, error_y_m = settings.goal_x_m - x_m, settings.goal_y_m - y_m
    sample.error_x_m, sample.error_y_m = error_x_m, error_y_m
    sample.integral_angular = sample.derivative_angular = 0.0
    sample.integral_linear = sample.derivative_linear = 0.0
    phase, blocks, speed, turn_rate = state.phase, 0, 0.0, 0.0
    if phase == TRANSLATE:
        speed = _translate(settings, state, memory, sample, time_ns, heading_rad)
        world_x, world_y = state.world_v_x_m_s, state.world_v_y_m_s
    else:
        world_x = world_y = 0.0
        if phase < 0:
            state.bearing_rad = math.atan2(error_y_m, error_x_m)
            state.phase, state.first_ns = ROTATE, time_ns
        elif phase == ROTATE:
            turn_rate = _rotate(settings, state, sample, memory.axes[_TURN], time_ns, heading_rad)
            blocks = settings.law_pause_ticks if state.phase == TRANSLATE else 0
        else:
            turn_rate = _reorient(settings, state, sample, memory.axes[_TURN], time_ns, heading_rad)
        phase = max(phase, ROTATE)
    if not (abs(speed) < LARGEST_FLOAT and abs(turn_rate) < LARGEST_FLOAT):
        state.has_failed = 1
    total = state.bearing_rad + state.heading_error_rad + error_x_m + error_y_m
    if not math.isfinite(
        total
        + world_x
        + world_y
        + sample.integral_angular
        + sample.derivative_angular
        + (sample.integral_linear + sample.derivative_linear)
    ):
        state.has_failed = 1
    sample.time_ns, sample.pose_sequence = time_ns, pose
    sample.phase = phase
    sample.published_ns = time_ns + blocks * settings.tick_ns
    sample.bearing_rad = state.bearing_rad
    sample.heading_error_rad = state.heading_error_rad
    sample.distance_m = find_hypot(error_x_m, error_y_m)
    sample.world_v_x_m_s, sample.world_v_y_m_s = world_x, world_y
    sample.wanted_speed, sample.wanted_turn_rate = speed, turn_rate
    dt_s = settings.first_s if state.last_ns < 0 else (time_ns - state.last_ns) / 1e9
    state.last_ns = time_ns
    sample.shaped_speed, sample.speed = _limit(settings, memory.axes[_SPEED], speed, dt_s)
    sample.shaped_turn_rate, sample.turn_rate = _limit(
        settings, memory.axes[_TURN], turn_rate, dt_s
    )
    return blocks


@_compile
def _rotate(
    settings: Any, state: Any, sample: Any, axis: Any, time_ns: int, heading_rad: float
) -> float:
    """Return the turn rate; the phase is the next one where the rotation ends."""
    error_rad = state.bearing_rad - heading_rad
    if settings.law_wrap_error:
        error_rad = _wrap_angle(error_rad)
    state.heading_error_rad = error_rad
    if abs(error_rad) > settings.law_heading_tolerance_rad:
        return _turn(settings, state, sample, axis, time_ns, heading_rad)  # type: ignore[no-any-return]
    state.phase = TRANSLATE
    return 0.0


@_compile
def _reorient(
    settings: Any, state: Any, sample: Any, axis: Any, time_ns: int, heading_rad: float
) -> float:
    error_rad = settings.goal_heading_rad - heading_rad
    if settings.law_wrap_error:
        error_rad = _wrap_angle(error_rad)
    state.heading_error_rad = error_rad
    if abs(error_rad) <= settings.law_heading_tolerance_rad:
        state.stop_reason = WITHIN_TOLERANCE
        return 0.0
    if time_ns - state.first_ns > settings.law_timeout_s * 1e9:
        state.stop_reason = TIMEOUT
    return _turn(settings, state, sample, axis, time_ns, heading_rad)  # type: ignore[no-any-return]


@_compile
def _turn(
    settings: Any, state: Any, sample: Any, axis: Any, time_ns: int, heading_rad: float
) -> float:
    """Return the turn rate of a heading error, with integral and derivative where there are."""
    error_rad = state.heading_error_rad
    turn_rate = settings.law_kp_angular * error_rad
    if not axis.has_terms:
        return turn_rate  # type: ignore[no-any-return]
    turned_rad = _wrap_angle(heading_rad - state.heading_before_rad)
    state.heading_before_rad = heading_rad
    _advance_terms(settings, state, axis, time_ns, turned_rad)
    sample.integral_angular, sample.derivative_angular = axis.integral, axis.derivative
    return _add_terms(settings, axis, turn_rate, error_rad)  # type: ignore[no-any-return]


@_compile
def _translate(
    settings: Any, state: Any, memory: Any, sample: Any, time_ns: int, heading_rad: float
) -> float:
    """Return the speed; the stop reason where the translation ends, or the next phase."""
    x_m, y_m = sample.error_x_m, sample.error_y_m
    tolerance_m = settings.law_position_tolerance_m
    axis = memory.axes[_SPEED]
    stop_reason, speed = WITHIN_TOLERANCE, 0.0
    if abs(x_m) > tolerance_m or abs(y_m) > tolerance_m:
        kp = settings.law_kp_linear
        state.world_v_x_m_s, state.world_v_y_m_s = kp * x_m, kp * y_m
        along_rad = heading_rad if settings.law_projection else state.bearing_rad
        cos, sin = _find_direction(memory.directions[_OF_LAW], along_rad)
        speed = state.world_v_x_m_s * cos + state.world_v_y_m_s * sin
        if axis.has_terms:
            way_m = (state.error_before_x_m - x_m) * cos + (state.error_before_y_m - y_m) * sin
            state.error_before_x_m, state.error_before_y_m = x_m, y_m
            _advance_terms(settings, state, axis, time_ns, way_m)
            sample.integral_linear, sample.derivative_linear = axis.integral, axis.derivative
            speed = _add_terms(settings, axis, speed, x_m * cos + y_m * sin)
        stop_reason = _find_stop_reason(settings, state, time_ns, speed, max(abs(x_m), abs(y_m)))
    if stop_reason in (0, TIMEOUT) or not settings.law_reorient:
        state.stop_reason = stop_reason
    else:
        state.phase = REORIENT
    return speed


@_compile
def _find_stop_reason(settings: Any, state: Any, time_ns: int, speed: float, error_m: float) -> int:
    still = abs(speed) < settings.law_standstill_below
    state.still_samples = state.still_samples + 1 if still else 0
    if state.still_samples > settings.law_standstill_samples:
        return STANDSTILL
    if error_m >= settings.law_settled_within_m:
        state.close_since_ns = -1
    elif state.close_since_ns < 0:
        state.close_since_ns = time_ns
    elif time_ns - state.close_since_ns > settings.law_settled_for_s * 1e9:
        return SETTLED
    return TIMEOUT if time_ns - state.first_ns > settings.law_timeout_s * 1e9 else 0


@_compile
def _advance_terms(settings: Any, state: Any, axis: Any, time_ns: int, moved: float) -> None:
    """Begin integral and derivative with a phase, or go on to a sample."""
    if state.begun != state.phase:
        state.begun = state.phase
        axis.integral = axis.derivative = axis.error_rate = axis.excess = 0.0
        axis.last_ns = time_ns
        return
    step_s = (time_ns - axis.last_ns) / 1e9
    axis.last_ns = time_ns
    if step_s <= 0.0:
        return
    back = _least(step_s / settings.law_tracking_time_s, 1.0)
    axis.integral += step_s * axis.error_rate - back * axis.excess
    filter_s = settings.law_derivative_filter_s
    axis.derivative = (filter_s * axis.derivative - axis.kd * moved) / (filter_s + step_s)


@_compile
def _add_terms(settings: Any, axis: Any, proportional: float, error: float) -> float:
    """Return the command, and keep how the integral goes on from here."""
    command = proportional + axis.integral + axis.derivative
    if axis.ki == 0.0:
        return command  # type: ignore[no-any-return]
    excess = command - _clip(command, axis.limit)
    error_rate = axis.ki * error
    if settings.law_anti_windup == 1 and excess * error_rate > 0.0:
        error_rate = 0.0
    axis.error_rate = error_rate
    axis.excess = excess if settings.law_anti_windup == 2 else 0.0
    return command  # type: ignore[no-any-return]


# Shaping and limits.


@_compile
def _limit(settings: Any, axis: Any, wanted: float, dt_s: float) -> tuple[float, float]:
    """Return a command after shaping, and after the limits."""
    if settings.low_pass_s:
        axis.low_pass -= math.expm1(-dt_s / settings.low_pass_s) * (wanted - axis.low_pass)
        wanted = axis.low_pass
    wanted = 0.0 if abs(wanted) < axis.dead_zone else _round_to_step(wanted, axis.quantum)
    clipped = _clip(wanted, axis.limit)
    if math.isfinite(axis.jerk):
        return wanted, _follow_with_jerk(axis, clipped, dt_s)
    if not math.isfinite(axis.acceleration):
        return wanted, clipped
    step = axis.acceleration * dt_s
    if abs(clipped - axis.value) <= step:
        axis.value = clipped
    else:
        axis.value += math.copysign(step, clipped - axis.value)
    return wanted, axis.value


@_compile
def _follow_with_jerk(axis: Any, wanted: float, dt_s: float) -> float:
    if dt_s <= 0.0 or (axis.value == wanted and axis.rate == 0.0):
        return axis.value  # type: ignore[no-any-return]
    jerk = axis.jerk
    rest = axis.value + axis.rate * abs(axis.rate) / (2.0 * jerk)
    side = math.copysign(1.0, wanted - rest)
    way, now = side * (wanted - axis.value), side * axis.rate
    top = _least(math.sqrt(_most(jerk * way + 0.5 * now * now, 0.0)), axis.acceleration)
    top = _most(top, now)
    held_s = 0.0
    if top > 0.0:
        held_s = _most(way - (2.0 * top * top - now * now) / (2.0 * jerk), 0.0) / top
    left_s = dt_s
    for part in range(3):
        part_jerk = side * jerk if part == 0 else 0.0 if part == 1 else -side * jerk
        duration_s = (top - now) / jerk if part == 0 else held_s if part == 1 else top / jerk
        part_s = _least(duration_s, left_s)
        axis.value += (axis.rate + 0.5 * part_jerk * part_s) * part_s
        axis.rate += part_jerk * part_s
        left_s -= part_s
        if left_s <= 0.0:
            break
    else:
        axis.value, axis.rate = wanted, 0.0
    axis.value = _clip(axis.value, axis.limit)
    return axis.value  # type: ignore[no-any-return]


# Events.


@_compile
def _note(state: Any, memory: Any, tick: int, kind: int, first: float, second: float) -> None:
    event = memory.events[state.events]
    event[0], event[1], event[2], event[3] = tick, kind, first, second
    state.events += 1


@_compile
def _watch(settings: Any, state: Any, memory: Any, tick: int, before: int) -> None:
    """Note what changed since the last tick, `before` which there were so many samples."""
    for kind in range(len(memory.losses)):
        loss = memory.losses[kind]
        if state.stop_reason:
            _end_stretch(loss)
        if loss.finished:
            _note(state, memory, tick, kind, loss.finished_since_ns, loss.finished)
            loss.finished = 0
    if state.hit_wall and not state.was_at_wall:
        _note(state, memory, tick, WALL_HIT, state.x_m, WORLD_SIZE_M - state.down_m)
    state.was_at_wall = state.hit_wall
    if state.samples > before and state.poses_dropped > state.poses_told:
        _note(state, memory, tick, POSES_DROPPED, 0.0, state.poses_dropped - state.poses_told)
        state.poses_told = state.poses_dropped
    if state.commands_dropped > state.commands_told and not settings.is_timed:
        lost = state.commands_dropped - state.commands_told
        _note(state, memory, tick, COMMANDS_DROPPED, -1.0, lost)
    state.commands_told = state.commands_dropped
    if state.stop_reason:
        _note(state, memory, tick, STOP, 0.0, state.stop_reason)


# The loop.

SOURCES = (kernel_fields, kernel_memory, law_driver, turtlesim)
"""Whose constants stand in the machine code."""

_SIGNATURE = types.int64(
    *(from_dtype(kind)[::1] for kind in (SETTINGS, STATE)), typeof(allocate(1, 1))
)


def _build(stamp: int) -> Any:
    """Return the loop, whose cache knows the constants that it was compiled with."""

    @njit(_SIGNATURE, nogil=True, cache=True, error_model="numpy", _nrt=False)
    def run_loop(all_settings: Any, states: Any, memory: Any) -> int:
        """Simulate a scenario into `memory`; into the state how it ends, and of what how much."""
        settings, state = all_settings[0], states[0]
        for tick in range(settings.last_tick + 1):
            _step(settings, state, memory, tick)
            if not settings.has_sensor or _sense(settings, memory, tick):
                _receive(settings, state, memory, tick)
            before = state.samples
            _answer(settings, state, memory, tick)
            if state.has_failed:
                return stamp
            if state.stop_reason == 0 and tick == settings.last_tick:
                state.stop_reason = MAX_DURATION
            _watch(settings, state, memory, tick, before)
            state.ticks += 1
            if state.stop_reason:
                return stamp
        return stamp

    return run_loop


run_loop = _build(sum_up_sources(*SOURCES))
