"""From a log to the scenario that made it."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog.errors import ScenarioError, SimulationError
from turtlelog.explain.ending import find_pause, find_stop_reason
from turtlelog.explain.finding import Certainty, Finding, find_exactly, miss
from turtlelog.explain.identification import Identification, disclaim_law, give_up
from turtlelog.explain.law import identify_rotation, identify_translation
from turtlelog.explain.loop import read_hints
from turtlelog.explain.plant import identify_plant
from turtlelog.explain.resimulation import Resimulation, compare_samples, cut_where_logged
from turtlelog.explain.search import Fits, search_loop
from turtlelog.explain.settings import describe_loop
from turtlelog.explain.start import identify_start
from turtlelog.explain.trace import Trace, find_gaps, trace_run
from turtlelog.measure import DeadTime, Missing, find_dead_time
from turtlelog.run import Phase, Run
from turtlelog.simulate import simulate_run

_LAW: Final = "sequential-p"

_LOOPS: Final = {"law.kp_angular": "dead_time.rotate", "law.kp_linear": "dead_time.translate"}
"""Gains, and where the motion that the loop's commands make is judged."""

_LONGEST_S: Final = 3600.0

_SHOW_NOISE: Final = ("start.heading_rad", "start.x_m", "law.kp_angular", "law.kp_linear")
"""What is fitted by least squares only where there is noise."""


def identify_run(run: Run) -> Identification:
    """Identify the scenario of a run from its samples alone: pose read, command published, time.

    The run's own parameters are not read. Gains, limits and tolerances come from the commands; the
    queues and the pause from the dead times and the time stamps, and from simulating every setting
    that agrees with them: those that reproduce all samples are what fits.
    A run without samples tells next to nothing, and the findings say why.
    """
    if not len(run.samples):
        return identify_plant(run)
    # Commands of any size are read; those whose squares overflow fit nothing.
    with np.errstate(over="ignore", invalid="ignore"):
        return _identify_samples(run)


def _identify_samples(run: Run) -> Identification:
    trace = trace_run(run)
    dead_times = {phase: find_dead_time(run, phase) for phase in (Phase.ROTATE, Phase.TRANSLATE)}
    findings = {
        f"dead_time.{phase.label}": _describe_dead_time(found)
        for phase, found in dead_times.items()
    }
    findings |= identify_start(trace, findings["dead_time.rotate"].value or 0)
    other_law = _find_other_law(run)
    if other_law:
        return give_up(run.name, disclaim_law(findings, other_law), other_law)
    findings |= identify_rotation(trace)
    findings |= identify_translation(trace)
    contradiction = _contradict_law(trace, findings)
    if contradiction:
        return give_up(run.name, disclaim_law(findings, contradiction), contradiction)
    obstacle = _find_obstacle(trace)
    if obstacle:
        return give_up(run.name, findings, obstacle)
    hints = read_hints(trace)
    try:
        fits = search_loop(trace, _collect(findings), hints, dead_times)
    except (ScenarioError, SimulationError) as err:
        return give_up(run.name, findings, f"it cannot be simulated again: {err}")
    is_noisy = any(findings[key].certainty is Certainty.FITTED for key in _SHOW_NOISE)
    findings |= describe_loop(trace, fits, is_noisy=is_noisy)
    if not fits.is_exact and findings["loop.pose_precision"].value == "float64":
        reason = "poses have more than 32 bits, which noise may have added"
        findings["loop.pose_precision"] = miss(reason, "float64")
    findings |= find_pause(trace, hints)
    findings["stop_reason"] = find_stop_reason(trace)
    scenario = fits.scenario
    if not fits.is_exact and findings["stop_reason"].value in {None, "cut"}:
        scenario = cut_where_logged(scenario, trace)
    gaps = _describe_gaps(trace)
    if not (fits.is_exact or is_noisy or gaps):
        findings = disclaim_law(findings, "no setting of the loop reproduces the samples")
    resimulation = compare_samples(trace, simulate_run(scenario))
    return Identification(
        name=run.name,
        findings=MappingProxyType(findings),
        resimulation=resimulation,
        scenario=scenario,
        notes=(
            *gaps,
            *_describe_difference(fits, resimulation, is_noisy=is_noisy),
            *_list_candidates(findings),
        ),
    )


def _describe_dead_time(found: DeadTime | Missing) -> Finding:
    if isinstance(found, Missing):
        return miss(found.reason)
    changed = "".join(
        f"; {change.before} until {change.time_ns / 1e9:.2f} s" for change in found.changes
    )
    if found.is_exact:
        return find_exactly(found.ticks, f"explains all {found.rows} steps to rounding{changed}")
    return Finding(
        value=found.ticks,
        certainty=Certainty.FITTED,
        evidence=f"least squares; the next best leaves {found.margin:.3g} times",
    )


def _find_other_law(run: Run) -> str | None:
    kind = run.parameters.get("law.kind", _LAW)
    if kind == _LAW:
        return None
    return f"its law is {kind}: only of {_LAW} the commands tell the parameters"


def _contradict_law(trace: Trace, findings: Mapping[str, Finding]) -> str | None:
    """Return why the samples are not those of the sequential law."""
    if trace.rotating + trace.translating < len(trace):
        return _list_phases(trace)
    for key, dead_time in _LOOPS.items():
        if "not proportional" in findings[key].evidence:
            return f"{key}: {findings[key].evidence}"
        # Without a rotation the start is unknown, and with it the bearing that the law projects on.
        poses_are_clean = (
            trace.rotating > 0
            and findings[dead_time].certainty is Certainty.EXACT
            and findings["loop.pose_precision"].value == "float32"
        )
        if poses_are_clean and findings[key].certainty is Certainty.FITTED:
            return f"{key}: the poses hold no noise, and no gain reproduces the commands"
    if trace.speed_m_s[: trace.rotating].any() or trace.turn_rate_rad_s[trace.rotating :].any():
        return "it drives while rotating, or turns while translating"
    return None


def _find_obstacle(trace: Trace) -> str | None:
    """Return why a run of the sequential law cannot be simulated."""
    if not trace.rotating:
        return _list_phases(trace)
    if trace.goal_xy_m is None:
        return "the log does not hold the goal"
    length_s = float(trace.run.end_ns - trace.run.poses.time_ns[0]) / 1e9
    if length_s > _LONGEST_S:
        return f"it lasts {length_s:.0f} s; up to {_LONGEST_S:.0f} s are simulated again"
    return None


def _list_phases(trace: Trace) -> str:
    phases = {Phase(phase) for phase in np.unique(trace.run.samples.phase).tolist()}
    listed = ", ".join(sorted(phase.label for phase in phases))
    return f"its phases are not one rotation and one translation: {listed}"


def _collect(findings: Mapping[str, Finding]) -> dict[str, Any]:
    """Return the values to simulate with, by key of the scenario."""
    tables = ("start.", "goal.", "law.", "limits.", "loop.")
    return {key: finding.used for key, finding in findings.items() if key.startswith(tables)}


def _describe_gaps(trace: Trace) -> list[str]:
    gaps = find_gaps(trace)
    if not gaps:
        return []
    start_ns, end_ns = gaps[0]
    at_s, length_s = (start_ns - trace.run.start_ns) / 1e9, (end_ns - start_ns) / 1e9
    more = f", and {len(gaps) - 1} more" if len(gaps) > 1 else ""
    return [f"samples are missing after {at_s:.3f} s, for {length_s:.3f} s{more}"]


def _describe_difference(fits: Fits, resimulation: Resimulation, *, is_noisy: bool) -> list[str]:
    if fits.is_exact:
        return (
            []
            if resimulation.is_exact
            else ["the re-simulation agrees to rounding, not bit for bit"]
        )
    if resimulation.is_exact:
        return ["poses and commands come again, but not the times at which they were answered"]
    cause = "noise" if is_noisy else "gaps"
    return [f"the re-simulation is not exact: the log has {cause}, or an effect not simulated"]


def _list_candidates(findings: Mapping[str, Finding]) -> list[str]:
    return [
        f"{key}: {', '.join(map(str, finding.candidates))} fit alike: {finding.evidence}"
        for key, finding in findings.items()
        if finding.certainty is Certainty.AMBIGUOUS
    ]
