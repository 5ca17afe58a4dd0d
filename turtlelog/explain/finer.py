"""A loop whose clock runs finer than turtlesim's, in turtlesim's own ticks.

One tick of 16 ms stands for a `FINER`-th of it: commands and limits are as many times smaller,
pauses, queues and delays as many times longer. The robot and the law then see the same motion,
sampled more often. What counts samples in the law, its standstill rule, keeps counting ticks.
"""

import copy
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import msgspec

from turtlelog.laws import Decision, Goal, Pose, SequentialP, SequentialPParameters
from turtlelog.run import Phase, Run
from turtlelog.scenario import LawChoice, Scenario, flatten_scenario
from turtlelog.simulate import simulate_run

FINER: Final = 8
"""Steps that a tick is divided into: 2 ms each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FinerParameters(SequentialPParameters):
    """Those of the sequential law, in real time."""


class FinerSequentialP:
    """The sequential law on a clock that runs `FINER` times slower than the samples say."""

    Parameters: ClassVar[type[Any]] = FinerParameters

    def __init__(self, parameters: FinerParameters) -> None:
        """Take the parameters."""
        self._law = SequentialP(parameters)
        self._translated = 0

    def reset(self, start: Pose, goal: Goal) -> None:
        """Begin a run."""
        self._law.reset(start, goal)
        self._translated = 0

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose; between ticks the law's counters stand still."""
        is_between = self._translated % FINER != 0
        law = copy.copy(self._law) if is_between else self._law
        decision = law.step(time_ns // FINER, pose)
        self._translated += decision.phase is Phase.TRANSLATE
        return msgspec.structs.replace(
            decision,
            speed_m_s=decision.speed_m_s / FINER,
            turn_rate_rad_s=decision.turn_rate_rad_s / FINER,
            blocks_ticks=decision.blocks_ticks * FINER,
        )


def simulate_finer(scenario: Scenario) -> Run:
    """Simulate a scenario of the sequential law with a clock `FINER` times finer, in real time."""
    found = simulate_run(_slow_down(scenario))
    poses, commands, samples = found.poses, found.commands, found.samples
    return replace(
        found,
        poses=replace(
            poses,
            time_ns=poses.time_ns // FINER,
            speed_m_s=_scale(poses.speed_m_s),
            turn_rate_rad_s=_scale(poses.turn_rate_rad_s),
        ),
        commands=replace(
            commands,
            time_ns=commands.time_ns // FINER,
            speed_m_s=_scale(commands.speed_m_s),
            turn_rate_rad_s=_scale(commands.turn_rate_rad_s),
        ),
        samples=replace(
            samples,
            time_ns=samples.time_ns // FINER,
            speed_m_s=_scale(samples.speed_m_s),
            turn_rate_rad_s=_scale(samples.turn_rate_rad_s),
            wanted_speed_m_s=_scale(samples.wanted_speed_m_s),
            wanted_turn_rate_rad_s=_scale(samples.wanted_turn_rate_rad_s),
        ),
        parameters=flatten_scenario(scenario),
        events=(),
    )


def _slow_down(scenario: Scenario) -> Scenario:
    limits, loop, parameters = scenario.limits, scenario.loop, scenario.law.parameters
    values = {name: getattr(parameters, name) for name in SequentialPParameters.__slots__}
    return replace(
        scenario,
        max_duration_s=scenario.max_duration_s * FINER,
        law=LawChoice(
            kind=f"{__name__}:{FinerSequentialP.__name__}", parameters=FinerParameters(**values)
        ),
        limits=replace(
            limits,
            speed_m_s=limits.speed_m_s / FINER,
            turn_rate_rad_s=limits.turn_rate_rad_s / FINER,
        ),
        loop=replace(
            loop,
            # A dead time of k ticks is k times FINER steps.
            period_ticks=1,
            start_backlog=(loop.start_backlog - 1) * FINER + 1,
            pose_queue=loop.pose_queue * FINER,
            command_queue=(loop.command_queue - 1) * FINER + 1,
            transport_delay_ticks=loop.transport_delay_ticks * FINER,
        ),
    )


def _scale(values: Any) -> Any:
    return None if values is None else values * FINER
