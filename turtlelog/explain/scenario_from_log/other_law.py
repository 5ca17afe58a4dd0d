"""Facts about the loop from samples of any law.

Dead times, limits and queues come from poses, commands and the clock.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog.explain.scenario_from_log.driven_plant import WHITE
from turtlelog.explain.scenario_from_log.identification import (
    DEAD_TIME,
    LAW_KEYS,
    LOOP_KEYS,
    Finding,
    Identification,
    find_exactly,
    fit_value,
    miss,
    take_seconds,
)
from turtlelog.explain.scenario_from_log.loop_settings import (
    describe_goal,
    describe_loop,
    describe_start,
    read_hints,
)
from turtlelog.explain.scenario_from_log.resimulation import (
    NOT_DETERMINISTIC,
    RecordedScenario,
    check_recorded_scenario,
)
from turtlelog.explain.scenario_from_log.setting_search import Fits, drive_loop, search_loop
from turtlelog.explain.scenario_from_log.trace import (
    Trace,
    Values,
    describe_trace_breaks,
    mark_breaks,
    space_out,
    trace_run,
)
from turtlelog.laws import LAWS
from turtlelog.measure import DeadTime, Missing, Status, find_dead_time
from turtlelog.measure.dead_time import LARGEST_TICKS, shows_lag
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.run import CUT_SHORT, Run
from turtlelog.run.loops import PAUSE, RESERVED, ControlLoop
from turtlelog.run.stop_reasons import MAX_DURATION
from turtlelog.scenario import flatten_scenario

_COMMANDS: Final = (("turn_rate", "heading", "goal_bearing"), ("speed", "along_track", "zero"))
"""Possible commands in a phase without loops, with the signal and reference of each."""

AROUND: Final = "a loop is identified from commands only around turtlesim"

_UNSURE: Final = Missing(status=Status.UNDETERMINED, reason="not every step is explained")


def identify_other_law(run: Run, reason: str, *, trust_law: bool) -> Identification:
    """Return facts about the loop around a law whose parameters, for a reason, are unknown."""
    kind = str(run.parameters.get("law.kind", ""))
    trace = mark_breaks(trace_run(run))
    motion = space_out(trace)
    dead_times = {name: require_noise(one) for name, one in find_dead_times(motion).items()}
    recorded = _check_if_allowed(run, trace, kind, trust_law=trust_law)
    fits, plant = None, find_plant(run).name
    around = reason if plant == TURTLESIM.name else f"its plant is {plant}: {AROUND}"
    if plant == TURTLESIM.name:  # only its motion shows the loop around it
        fits = reject_lag(_fit_loop(trace, recorded, [*dead_times.values()]), dead_times)
        if recorded.scenario is not None and fits.is_driven:
            recorded = RecordedScenario(reach=NOT_DETERMINISTIC)
    findings = {
        **{key: miss(reason) for key in LAW_KEYS},
        **{key: miss(around) for key in (*LOOP_KEYS, "lost_commands")},
        **{
            f"{DEAD_TIME}{name}": describe_dead_time(found, motion, run)
            for name, found in dead_times.items()
        },
        **describe_goal(trace),
        **_describe_limits(run),
        **({} if fits is None else _describe_fits(trace, fits, find_lag_slack(run, dead_times))),
        **({} if recorded.scenario is None else take_seconds(recorded.scenario)),
        "stop_reason": describe_stop_rule(run, recorded),
    }
    return Identification(
        name=run.name,
        findings=MappingProxyType(findings),
        resimulation=recorded.resimulation,
        scenario=recorded.scenario,
        is_recorded=recorded.scenario is not None,
        law=kind,
        tried={} if fits is None else fits.ranges,
        notes=(
            *describe_trace_breaks(trace),
            *dict.fromkeys(filter(None, (reason, around, recorded.reach))),
        ),
    )


def _describe_fits(trace: Trace, fits: Fits, lag_slack: int) -> dict[str, Finding]:
    precision = describe_start(trace, fits)["loop.pose_precision"]
    return {**describe_loop(trace, fits, lag_slack), "loop.pose_precision": precision}


def _check_if_allowed(run: Run, trace: Trace, kind: str, *, trust_law: bool) -> RecordedScenario:
    if not run.scenario_is_complete:
        return RecordedScenario(reach="")
    if not trust_law and kind not in LAWS:
        return RecordedScenario(
            reach="the recorded scenario is not tested, as the code of its law is not trusted"
        )
    return check_recorded_scenario(run, trace, trust_law=trust_law)


def _fit_loop(
    trace: Trace, recorded: RecordedScenario, dead_times: Sequence[DeadTime | Missing]
) -> Fits:
    """Return the settings that reproduce the log, with its law if known, else without a law."""
    hints = replace(read_hints(trace), pauses=())
    scenario = recorded.scenario
    if scenario is not None:
        known = flatten_scenario(scenario)
        # Only a fit that explains every step rules out other settings.
        sure = [
            one if isinstance(one, DeadTime) and one.is_exact else _UNSURE for one in dead_times
        ]
        fits = search_loop(
            trace,
            {key: known[key] for key in known if key not in {"name", "max_duration_s"}},
            hints,
            sure,
            recorded={key: known[key] for key in LOOP_KEYS if key.startswith("loop.")},
        )
        if fits.is_exact or fits.is_close:
            return fits
    return drive_loop(trace, hints, dead_times)


def require_noise(found: DeadTime | Missing) -> DeadTime | Missing:
    """Return a dead time, or no value if its residual is not noise: then it is not constant.

    This happens if a law blocks sometimes: commands then wait for the duration of the block.
    """
    if isinstance(found, Missing) or abs(found.whiteness - 1.0) < WHITE:
        return found
    reason = f"no single dead time explains the motion; {found.ticks} ticks are the nearest"
    return Missing(status=Status.UNDETERMINED, reason=reason)


def find_lag_slack(run: Run, dead_times: Mapping[str, DeadTime | Missing]) -> int:
    """Return the number of ticks of the dead times that may be a time constant of the robot.

    The loop with the clearest result decides, because commands of all loops wait equally long. A
    recorded scenario of turtlesim has no time constant.
    """
    if run.scenario_is_complete:
        return 0
    known = [one.lag_slack for one in dead_times.values() if isinstance(one, DeadTime)]
    return min(known, default=LARGEST_TICKS)


def reject_lag(fits: Fits, dead_times: Mapping[str, DeadTime | Missing]) -> Fits:
    """Return settings without an explained motion if the robot clearly has a time constant."""
    if fits.drive is None or not any(map(shows_lag, dead_times.values())):
        return fits
    return replace(fits, drive=replace(fits.drive, explains=False))


def find_dead_times(run: Run) -> dict[str, DeadTime | Missing]:
    """Return the dead time of each loop; of each phase if the law declares no loops."""
    loops = run.declaration.loops
    if loops:
        return {loop.name: find_dead_time(run, loop) for loop in loops}
    names = [name for name in run.declaration.phases if name != PAUSE]
    return {phase: _find_dead_time_of_phase(run, phase) for phase in names}


def _find_dead_time_of_phase(run: Run, phase: str) -> DeadTime | Missing:
    """Return the dead time of the turn rate in a phase, or of the speed if the first is unknown."""
    name = f"{phase}-loop" if phase in RESERVED else phase
    found: list[DeadTime | Missing] = []
    for command, signal, reference in _COMMANDS:
        loop = ControlLoop(name=name, signal=signal, command=command, reference=reference)
        phases = {one: (name,) if one == phase else () for one in run.declaration.phases}
        declaration = replace(run.declaration, loops=(loop,), phases=phases)
        found.append(find_dead_time(replace(run, declaration=declaration), loop))
    return next((one for one in found if isinstance(one, DeadTime)), found[0])


def describe_dead_time(found: DeadTime | Missing, motion: Run, run: Run) -> Finding:
    """Return a dead time as a finding; `motion` is the run with its gaps spaced out."""
    if isinstance(found, Missing):
        return miss(found.reason)
    changed = ""
    for change in found.changes:
        row = int(np.searchsorted(motion.poses.time_ns, change.time_ns))
        changed += f"; {change.before} until {run.poses.time_ns[row] / 1e9:.2f} s"
    if found.is_exact:
        return find_exactly(found.ticks, f"explains all {found.rows} steps to rounding{changed}")
    evidence = f"least squares; the next best leaves {found.margin:.3g} times"
    if found.lag_slack:
        evidence += "; with a lag a shorter one fits as well"
    return fit_value(found.ticks, evidence, (found.ticks - found.lag_slack, found.ticks))


def _describe_limits(run: Run) -> dict[str, Finding]:
    samples = run.samples
    sides: dict[str, tuple[Values | None, Values]] = {
        "limits.speed_m_s": (samples.wanted_speed_m_s, samples.speed_m_s),
        "limits.turn_rate_rad_s": (samples.wanted_turn_rate_rad_s, samples.turn_rate_rad_s),
    }
    return {key: _describe_limit(*columns) for key, columns in sides.items()}


def _describe_limit(wanted: Values | None, sent: Values) -> Finding:
    """Return the limit at which commands are clipped, as the unclipped commands show."""
    largest = float(np.abs(sent).max())
    seen = f"the largest of {len(sent)} commands is {largest:.4g}"
    if wanted is None:
        return miss(f"{seen}; unclipped commands are not logged")
    clipped = wanted != sent
    if not clipped.any():
        return miss(f"no command is clipped; {seen}")
    if not np.array_equal(np.clip(wanted, -largest, largest), sent):
        return miss(f"no single limit clips the unclipped commands to those sent; {seen}")
    return find_exactly(largest, f"{int(clipped.sum())} of {len(sent)} commands are there")


def describe_stop_rule(run: Run, recorded: RecordedScenario) -> Finding:
    """Return the rule that ended the run, as recorded and as simulated again."""
    if run.stop_reason == MAX_DURATION:
        return find_exactly(MAX_DURATION, "as recorded: no rule of the law had ended the run")
    again: Any = None if recorded.run is None else recorded.run.stop_reason
    if again is None:
        return miss("only a re-simulation shows which rule of the law ended the run")
    if run.stop_reason is None or run.stop_reason in CUT_SHORT:
        return miss("the run was cut")
    if again != run.stop_reason:
        return miss(f"recorded {run.stop_reason}, simulated again {again}")
    return find_exactly(again, "as recorded; the re-simulation ends so as well")
