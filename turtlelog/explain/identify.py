"""From a log to the scenario that made it."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog.errors import ExplainError, ReplayError
from turtlelog.explain.ending import find_pause, find_stop_reason
from turtlelog.explain.finding import Certainty, Finding, find_exactly, miss
from turtlelog.explain.law import identify_rotation, identify_translation
from turtlelog.explain.loop import read_hints
from turtlelog.explain.resimulation import Resimulation, compare_samples, count_lost_commands
from turtlelog.explain.search import Fits, search_loop
from turtlelog.explain.trace import Trace, trace_run
from turtlelog.measure import DeadTime, Missing, find_dead_time
from turtlelog.replay import replay_plant
from turtlelog.run import Phase, Run
from turtlelog.scenario import Scenario
from turtlelog.simulate import simulate_run

_LAW_KEYS: Final = (
    "law.kp_angular",
    "law.kp_linear",
    "limits.turn_rate_rad_s",
    "limits.speed_m_s",
    "law.heading_tolerance_rad",
    "law.position_tolerance_m",
    "law.projection",
    "law.wrap_error",
)

LOOP_KEYS: Final = (
    "loop.start_backlog",
    "law.pause_ticks",
    "loop.queue_policy",
    "loop.command_queue",
    "loop.pose_queue",
    "loop.transport_delay_ticks",
    "loop.period_ticks",
)
"""What lies between controller and plant, decided by simulating again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """What a log says of the scenario that made it.

    Attributes:
        name: Of the run.
        findings: By key of the scenario (`law.kp_linear`), and beside it `dead_time.rotate`,
            `dead_time.translate` [ticks], `pause.seconds` [s], `pause.held_turn_rate_rad_s`,
            `pause.turned_rad`, `pause.burst` (poses answered at once after it), `stop_reason`,
            `lost_commands`.
        resimulation: The identified scenario, simulated again and compared; None where there is
            none.
        scenario: The identified scenario; None where too little is known for one.
        notes: What else is worth a sentence.
    """

    name: str
    findings: Mapping[str, Finding]
    resimulation: Resimulation | None
    scenario: Scenario | None
    notes: tuple[str, ...] = ()

    def build_scenario(self) -> Scenario:
        """Return the identified scenario; what does not show has the value that was assumed.

        Raises:
            ExplainError: Where too little is known.
        """
        if self.scenario is None:
            reason = "; ".join(self.notes) or "too little is known"
            raise ExplainError(f"{self.name}: expected a run of the sequential law: {reason}")
        return self.scenario


def identify_run(run: Run) -> Identification:
    """Identify the scenario of a run from its samples alone: pose read, command published, time.

    The run's own parameters are not read. Gains, limits and tolerances come from the commands; the
    queues and the pause from the dead times and the time stamps, and from simulating every setting
    that agrees with them: those that reproduce all samples are what fits.
    A run without samples tells next to nothing, and the findings say why.
    """
    if not len(run.samples):
        return _identify_plant(run)
    trace = trace_run(run)
    dead_times = {phase: find_dead_time(run, phase) for phase in (Phase.ROTATE, Phase.TRANSLATE)}
    findings = {
        f"dead_time.{phase.label}": _describe_dead_time(found)
        for phase, found in dead_times.items()
    }
    findings |= _identify_start(trace, findings["dead_time.rotate"].value or 0)
    findings |= identify_rotation(trace)
    findings |= identify_translation(trace)
    obstacle = _find_obstacle(trace, findings)
    if obstacle:
        return _give_up(trace, findings, obstacle)
    hints = read_hints(trace)
    fits = search_loop(trace, _collect(findings), hints, dead_times)
    findings |= _describe_loop(trace, fits)
    if not fits.is_exact and findings["loop.pose_precision"].value == "float64":
        reason = "poses have more than 32 bits, which noise may have added"
        findings["loop.pose_precision"] = miss(reason, "float64")
    findings |= find_pause(trace, hints)
    findings["stop_reason"] = find_stop_reason(trace)
    resimulation = compare_samples(trace, simulate_run(fits.scenario))
    findings["lost_commands"] = _describe_lost(fits)
    return Identification(
        name=run.name,
        findings=MappingProxyType(findings),
        resimulation=resimulation,
        scenario=fits.scenario,
        notes=tuple(_write_notes(findings, fits, resimulation)),
    )


def _identify_plant(run: Run) -> Identification:
    """Say what poses and commands tell where no sample says which pose a command answers."""
    reason = "the recording holds no samples: which pose a command answers is not known"
    keys = (*_LAW_KEYS, *LOOP_KEYS, "dead_time.rotate", "dead_time.translate", "stop_reason")
    findings = dict.fromkeys(keys, miss(reason))
    largest = {
        "limits.speed_m_s": run.commands.speed_m_s,
        "limits.turn_rate_rad_s": run.commands.turn_rate_rad_s,
    }
    for key, command in largest.items():
        if len(command):
            seen = f"the largest of {len(command)} commands is {np.abs(command).max():.4g}"
            findings[key] = miss(f"{seen}; without the error nobody knows if it was clipped")
    try:
        use = replay_plant(run).commands
        findings["lost_commands"] = find_exactly(
            use.unseen, f"no pose shows them; {use.taken} others are shown"
        )
    except ReplayError as err:
        findings["lost_commands"] = miss(str(err))
    return Identification(
        name=run.name,
        findings=MappingProxyType(findings),
        resimulation=None,
        scenario=None,
        notes=(reason,),
    )


def _identify_start(trace: Trace, dead_time_ticks: int) -> dict[str, Finding]:
    poses = trace.run.poses
    values = np.column_stack([poses.xy_m, poses.heading_rad])
    single = bool((values == values.astype(np.float32)).all())
    precision = "float32" if single else "float64"
    goal = trace.goal_xy_m or (None, None)
    goal_evidence = "as logged" if trace.run.goal_xy_m else "position plus error, as logged"
    return {
        **_find_start(trace, dead_time_ticks),
        **{
            f"goal.{axis}_m": miss("the log does not hold the goal")
            if value is None
            else find_exactly(value, goal_evidence)
            for axis, value in zip("xy", goal, strict=True)
        },
        "loop.pose_precision": find_exactly(
            precision,
            "every pose is a 32-bit float" if single else "poses have more than 32 bits",
        ),
    }


def _find_start(trace: Trace, dead_time_ticks: int) -> dict[str, Finding]:
    """Return the first pose read, or the mean of those before the first command acts."""
    standing = slice(0, dead_time_ticks // trace.period_ticks + 1)
    poses = np.column_stack([trace.xy_m, trace.heading_rad])[standing]
    names = ("start.x_m", "start.y_m", "start.heading_rad")
    if (poses == poses[0]).all():
        found = poses[0].tolist()
        return {
            name: find_exactly(value, "first pose read")
            for name, value in zip(names, found, strict=True)
        }
    evidence = f"mean of {len(poses)} poses before the first command acts"
    return {
        name: Finding(value=value, certainty=Certainty.FITTED, evidence=evidence)
        for name, value in zip(names, poses.mean(axis=0).tolist(), strict=True)
    }


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


def _find_obstacle(trace: Trace, findings: Mapping[str, Finding]) -> str | None:
    """Return why this is no run of the sequential law, or cannot be simulated."""
    phases = {Phase(phase) for phase in np.unique(trace.run.samples.phase).tolist()}
    if trace.rotating + trace.translating < len(trace) or not trace.rotating:
        listed = ", ".join(sorted(phase.label for phase in phases))
        return f"its phases are not one rotation and one translation: {listed}"
    for key in ("law.kp_angular", "law.kp_linear"):
        if "not proportional" in findings[key].evidence:
            return f"{key}: {findings[key].evidence}"
    if trace.goal_xy_m is None:
        return "the log does not hold the goal"
    return None


def _give_up(trace: Trace, findings: dict[str, Finding], reason: str) -> Identification:
    unknown = {key: miss(reason) for key in (*LOOP_KEYS, "stop_reason", "lost_commands")}
    return Identification(
        name=trace.run.name,
        findings=MappingProxyType({**findings, **unknown}),
        resimulation=None,
        scenario=None,
        notes=(reason,),
    )


def _collect(findings: Mapping[str, Finding]) -> dict[str, Any]:
    """Return the values to simulate with, by key of the scenario."""
    tables = ("start.", "goal.", "law.", "limits.", "loop.")
    return {key: finding.used for key, finding in findings.items() if key.startswith(tables)}


def _describe_loop(trace: Trace, fits: Fits) -> dict[str, Finding]:
    findings = {key: _describe_setting(trace, fits, key) for key in LOOP_KEYS}
    if not trace.shows_pause:
        assumed = fits.guesses[0]["law.pause_ticks"]
        seen = f": at least {assumed - 1} ticks" if assumed else ""
        findings["law.pause_ticks"] = miss(f"the log does not show the end of it{seen}", assumed)
    return findings


def _describe_setting(trace: Trace, fits: Fits, key: str) -> Finding:
    values, chosen = fits.list_values(key), fits.guesses[0][key]
    if key in fits.hidden:
        return miss("a deeper queue gives the same run", chosen)
    if key == "loop.period_ticks":
        return find_exactly(chosen, "the usual distance of the poses answered")
    if len(values) > 1:
        how = "reproduces every sample" if fits.is_exact else "leaves as little as the others"
        return Finding(
            value=chosen,
            certainty=Certainty.AMBIGUOUS,
            evidence=f"each {how}",
            candidates=values,
        )
    if fits.is_exact:
        return find_exactly(chosen, f"reproduces all {len(trace)} samples")
    return Finding(
        value=chosen,
        certainty=Certainty.FITTED,
        evidence=f"likeliest of {fits.tried} settings; none is exact",
    )


def _describe_lost(fits: Fits) -> Finding:
    if not fits.is_exact:
        return miss("no setting reproduces every sample")
    counts = sorted({count_lost_commands(scenario) for scenario in fits.scenarios})
    if len(counts) > 1:
        return Finding(
            value=count_lost_commands(fits.scenario),
            certainty=Certainty.AMBIGUOUS,
            evidence="the settings that fit lose different numbers",
            candidates=tuple(counts),
        )
    return find_exactly(counts[0], "the re-simulation's plant never takes them")


def _write_notes(
    findings: Mapping[str, Finding], fits: Fits, resimulation: Resimulation
) -> list[str]:
    notes = []
    if fits.is_exact and not resimulation.is_exact:
        notes.append("the re-simulation agrees to rounding, not bit for bit")
    elif not resimulation.is_exact:
        notes.append(
            "the re-simulation is not exact: the log has noise, or an effect that is not simulated"
        )
    for key, finding in findings.items():
        if finding.certainty is Certainty.AMBIGUOUS:
            listed = ", ".join(map(str, finding.candidates))
            notes.append(f"{key}: {listed} fit alike: {finding.evidence}")
    return notes
