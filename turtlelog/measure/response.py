"""The response of a loop to its reference, in the segment of the run in which the loop acts.

Also the response of a robot to the end of its commands. Many bases stop some tenths of a second
after the last command if no 0 is sent.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import dropwhile, takewhile
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import compiled_as
from turtlelog.display import describe_count
from turtlelog.measure.loop_segment import (
    BEARING_NOW,
    HEADING,
    Segment,
    ends_itself,
    find_phase,
    find_segment,
    number_loop,
    refer_to_start,
    subtract_from,
    tell_pose_time,
    tell_publication,
    turn_towards,
    unwrap,
)
from turtlelog.measure.metric import FOUND, REASONS, Missing, Status, add_reason
from turtlelog.measure.reductions import Values, subtract_neighbours
from turtlelog.measure.references import read_controlled_distance, read_reference, trace_poses
from turtlelog.measure.signals import Signal
from turtlelog.run import PhaseSpan, Run
from turtlelog.run.angles import explains_step, find_heading_steps, is_fast_turn
from turtlelog.run.loops import PAUSE, ControlLoop
from turtlelog.run.paths import Path
from turtlelog.run.stop_reasons import TIMEOUT
from turtlelog.run.tables import ends_blocked

if TYPE_CHECKING:
    from turtlelog.measure.run_context import MeasureSettings


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandStretch:
    """The held commands of a loop; no rows if its samples are not from this run.

    Attributes:
        time_s: Publication time of each command, from the first sample of the run [s], shape (m,).
            If it is not recorded, the time of the answer.
        values: Commands [rad/s or m/s], shape (m,).
        wanted: Commands before clipping, shape (m,); None if not recorded.
        limit: Magnitude at which commands are clipped; None if not recorded.
        end_s: Time until which the last command is held, from the first sample of the run [s].
        answered_ns: Time when each pose was answered [ns], shape (m,).
    """

    time_s: Values
    values: Values
    wanted: Values | None
    limit: float | None
    end_s: float
    answered_ns: NDArray[np.int64]

    @cached_property
    def is_saturated(self) -> NDArray[np.bool_] | None:
        """Whether each command is at its limit; None if the limit is not recorded."""
        return None if self.limit is None else np.abs(self.values) >= self.limit

    @cached_property
    def held_s(self) -> Values:
        """Hold time of each command [s], shape (m,)."""
        return compute_hold_times(self.time_s, self.end_s)


class Track(NamedTuple):
    """The moving reference of a loop, and the path that it leads along.

    Attributes:
        reference: Reference at each pose of the response, headings without jumps [rad or m], shape
            (n,); empty if it is constant.
        arcs_m: Arc length of the path's point nearest to each pose [m], shape (n,); empty for other
            loops than those across a path.
        corners: Arc length [m], turn [rad] and length of the leg behind it [m] of each corner of
            the first lap, shape (k, 3).
        seam_rad: Turn between two laps [rad]; 0 if there is no corner.
        length_m: Length of the path, or of a lap [m].
        is_closed: Whether the path ends where it begins.
        has_speed: Whether the reference moves with time.
    """

    reference: Values
    arcs_m: Values
    corners: Values
    seam_rad: float
    length_m: float
    is_closed: bool
    has_speed: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Response of the controlled signal of a loop to its reference.

    With a constant reference, `values` are the signal itself. With a moving reference, `values` are
    the initial reference minus the error: the signal that a constant reference would have given.
    When the error is 0, the values equal `reference`.

    Attributes:
        loop: Loop of this response.
        start_s: Start of the segment, from the first sample of the run [s].
        rows: Rows of the segment's poses among those of the run.
        pose_ns: Times of the segment's poses [ns], shape (n,), n >= 2.
        time_s: Time from the start of the segment [s], shape (n,).
        values: Heading without jumps [rad] or length [m], shape (n,).
        initial: Initial value of the step: the first value, or the setting `initial`.
        reference: Final value of the step: the reference of the loop, or the setting `final`.
        band: Half-width of the settling band, as a fraction of the step.
        commands: Commands of the segment's samples.
        track: Moving reference of the segment.
        was_cut: Whether the run was cut off before the loop had finished.
        ended_itself: Whether the law ended the segment because its work was done, not by a cut or a
            timeout.
    """

    loop: ControlLoop
    start_s: float
    rows: slice
    pose_ns: NDArray[np.int64]
    time_s: Values
    values: Values
    initial: float
    reference: float
    band: float
    commands: CommandStretch
    track: Track
    was_cut: bool
    ended_itself: bool
    memory: ClassVar[None] = None
    """Work arrays; None, because ordinary Python creates arrays as needed."""

    @cached_property
    def error(self) -> Values:
        """Reference minus value [rad or m], shape (n,)."""
        return subtract_from(self.reference, self.values, None)

    @cached_property
    def step_s(self) -> Values:
        """Time from each row to the next [s], shape (n - 1,)."""
        return subtract_neighbours(self.time_s)

    @property
    def is_angle(self) -> bool:
        """Whether the values are headings."""
        return self.loop.signal == "heading"

    @property
    def limit(self) -> float:
        """Magnitude at which commands are clipped; NaN if it is not recorded."""
        return math.nan if self.commands.limit is None else self.commands.limit


def find_response(
    run: Run, loop: ControlLoop, signal: Signal | None, settings: "MeasureSettings"
) -> Response | Missing:
    """Return the response of a loop in its first segment, or the reason why it is missing.

    `signal` is the controlled signal; None if the run lacks it.
    """
    if not len(run.samples):
        return Missing(Status.ABSENT, "no samples of a controller were read")
    numbers = number_loop(run.declaration, loop)
    segment = find_segment(run.samples, run.poses.time_ns, numbers, run.end_ns)
    controlled = None if signal is None else signal.values
    if loop.signal == "distance" and loop.reference == "recorded":
        controlled = read_controlled_distance(run)
    wanted = read_reference(run, loop)
    is_known = controlled is not None and wanted is not None
    reason = choose_reason(run, numbers, segment, is_known)
    if reason != FOUND or controlled is None or wanted is None:
        return _describe_missing(run, loop, segment, reason)
    inside, is_angle = slice(segment.first, segment.after), loop.signal == "heading"
    controlled = controlled[inside]
    if isinstance(wanted, np.ndarray):
        target = float(wanted[segment.first])
        values = refer_to_start(wanted[inside] - controlled, target, is_angle, None)
    else:
        target, values = turn_towards(wanted, float(controlled[-1]), is_angle), controlled
    initial, reference = _find_step(loop, values, target, settings)
    is_done = came_to_rest(run)
    return Response(
        loop=loop,
        start_s=(segment.start_ns - run.start_ns) / 1e9,
        rows=inside,
        pose_ns=run.poses.time_ns[inside],
        time_s=tell_pose_time(run.poses.time_ns[inside], segment.start_ns),
        values=values,
        initial=initial,
        reference=reference,
        band=settings.band,
        commands=_find_commands(run, loop, segment),
        track=_read_track(run, loop, wanted, inside),
        was_cut=not run.is_complete and segment.end_ns == run.end_ns,
        ended_itself=ends_itself(segment, run.samples, numbers, is_done, ends_blocked(run)),
    )


NO_PHASE: Final = add_reason(Status.NO_PHASE, "the run has no such phase")
_NO_REFERENCE: Final = add_reason(Status.ABSENT, "the reference is not known")
_TOO_SHORT: Final = add_reason(Status.TOO_SHORT, "less than two poses in the loop")
_LOST_TURNS: Final = add_reason(
    Status.UNDETERMINED,
    "the heading turns more than half a turn between poses, which hides full turns",
)


def choose_reason(run: Any, loop: Any, segment: Any, is_known: bool) -> int:  # noqa: FBT001
    """Return the number of the reason why a loop has no response; `FOUND` if it has one.

    Args:
        run: Run; in compiled code, the row of a batch.
        loop: Loop in numbers.
        segment: Segment of the loop.
        is_known: Whether signal and reference are known.
    """
    if segment.first_sample == segment.after_sample:
        return NO_PHASE
    if not is_known:
        return _NO_REFERENCE
    if segment.after - segment.first < 2:
        return _TOO_SHORT
    # The error of a moving reference is wrapped, which aliases.
    is_angle, moves = loop.signal == HEADING, loop.reference >= BEARING_NOW
    return _LOST_TURNS if is_angle and _loses_turns(run, segment, moves) else FOUND


def _lose_turns(row: Any, segment: Any, moves: bool) -> bool:  # noqa: FBT001
    period_s, lost = row.facts.period_ns / 1e9, 0
    for place in range(segment.first + 1, segment.after):
        turned_rad = row.ticks[place].turn_rate_rad_s * period_s
        step_rad = row.ticks[place].heading_rad - row.ticks[place - 1].heading_rad
        if is_fast_turn(turned_rad) and (moves or not explains_step(step_rad, turned_rad)):
            lost += 1
    return lost > 0


@compiled_as(_lose_turns)
def _loses_turns(run: Run, segment: Segment, moves: bool) -> bool:  # noqa: FBT001
    """Return whether a rate in the segment turns by more than half a turn, which hides turns."""
    steps = find_heading_steps(run.poses)
    is_wrong = steps.is_fast if moves else steps.is_lost
    return bool(is_wrong[segment.first : segment.after - 1].any())


def _describe_missing(run: Run, loop: ControlLoop, segment: Segment, reason: int) -> Missing:
    """Return a reason of `choose_reason` with the names of the run and the loop."""
    missing = REASONS[reason]
    if reason == NO_PHASE:
        return Missing(missing.status, describe_no_phase(run, loop))
    if reason == _NO_REFERENCE:
        return Missing(missing.status, _describe_unknown(run, loop))
    if reason == _TOO_SHORT:
        poses = len(run.poses.time_ns[segment.first : segment.after])
        return Missing(missing.status, f"{describe_count(poses, 'pose')} in {loop.name}")
    return missing


def came_to_rest(run: Run) -> bool:
    """Return whether the law ended the run because it was done, not by a timeout or a cut."""
    return run.is_complete and run.stop_reason != TIMEOUT


def find_first_stretch(run: Run, loop: ControlLoop) -> list[PhaseSpan]:
    """Return the first consecutive spans whose phases contain a loop, with their pauses."""
    own = frozenset(run.declaration.list_phases(loop.name))
    before = dropwhile(lambda span: span.phase not in own, run.find_phase_spans())
    return list(takewhile(lambda span: span.phase in own or span.phase == PAUSE, before))


def find_loop_samples(run: Run, loop: ControlLoop) -> slice | None:
    """Return the rows of the samples of a loop's first segment; None if there is none."""
    if not len(run.samples):
        return None
    phases = number_loop(run.declaration, loop).phases
    first = find_phase(run.samples.phase, 0, phases)
    after = find_phase(run.samples.phase, first, ~phases)
    return slice(first, after) if first < after else None


def describe_no_phase(run: Run, loop: ControlLoop) -> str:
    """Return why a loop does not act in a run."""
    phases = run.declaration.list_phases(loop.name)
    return f"the run has no phase {' or '.join(phases) or loop.name}"


def _describe_unknown(run: Run, loop: ControlLoop) -> str:
    """Return why the reference or the controlled signal of a loop is unknown."""
    if loop.reference == "path" and run.path is not None and run.path.speed_m_s is None:
        return "the path has no speed, which would say where the robot should be when"
    return f"the reference {loop.reference} of {loop.signal} is not known"


_NONE: Final = np.empty(0)
_CONSTANT: Final = Track(_NONE, _NONE, np.empty((0, 3)), 0.0, 0.0, is_closed=False, has_speed=False)


def _read_track(run: Run, loop: ControlLoop, wanted: float | Values, rows: slice) -> Track:
    """Return the moving reference of a loop, and for a loop across a path that path."""
    if not isinstance(wanted, np.ndarray):
        return _CONSTANT
    inside, path = wanted[rows], run.path
    inside = unwrap(inside) if loop.signal == "heading" else inside
    if path is None or (loop.signal, loop.reference) != ("cross_track", "path"):
        return _CONSTANT._replace(reference=inside)
    return Track(
        reference=inside,
        arcs_m=trace_poses(run, path)[0][rows],
        corners=list_corners(path),
        seam_rad=path.seam_rad,
        length_m=path.length_m,
        is_closed=path.is_closed,
        has_speed=path.speed_m_s is not None,
    )


def list_corners(path: Path) -> Values:
    """Return the corners of a path's first lap as in `Track`, shape (k, 3)."""
    return np.array(path.corners, np.float64).reshape(-1, 3)


def _find_commands(run: Run, loop: ControlLoop, segment: Segment) -> CommandStretch:
    samples, rows = run.samples, slice(segment.first_sample, segment.after_sample)
    has_publications = len(run.commands) == len(samples)
    time_ns = (run.commands if has_publications else samples).time_ns[rows]
    if loop.command == "turn_rate":
        values, wanted = samples.turn_rate_rad_s, samples.wanted_turn_rate_rad_s
    else:
        values, wanted = samples.speed_m_s, samples.wanted_speed_m_s
    limit = run.parameters.get(loop.limit_key)
    return CommandStretch(
        time_s=tell_publication(time_ns, segment.end_ns, run.start_ns),
        values=values[rows],
        wanted=None if wanted is None else wanted[rows],
        limit=float(limit) if isinstance(limit, int | float) else None,
        end_s=(segment.end_ns - run.start_ns) / 1e9,
        answered_ns=samples.time_ns[rows],
    )


def _find_step(
    loop: ControlLoop, values: Values, target: float, settings: "MeasureSettings"
) -> tuple[float, float]:
    """Return the initial and final values of the step of a loop."""
    initial, final = settings.initial, settings.final
    initial = initial.get(loop.name) if isinstance(initial, Mapping) else initial
    final = final.get(loop.name, "reference") if isinstance(final, Mapping) else final
    first, last, is_angle = float(values[0]), float(values[-1]), loop.signal == "heading"
    initial = first if initial is None else turn_towards(initial, first, is_angle)
    if final == "last":
        return initial, last
    if final != "reference":
        return initial, turn_towards(float(final), last, is_angle)
    return initial, target


def compute_hold_times(time_s: Values, end_s: float) -> Values:
    """Return the hold time of each value [s], shape (n,)."""
    return np.diff(time_s, append=max(end_s, float(time_s[-1])))
