"""Runs: the ticks of a loop, or rows of a compiled loop, as columns; at once or live into sinks."""

import platform
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from struct import Struct
from typing import Any, Final, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SimulationError
from turtlelog.laws import LAWS, find_law, find_module, is_given, read_law_source
from turtlelog.libraries import __version__
from turtlelog.parts import Plant
from turtlelog.run import LAW, CommandColumns, Event, PoseColumns, Run, SampleColumns, SourceKind
from turtlelog.run.loops import Declaration
from turtlelog.run.stop_reasons import INTERRUPTED, STEP_BUDGET
from turtlelog.scenario import Scenario, choose_scenario, flatten_scenario, resolve_scenario
from turtlelog.simulate.class_law import declare_scenario
from turtlelog.simulate.loop_parts import Function, compile_text
from turtlelog.simulate.plain_loop import Tick, iterate_ticks
from turtlelog.simulate.rows import describe_stop
from turtlelog.simulate.step_budget import STEP_BUDGET_S, StepBudgetError
from turtlelog.stop_signals import catch_stop

_POSE: Final = ("x_m", "y_m", "heading_rad", "speed_m_s", "turn_rate_rad_s")
_SENSED: Final = ("sensed_x_m", "sensed_y_m", "sensed_heading_rad")
_SAMPLE: Final = ("time_ns", "sequence", "pose_sequence", "phase")
_DECISION: Final = (
    *("bearing_rad", "heading_error_rad", "error_x_m", "error_y_m", "distance_m"),
    *("world_v_x_m_s", "world_v_y_m_s", "wanted_speed_m_s", "wanted_turn_rate_rad_s"),
    *("speed_m_s", "turn_rate_rad_s"),
)
_COMMAND: Final = ("speed_m_s", "turn_rate_rad_s")
_REFERENCE: Final = ("reference_x_m", "reference_y_m", "reference_heading_rad")
_SHAPED: Final = ("shaped_speed_m_s", "shaped_turn_rate_rad_s")


def simulate_run(
    scenario: Scenario | str | Path,
    plant: Plant | None = None,
    *,
    law: Any = None,
    changes: Mapping[str, Any] | None = None,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> Run:
    """Simulate a scenario and return its run; with a `plant`, on the clock of that plant.

    Args:
        scenario: Scenario to simulate: a scenario, the name of a preset, or a file.
        plant: Plant whose clock is used. Default: the scenario's plant.
        law: Law to use instead of the scenario's law: a class, a function of `(time_ns, pose,
            goal)` that returns speed [m/s] and turn rate [rad/s], an object with `step`, a
            `LawPart`, or the name of a law, as in `my_law.py:MyLaw`.
        changes: Values by dotted key, as in `{"law.kp_linear": 4.0}`.
        step_budget_s: Time for computing one answer of the law, by the computer's clock [s]; None:
            unlimited.

    Raises:
        LawError: If `law` is not a law.
        ScenarioError: If the law cannot be loaded or may not run, or a change is wrong.
        SimulationError: If the law fails or exceeds its time, or no pose is answered within
            `max_duration_s`; the error's `run` is the run so far.
    """
    scenario = resolve_scenario(choose_scenario(scenario, law=law, changes=changes))
    return collect_run(scenario, iterate_ticks(scenario, plant, step_budget_s=step_budget_s))


def collect_run(scenario: Scenario, ticks: Iterable[Tick]) -> Run:
    """Return the run with a scenario's ticks.

    Raises:
        SimulationError: If no pose was answered or the law fails; the error's `run` is the run so
            far.
    """
    collector = RunCollector(scenario)
    try:
        collector.take(ticks)
    except SimulationError as err:
        if isinstance(err, StepBudgetError):
            collector.end_late(err)
        err.run = collector.build_run() if collector.has_samples else None
        raise
    return collector.build_run()


class RunCollector:
    """Collector of ticks, which builds the run so far."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = resolve_scenario(scenario)
        self._declaration = declare_scenario(self._scenario)
        self._senses = self._scenario.has_action("sense", "lose_pose")
        self._poses, self._commands = bytearray(), bytearray()
        fields = _POSE + _SENSED * self._senses
        self._add_pose, self._pose_row = _find_packing((), fields, "q")
        self._add_command, self._command_row = _find_packing(("published_ns",), _COMMAND)
        has_shaping = self._scenario.has_action("shape")
        self._samples = SampleRows(self._declaration, has_shaping=has_shaping)
        self._events: list[Event] = []
        self._stop_reason: str | None = None

    @property
    def has_samples(self) -> bool:
        """Whether there is a sample, which a run needs."""
        return len(self._samples) > 0

    def take(self, ticks: Iterable[Tick]) -> None:
        """Add the next ticks."""
        poses, commands, add_sample = self._poses, self._commands, self._samples.add
        add_pose, add_command = self._add_pose, self._add_command
        for tick in ticks:
            add_pose(poses, tick.row, tick.time_ns)
            if tick.states:
                for sample, states in zip(tick.computed, tick.states, strict=True):
                    add_sample(sample, *states)
            else:
                for sample in tick.computed:
                    add_sample(sample)
            for sample in tick.published:
                add_command(commands, sample)
            self._events += tick.events
            self._stop_reason = tick.stop_reason

    def end_late(self, err: StepBudgetError) -> None:
        """Record the failure of a loop whose step could not be ended; there is no last tick."""
        if self._stop_reason is None and self._poses:
            last_ns = np.frombuffer(self._poses, self._pose_row)["given"][-1, 0]
            text = describe_stop(STEP_BUDGET, f": {err}")
            self._stop_reason = STEP_BUDGET
            self._events.append(Event(time_ns=int(last_ns), kind="stop", text=text))

    def build_run(self) -> Run:
        """Return the run of all ticks so far.

        Raises:
            SimulationError: If no pose was answered.
        """
        scenario, kind = self._scenario, self._scenario.law.kind
        if not self.has_samples:
            backlog, sensing = scenario.loop.start_backlog, scenario.sensing
            waits = {name: getattr(sensing, name) for name in ("dropout_probability", "delay_s")}
            others = [f", sensing.{name} = {value:g}" for name, value in waits.items() if value]
            raise SimulationError(
                f"{scenario.name}: no pose is answered within max_duration_s ="
                f" {scenario.max_duration_s}: start_backlog = {backlog} poses come"
                f" first{''.join(others)}"
            )
        poses = np.frombuffer(self._poses, self._pose_row)
        source = read_law_source(kind) if is_given(kind) else None
        return build_simulated_run(
            scenario,
            self._declaration,
            poses=build_poses(poses["given"][:, 0].copy(), poses, senses=self._senses),
            commands=collect_commands(np.frombuffer(self._commands, self._command_row)),
            samples=self._samples.build_columns(),
            stop_reason=self._stop_reason,
            events=tuple(self._events),
            notes={} if source is None else {"law_source": source},
        )


class SampleRows:
    """Collector of a law's samples, 8 bytes per value.

    Attributes:
        add: Function that adds the next sample, given with the states of its law.
    """

    __slots__ = ("_declaration", "_has_shaping", "_packed", "_row", "add")

    def __init__(self, declaration: Declaration, *, has_shaping: bool = False) -> None:
        """Allocate space for the declared states and reference of a law, and for shaping."""
        self._declaration, self._has_shaping = declaration, has_shaping
        numbers = _DECISION + _REFERENCE * declaration.has_reference + _SHAPED * has_shaping
        add_row, self._row = _find_packing(_SAMPLE, numbers, "d" * len(declaration.states))
        self._packed = bytearray()
        self.add = partial(add_row, self._packed)

    def __len__(self) -> int:
        return len(self._packed) // self._row.itemsize

    def build_columns(self) -> SampleColumns:
        """Return the columns of all samples so far."""
        rows = np.frombuffer(self._packed, self._row)
        states = rows["given"].copy() if self._declaration.states else None
        return build_samples(rows, states, self._declaration, has_shaping=self._has_shaping)


@cache
def _find_packing(
    whole: tuple[str, ...], numbers: tuple[str, ...], given: str = ""
) -> tuple[Function, np.dtype[Any]]:
    """Return a function that appends a row with whole and other numbers, and the type of the row.

    `given` are the kinds of the values that the function receives after the row, `q` or `d`.
    """
    pack = Struct(f"<{len(whole)}q{len(numbers)}d{given}").pack
    others = [f"given_{place}" for place in range(len(given))]
    values = ", ".join([*(f"row.{name}" for name in (*whole, *numbers)), *others])
    head = f"def add_row(packed, {', '.join(['row', *others])}):"
    add = compile_text("add_row", [head, f"    packed += pack({values})"], {"pack": pack})
    fields = [(name, "<i8") for name in whole] + [(name, "<f8") for name in numbers]
    kind = "<i8" if "q" in given else "<f8"
    return add, np.dtype([*fields, ("given", kind, (len(given),))])


# Columns from packed rows, or from the rows of a compiled loop, which have the same fields.


def build_simulated_run(scenario: Scenario, declaration: Declaration, **others: Any) -> Run:
    """Return the run of a simulated scenario from its fields that no scenario determines."""
    goal = scenario.goal if declaration.uses_goal else None
    return Run(
        name=scenario.name,
        source=SourceKind.SIMULATION.describe(),
        goal_xy_m=None if goal is None else (goal.x_m, goal.y_m),
        goal_heading_rad=None if goal is None else goal.heading_rad,
        declaration=declaration,
        parameters=flatten_scenario(scenario),
        scenario_is_complete=True,
        simulated_by=find_software(scenario.law.kind),
        **others,
    )


def build_poses(time_ns: NDArray[np.int64], rows: NDArray[Any], *, senses: bool) -> PoseColumns:
    """Return the poses at the times of ticks [ns]; sensed poses are NaN if they dropped out."""
    return PoseColumns(
        time_ns=time_ns,
        xy_m=pair_columns(rows, "x_m", "y_m"),
        **{name: rows[name].copy() for name in ("heading_rad", *_COMMAND)},
        sensed_xy_m=pair_columns(rows, "sensed_x_m", "sensed_y_m") if senses else None,
        sensed_heading_rad=rows["sensed_heading_rad"].copy() if senses else None,
    )


def collect_commands(rows: NDArray[Any]) -> CommandColumns:
    """Return the commands of published samples."""
    speed = rows["speed_m_s"].copy()
    return CommandColumns(
        time_ns=rows["published_ns"].copy(),
        speed_m_s=speed,
        lateral_speed_m_s=np.zeros_like(speed),
        turn_rate_rad_s=rows["turn_rate_rad_s"].copy(),
    )


def build_samples(
    rows: NDArray[Any],
    states: NDArray[np.float64] | None,
    declaration: Declaration,
    *,
    has_shaping: bool,
) -> SampleColumns:
    """Return the samples; a column is None if it is not declared, or if a row has no number."""
    moves = declaration.has_reference
    world = pair_columns(rows, "world_v_x_m_s", "world_v_y_m_s")
    commands = ("wanted_speed_m_s", "wanted_turn_rate_rad_s", *_COMMAND)
    return SampleColumns(
        **{name: rows[name].copy() for name in (*_SAMPLE, *commands)},
        bearing_rad=_keep_whole(rows["bearing_rad"].copy()),
        heading_error_rad=_keep_whole(rows["heading_error_rad"].copy()),
        error_xy_m=_keep_whole(pair_columns(rows, "error_x_m", "error_y_m")),
        distance_m=_keep_whole(rows["distance_m"].copy()),
        shaped_speed_m_s=rows["shaped_speed_m_s"].copy() if has_shaping else None,
        shaped_turn_rate_rad_s=rows["shaped_turn_rate_rad_s"].copy() if has_shaping else None,
        world_velocity_m_s=None if np.isnan(world).all() else world,
        states=states,
        reference_xy_m=pair_columns(rows, "reference_x_m", "reference_y_m") if moves else None,
        reference_heading_rad=rows["reference_heading_rad"].copy() if moves else None,
    )


def pair_columns(rows: NDArray[Any], *names: str) -> NDArray[np.float64]:
    """Return fields of rows side by side, shape (n, k)."""
    return np.column_stack([rows[name] for name in names])


def _keep_whole(values: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a column; None if a row has no number, for example an error without a goal."""
    return None if np.isnan(values).any() else values


# The simulating software.


def find_software(law: str) -> dict[str, str]:
    """Return the versions, the platform and, for a user law, a digest of its code.

    The law has been loaded. The platform includes the C library, because sines and cosines may
    differ in their last bits.
    """
    code = None if law in LAWS else _read_code(law)
    digest = {} if code is None else {LAW: f"sha256 {sha256(code).hexdigest()[:16]}"}
    return {**_find_versions(), **digest}


@cache
def _find_versions() -> dict[str, str]:
    return {
        "turtlelog": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": " ".join([platform.system(), platform.machine(), *platform.libc_ver()]).strip(),
    }


def _read_code(kind: str) -> bytes | None:
    """Return the text of the file that defines a law; None if there is no such file."""
    if is_given(kind):
        source = read_law_source(kind)
        return None if source is None else source.encode()
    file = getattr(sys.modules.get(find_module(find_law(kind))), "__file__", None)
    try:
        return None if file is None else Path(file).read_bytes()
    except OSError:
        return None


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
        self._clock, self._period_s, self._start_s = clock, period_s, 0.0
        self.late_ticks, self.greatest_lag_s = 0, 0.0

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
        if is_over:
            event = Event(time_ns=tick.time_ns, kind="stop", text=describe_stop(INTERRUPTED))
            events = (*tick.events, event)
            tick = msgspec.structs.replace(tick, stop_reason=INTERRUPTED, events=events)
        for sink in sinks:
            sink.receive(tick)
        if is_over and not is_answered:
            raise KeyboardInterrupt  # a run needs at least one sample
        yield tick
        if is_over:
            return
