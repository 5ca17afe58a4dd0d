"""A declared loop with all that theory needs of it, or the reason why it is not known."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypedDict

from turtlelog.errors import TheoryError
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.theory.declared_loops import (
    Parameters,
    find_ramp_s,
    find_timing,
    list_neglected,
    read_gains,
    read_process,
)
from turtlelog.theory.pid_gains import PidGains
from turtlelog.theory.pid_loop import PidLoop, analyse_pid_loop, is_pid_stable
from turtlelog.theory.process import Process

SCENARIO: Final = "from the scenario"


class Settings(TypedDict):
    """Arguments of theory's functions beside the gains."""

    period_s: float
    process: Process


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredTiming:
    """Period and dead time of a loop, measured on a run.

    Attributes:
        period_s: Sampling period [s].
        dead_time_s: Dead time from a pose to the plant [s].
        sources: Source of each value, in words, by `period_s` and `dead_time_s`.
    """

    period_s: float
    dead_time_s: float
    sources: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopModel:
    """A declared loop as theory knows it.

    Attributes:
        loop: Loop as the law declares it.
        gains: None if the reason says why.
        process: Plant with all dead time; None if the reason says why.
        period_s: Sampling period T [s], None likewise.
        most_dead_time_s: Dead time that it may grow to [s]; None if it cannot grow.
        growth: Cause that may make the dead time longer, in words.
        ramp_s: By how much limits of the acceleration make the time constant longer in large steps
            [s], which recommended gains allow for.
        reason: Why theory does not know the loop; empty if it does.
        sources: Sources of the values, in words, by `gains`, `plant`, `period_s`, `dead_time_s`.
        left_out: Parts of the scenario that the linear loop leaves out, as `key = value`.
    """

    loop: ControlLoop
    gains: PidGains | None = None
    process: Process | None = None
    period_s: float | None = None
    most_dead_time_s: float | None = None
    growth: str = "queues"
    ramp_s: float = 0.0
    reason: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    def analyse(self) -> PidLoop:
        """Return what the loop does.

        Raises:
            TheoryError: If it is not known; the line is the reason.
        """
        gains, settings = self.require()
        return analyse_pid_loop(gains, **settings)

    def require(self) -> tuple[PidGains, Settings]:
        """Return gains, and period and process as theory's functions take them.

        Raises:
            TheoryError: If they are not known; the line is the reason.
        """
        if self.gains is None or self.process is None or self.period_s is None:
            raise TheoryError(f"{self.loop.name}: {self.reason}")
        return self.gains, {"period_s": self.period_s, "process": self.process}

    def require_slowest(self) -> Settings:
        """Return period and process for recommended gains: with the most delay that may be.

        Raises:
            TheoryError: If they are not known; the line is the reason.
        """
        _, settings = self.require()
        process, most_s = settings["process"], self.most_dead_time_s
        late_s = process.dead_time_s if most_s is None else most_s
        slow_s = process.lag_s + self.ramp_s
        settings["process"] = replace(process, dead_time_s=late_s, lag_s=slow_s)
        return settings


def model_loops(declaration: Declaration, parameters: Parameters) -> tuple[LoopModel, ...]:
    """Return the loops of a law under a scenario, one for each that it declares.

    Args:
        declaration: Declaration of the law.
        parameters: Parameters of the scenario, by dotted key.
    """
    return tuple(model_loop(loop, parameters) for loop in declaration.loops)


def model_loop(
    loop: ControlLoop,
    parameters: Parameters,
    *,
    timing: MeasuredTiming | str | None = None,
    sources: Mapping[str, str] | None = None,
) -> LoopModel:
    """Return one loop as theory knows it.

    Args:
        loop: Loop of a law.
        parameters: Parameters of a run or a scenario, by dotted key.
        timing: Measured timing, or the reason why there is none; None: that of the scenario.
        sources: Sources of gains and plant, if not the scenario.
    """
    told = {"gains": SCENARIO, "plant": SCENARIO, **(sources or {})}
    most_s: float | None = None
    if timing is None:
        scheduled = find_timing(parameters)
        if isinstance(scheduled, str):
            timing = scheduled
        else:
            from_scenario = {"period_s": SCENARIO, "dead_time_s": SCENARIO}
            period_s, least_s = scheduled.period_s, scheduled.least_s
            most_s = scheduled.most_s if scheduled.most_s > least_s else None
            timing = MeasuredTiming(period_s=period_s, dead_time_s=least_s, sources=from_scenario)
    dead_time_s = 0.0 if isinstance(timing, str) else timing.dead_time_s
    gains, process = read_gains(loop, parameters), read_process(loop, parameters, dead_time_s)
    reasons = [found for found in (gains, process, timing) if isinstance(found, str)]
    left_out = list_neglected(loop, parameters)
    if isinstance(gains, str) or isinstance(process, str) or isinstance(timing, str):
        return LoopModel(loop=loop, reason="; ".join(reasons), left_out=left_out)
    is_timed = parameters.get("loop.trigger") == "timer"
    found = LoopModel(
        loop=loop,
        gains=gains,
        process=process,
        period_s=timing.period_s,
        most_dead_time_s=None if most_s is None else most_s + process.dead_time_s - dead_time_s,
        growth="the age of the poses" if is_timed else "queues",
        ramp_s=find_ramp_s(loop, parameters),
        sources={**told, **timing.sources},
        left_out=left_out,
    )
    return _refuse_numbers(found)


def _refuse_numbers(model: LoopModel) -> LoopModel:
    """Return a model whose numbers theory takes, or one with the reason why it does not."""
    try:
        gains, settings = model.require()
        is_pid_stable(gains, **settings)
    except TheoryError as err:
        return LoopModel(loop=model.loop, reason=str(err), left_out=model.left_out)
    return model


def list_known(models: Sequence[LoopModel]) -> list[LoopModel]:
    """Return the models that theory knows."""
    return [model for model in models if not model.reason]
