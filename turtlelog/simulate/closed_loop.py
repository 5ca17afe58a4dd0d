"""The closed loop: plant, queues and controller, one tick at a time."""

from collections.abc import Iterator
from struct import Struct
from typing import Final

import msgspec

from turtlelog.laws import LAWS, Pose
from turtlelog.plants import Plant
from turtlelog.run import Event
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate.controller import build_controller
from turtlelog.simulate.drives import build_drive
from turtlelog.simulate.event_watch import build_watch
from turtlelog.simulate.law_driver import LawDriver, Samples, build_law
from turtlelog.simulate.sensing import build_sensor
from turtlelog.simulate.shaping import build_driver
from turtlelog.simulate.step_budget import (
    STEP_BUDGET,
    STEP_BUDGET_S,
    LimitedLoop,
    StepBudgetError,
    needs_watch,
    require_budget,
)
from turtlelog.simulate.transport import build_commands

_POSE: Final = Struct("<5f")
"""How turtlesim publishes x, y, heading, speed and turn rate: as 32-bit floats."""


LAW_FAILED: Final = "law_failed"
"""Stop reason of a run whose law gave no answer."""


class Tick(msgspec.Struct, frozen=True, gc=False):
    """What one plant step brought.

    Attributes:
        time_ns: Simulated time [ns].
        pose: The pose as published.
        speed_m_s: Magnitude of the applied velocity [m/s].
        turn_rate_rad_s: Applied turn rate [rad/s].
        computed: Samples whose pose was answered in this tick, in order.
        published: Samples whose command went out in this tick, in order.
        events: What else happened.
        stop_reason: Why this tick is the last one, None while it is not.
        sensed: The pose as it is sensed, None where it drops out; None throughout where the
            controller reads the poses as published.
    """

    time_ns: int
    pose: Pose
    speed_m_s: float
    turn_rate_rad_s: float
    computed: Samples
    published: Samples
    events: tuple[Event, ...]
    stop_reason: str | None
    sensed: Pose | None = None


def iterate_ticks(
    scenario: Scenario,
    plant: Plant | None = None,
    *,
    step_budget_s: float | None = STEP_BUDGET_S,
    one_by_one: bool = False,
) -> Iterator[Tick]:
    """Return the ticks of a closed loop until the law is done or `max_duration_s` has passed.

    Ticks are steps of the plant, one per period; what the scenario counts in ticks as well. A tick
    owns the time up to the next. At one time the plant moves first, then commands arrive, then the
    pose is delivered, then the controller runs.

    Args:
        scenario: What to simulate.
        plant: On whose clock; None: on that of the scenario's plant.
        step_budget_s: Time that the law may compute for one answer, by the computer's clock [s];
            None: as long as it takes. From 1 s on the steps of built-in laws are not watched, and
            the loop of another law computes in a thread of its own.
        one_by_one: Compute a tick when it is taken, not some ticks ahead.

    Raises:
        ScenarioError: If the law cannot be loaded or may not run.
        SimulationError: If the budget is no time. While iterating, if the law fails or answers with
            something that is no number; after the tick in which it does, whose stop reason is
            `law_failed`, or `step_budget` if it computed for too long.
    """
    scenario = resolve_scenario(scenario)
    if step_budget_s is not None:
        require_budget(step_budget_s)
    drivers: list[LawDriver] = []
    ticks = _iterate(scenario, plant, step_budget_s, drivers)
    kind = scenario.law.kind
    if step_budget_s is None or not needs_watch(step_budget_s, is_built_in=kind in LAWS):
        return ticks
    return LimitedLoop(ticks, drivers, step_budget_s, law=kind, one_by_one=one_by_one).iterate()


def _iterate(
    scenario: Scenario,
    plant: Plant | None,
    step_budget_s: float | None,
    drivers: list[LawDriver],
) -> Iterator[Tick]:
    """Yield the ticks; `drivers` gets what asks the law."""
    plant = scenario.plant.facts if plant is None else plant
    period_ns = plant.period_ns
    law = build_law(scenario.law)
    driver = build_driver(scenario, law, period_ns=period_ns, step_budget_s=step_budget_s)
    drivers.append(driver)
    controller = build_controller(scenario, driver, plant)
    sensor = build_sensor(scenario, period_ns, controller.receive)
    commands = build_commands(scenario, plant)
    drive = build_drive(scenario, plant, commands)
    watch = build_watch(drive, controller, commands, sensor)
    # Effects are parts chosen here: the loop asks for none of them.
    receive = controller.receive if sensor is None else sensor.receive
    step, answer, put, find_events = drive.step, controller.answer, commands.put, watch.find_events
    exact = scenario.loop.pose_precision == "float64"
    last_tick = round(scenario.max_duration_s * 1e9) // period_ns
    pack_floats, round_floats = _POSE.pack, _POSE.unpack
    stop_reason: str | None = None
    for tick in range(last_tick + 1):
        time_ns = tick * period_ns
        state = step(tick)
        x_m, y_m, heading_rad, speed, turn_rate = round_floats(pack_floats(*state))
        pose = Pose(*state[:3]) if exact else Pose(x_m, y_m, heading_rad)
        sensed = receive(tick, pose)
        computed, published = answer(tick, time_ns)
        for sample in published:
            put(tick, sample)
            stop_reason = sample.decision.stop_reason
        failure = controller.failure
        if failure is not None:
            is_late = isinstance(failure, StepBudgetError)
            stop_reason = STEP_BUDGET if is_late else LAW_FAILED
        if stop_reason is None and tick == last_tick:
            stop_reason = "max_duration"
        yield Tick(
            time_ns,
            pose,
            speed,
            turn_rate,
            computed,
            published,
            find_events(time_ns, stop_reason, answered=bool(computed)),
            stop_reason,
            sensed,
        )
        if failure is not None:
            raise failure
        if stop_reason is not None:
            return
