"""The scenario of a run as identified from its log.

Sensing, disturbances, shaping, probabilities and rates are not identified: in poses and commands,
they look like one another or like identified settings. If the re-simulation of the recorded
scenario reproduces the run, its values are used.
"""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog.display import fit_line, format_html, format_notebook
from turtlelog.errors import ExplainError, ReplayError
from turtlelog.explain.causes import LOOP_CAUSES, PLANT_CAUSES
from turtlelog.explain.scenario_from_log.resimulation import RecordedScenario, Resimulation
from turtlelog.measure import DeadTime, Missing, find_dead_time
from turtlelog.measure.dead_time import LARGEST_TICKS
from turtlelog.replay import replay_plant
from turtlelog.run import CUT_SHORT, Run
from turtlelog.run.loops import PAUSE, RESERVED, ControlLoop
from turtlelog.run.stop_reasons import MAX_DURATION
from turtlelog.scenario import DEFAULT_LAW, Scenario, flatten_scenario


class Certainty(enum.StrEnum):
    """Confidence in a finding."""

    EXACT = "exact"
    """Only this value reproduces all rows that depend on it, bit for bit or within the poses'
    rounding."""
    FITTED = "fitted"
    """Estimated by least squares, with its standard error."""
    BOUNDED = "bounded"
    """Every value in an interval fits; the given value is the roundest."""
    AMBIGUOUS = "ambiguous"
    """Several values fit equally well. These values are the candidates; the given value is the most
    likely."""
    RECORDED = "as recorded"
    """Value of the recorded scenario, whose re-simulation reproduces every sample. The samples
    alone do not show this value."""
    UNKNOWN = "unknown"
    """The log does not determine the value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One identified value.

    Attributes:
        value: Value in the unit of its key; None exactly if `certainty` is UNKNOWN.
        certainty: Confidence in the value.
        evidence: Evidence for the value, or the reason why it is unknown, in one clause.
        interval: Bounds [low, high) of a bounded value.
        candidates: All values that fit, if there are several.
        assumed: Value that a re-simulation uses if the value is unknown and has no visible effect.
    """

    value: Any = None
    certainty: Certainty
    evidence: str
    interval: tuple[float, float] | None = None
    candidates: tuple[Any, ...] = ()
    assumed: Any = None

    @property
    def used(self) -> Any:
        """Value that a re-simulation uses: the identified value, otherwise the assumed one."""
        return self.assumed if self.value is None else self.value


def find_exactly(value: Any, evidence: str) -> Finding:
    """Return a finding with certainty `EXACT`."""
    return Finding(value=value, certainty=Certainty.EXACT, evidence=evidence)


def fit_value(value: Any, evidence: str, interval: tuple[Any, Any] | None = None) -> Finding:
    """Return a finding with its 95 % interval, or the most likely of the tried values."""
    return Finding(value=value, certainty=Certainty.FITTED, evidence=evidence, interval=interval)


def bound_value(value: Any, evidence: str, interval: tuple[float, float]) -> Finding:
    """Return a finding for which any value within an interval fits."""
    return Finding(value=value, certainty=Certainty.BOUNDED, evidence=evidence, interval=interval)


def take_recorded(value: Any, evidence: str) -> Finding:
    """Return a finding taken from the recorded scenario."""
    return Finding(value=value, certainty=Certainty.RECORDED, evidence=evidence)


def leave_open(candidates: Sequence[Any], evidence: str, likeliest: Any) -> Finding:
    """Return a finding with the most likely of several equally good values."""
    return Finding(
        value=likeliest,
        certainty=Certainty.AMBIGUOUS,
        evidence=evidence,
        candidates=tuple(candidates),
    )


def miss(
    evidence: str, assumed: Any = None, interval: tuple[float, float] | None = None
) -> Finding:
    """Return a finding without a value: its reason, assumed value, and bounds if known."""
    return Finding(
        certainty=Certainty.UNKNOWN, evidence=evidence, assumed=assumed, interval=interval
    )


LAW_KEYS: Final = (
    "law.kp_angular",
    "law.kp_linear",
    "limits.turn_rate_rad_s",
    "limits.speed_m_s",
    "law.heading_tolerance_rad",
    "law.position_tolerance_m",
    "law.projection",
    "law.wrap_error",
)
"""Parameters that the commands of sequential-p show. The other parameters are `law.pause_ticks`,
which a simulation shows, `RULE_KEYS` for the end of a run, and those with which the law is not
identified, by its declaration, a third phase or gains that change: `reorient` and `schedule`."""

LOOP_KEYS: Final = (
    "loop.start_backlog",
    "law.pause_ticks",
    "loop.queue_policy",
    "loop.command_queue",
    "loop.pose_queue",
    "loop.transport_delay_ticks",
    "loop.period_ticks",
)
"""Settings between controller and plant, found by simulation."""

DEAD_TIME: Final = "dead_time."
"""Prefix of the keys of dead times, followed by the name of a loop, or of a phase without loops."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """The scenario of a run as identified from its log.

    Attributes:
        name: Name of the run.
        findings: Findings by key of the scenario (`law.kp_linear`), and additionally `dead_time.`
            with the name of each loop or phase [ticks], `pause.seconds` [s],
            `pause.held_turn_rate_rad_s`, `pause.turned_rad`, `pause.burst` (poses answered at once
            after it), `stop_reason`, `lost_commands`.
        resimulation: Comparison of the log with a simulation of the identified scenario; None
            without a simulation.
        scenario: The identified or the recorded scenario. None if too little is known, or if the
            recorded scenario does not reproduce the run.
        is_recorded: Whether `scenario` is the recorded scenario, which reproduces every sample.
        law: Kind of the recorded law, or else of the law whose parameters are identified. Empty if
            the run names no law and has other loops.
        notes: Further notes, in sentences; without a scenario, the first is why there is none.
        tried: Values that were tried, by key of the loop's settings. Exact or fitted values are
            exact or fitted among these.
    """

    name: str
    findings: Mapping[str, Finding]
    resimulation: Resimulation | None
    scenario: Scenario | None
    is_recorded: bool = False
    law: str = DEFAULT_LAW
    notes: tuple[str, ...] = ()
    tried: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "findings", MappingProxyType({**self.findings}))

    @property
    def tells_law(self) -> bool:
        """Whether the parameters of the law can be identified from its commands."""
        return self.law == DEFAULT_LAW

    @property
    def obstacle(self) -> str:
        """Reason why there is no scenario, in one clause; empty if it is not known."""
        return next(iter(self.notes), "").rstrip(".")

    def build_scenario(self) -> Scenario:
        """Return the identified scenario. Unknown settings have their assumed values.

        Raises:
            ExplainError: If too little is known.
        """
        if self.scenario is None:
            reason = "; ".join(self.notes) or "too little is known"
            expected = f"a run of the law {DEFAULT_LAW}, or one that its own scenario reproduces"
            raise ExplainError(f"{self.name}: expected {expected}: {reason}")
        return self.scenario

    def __repr__(self) -> str:
        return fit_line(f"<Identification of {self._describe()}>")

    def _describe(self) -> str:
        unsure = (Certainty.UNKNOWN, Certainty.AMBIGUOUS)
        known = sum(found.certainty not in unsure for found in self.findings.values())
        return f"{self.name}: {known} of {len(self.findings)} values known"

    def _repr_html_(self) -> str:
        rows = [
            (key, found.value, found.certainty.value, found.evidence)
            for key, found in self.findings.items()
        ]
        heads = ("", "value", "confidence", "evidence")
        return format_notebook(self._describe(), format_html(rows, heads=heads))


def identify_plant(run: Run) -> Identification:
    """Return the largest commands and the number of lost ones, for a run without samples."""
    loops = [f"{DEAD_TIME}{loop.name}" for loop in run.declaration.loops]
    reason = "the recording holds no samples: which pose a command answers is not known"
    findings = dict.fromkeys((*LAW_KEYS, *loops), miss(reason))
    for key in ("speed_m_s", "turn_rate_rad_s"):
        command = getattr(run.commands, key)
        if len(command):
            seen = f"the largest of {len(command)} commands is {np.abs(command).max():.4g}"
            seen += "; without the error it is unknown whether it was clipped"
            findings[f"limits.{key}"] = miss(seen)
    if run.poses.speed_m_s is None:
        lost = miss("the poses hold no applied velocities, which would tell the commands that act")
    else:
        try:
            use = replay_plant(run).commands
            lost = find_exactly(use.unseen, f"no pose shows them; {use.taken} others are shown")
        except ReplayError as err:
            lost = miss(str(err))
    return give_up(run.name, {**findings, "lost_commands": lost}, reason)


def give_up(
    name: str, findings: Mapping[str, Finding], reason: str, breaks: Sequence[str] = ()
) -> Identification:
    """Return the findings on a run that cannot be simulated again, with the reason.

    Other findings of law and loop are unknown for this reason. `breaks` are sentences on the log's
    jumps and missing rows, which may be the cause.
    """
    keys = (*LAW_KEYS, *LOOP_KEYS, "stop_reason", "lost_commands")
    unknown = {key: miss(reason) for key in keys}
    return Identification(
        name=name,
        findings={**unknown, **findings},
        resimulation=None,
        scenario=None,
        notes=(*breaks, reason),
    )


_TABLES: Final = ("limits.", "loop.", "plant.", "sensing.", "shaping.", "disturbance.")

_USUAL: Final = frozenset(flatten_scenario(Scenario()))  # keys of every scenario

_NAMES: Final = {
    **{
        key: found.name
        for found in (*LOOP_CAUSES, *(one for causes in PLANT_CAUSES.values() for one in causes))
        for key in found.neutral
    },
    "loop.trigger": "a timer",
    "plant.kind": "another plant",
}
"""Names of the causes that keys belong to; keys that only extend another key have no name."""

_LOOKED_FOR: Final = (Certainty.EXACT, Certainty.FITTED, Certainty.BOUNDED)


def list_unseen(run: Run) -> list[str]:
    """Return the causes in a run's recorded scenario that cannot be identified."""
    keys = [key for key in run.parameters if key.startswith(_TABLES) and key not in _USUAL]
    return list(dict.fromkeys(_NAMES[key] for key in keys if key in _NAMES))


def take_findings(
    findings: Mapping[str, Finding], scenario: Scenario, evidence: str
) -> dict[str, Finding]:
    """Return findings with the settings of the recorded scenario, which reproduces the run.

    The settings of the loop are the recorded ones. The settings of the law are recorded ones if the
    samples do not show them, or show other values.
    """
    recorded = flatten_scenario(scenario)
    kept = {
        key: finding
        for key, finding in findings.items()
        if key in LAW_KEYS and _agrees(finding, recorded[key])
    }
    keys = [key for key in (*LAW_KEYS, *LOOP_KEYS) if key not in kept]
    taken = {key: take_recorded(recorded[key], evidence) for key in keys}
    return {**findings, **taken, **take_seconds(scenario)}


def take_seconds(scenario: Scenario) -> dict[str, Finding]:
    """Return the settings in ticks that the recorded scenario extends or replaces by seconds."""
    loop = scenario.loop
    found: dict[str, Finding] = {}
    if loop.transport_delay_s:
        more = f"and {loop.transport_delay_s:g} s more"
        found["loop.transport_delay_ticks"] = take_recorded(loop.transport_delay_ticks, more)
    if loop.period_s is not None:
        asks = f"a timer asks for answers, every {loop.period_s:g} s as recorded"
        found["loop.period_ticks"] = miss(asks, loop.period_ticks)
    return found


def _agrees(finding: Finding, value: object) -> bool:
    if finding.certainty not in _LOOKED_FOR:
        return False
    if finding.interval is not None and isinstance(value, float):
        low, high = finding.interval
        return bool(low <= value <= high)
    return bool(finding.value == value)


_COMMANDS: Final = (("turn_rate", "heading", "goal_bearing"), ("speed", "along_track", "zero"))
"""Possible commands in a phase without loops, with the signal and reference of each."""


def find_lag_slack(run: Run, dead_times: Mapping[str, DeadTime | Missing]) -> int:
    """Return the number of ticks of the dead times that may be a time constant of the robot.

    The loop with the clearest result decides, because commands of all loops wait equally long. A
    recorded scenario of turtlesim has no time constant.
    """
    if run.scenario_is_complete:
        return 0
    known = [one.lag_slack for one in dead_times.values() if isinstance(one, DeadTime)]
    return min(known, default=LARGEST_TICKS)


def find_dead_times(run: Run, loops: Sequence[str] = ()) -> dict[str, DeadTime | Missing]:
    """Return the dead time of some or all loops, if constant; of each phase if no loop is declared.

    In a phase without loops, it is that of the turn rate, or of the speed if the first is unknown.
    """
    declared, found = run.declaration, dict[str, DeadTime | Missing]()
    for name in loops or [loop.name for loop in declared.loops]:
        found[name] = find_dead_time(run, name)
    for phase in [one for one in declared.phases if one != PAUSE and not declared.loops]:
        name, tried = f"{phase}-loop" if phase in RESERVED else phase, list[DeadTime | Missing]()
        phases = {one: (name,) if one == phase else () for one in declared.phases}
        for command, signal, reference in _COMMANDS:
            loop = ControlLoop(name=name, signal=signal, command=command, reference=reference)
            driven = replace(run, declaration=replace(declared, loops=(loop,), phases=phases))
            tried.append(find_dead_time(driven, loop))
        found[phase] = next((one for one in tried if isinstance(one, DeadTime)), tried[0])
    return found


def describe_dead_times(
    dead_times: Mapping[str, DeadTime | Missing], motion: Run, run: Run
) -> dict[str, Finding]:
    """Return dead times as findings; `motion` is the run with its gaps spaced out."""
    findings = {}
    for name, found in dead_times.items():
        if isinstance(found, Missing):
            finding = miss(found.reason)
        elif found.is_exact:
            evidence = f"explains all {found.rows} steps to rounding"
            for change in found.changes:
                row = int(np.searchsorted(motion.poses.time_ns, change.time_ns))
                until_s = run.poses.time_ns[row] / 1e9
                evidence += f"; {change.before} until {until_s:.2f} s"
            finding = find_exactly(found.ticks, evidence)
        else:
            evidence = f"least squares; the next best leaves {found.margin:.3g} times"
            evidence += "; with a lag a shorter one fits as well" * bool(found.lag_slack)
            interval = (found.ticks - found.lag_slack, found.ticks)
            finding = fit_value(found.ticks, evidence, interval)
        findings[f"{DEAD_TIME}{name}"] = finding
    return findings


def find_command_limits(run: Run) -> dict[str, Finding]:
    """Return the limits at which commands are clipped, as the unclipped commands show."""
    samples, found = run.samples, dict[str, Finding]()
    for key, wanted, sent in (
        ("limits.speed_m_s", samples.wanted_speed_m_s, samples.speed_m_s),
        ("limits.turn_rate_rad_s", samples.wanted_turn_rate_rad_s, samples.turn_rate_rad_s),
    ):
        largest = float(np.abs(sent).max())
        seen = f"the largest of {len(sent)} commands is {largest:.4g}"
        clipped = 0 if wanted is None else int((wanted != sent).sum())
        if wanted is None:
            found[key] = miss(f"{seen}; unclipped commands are not logged")
        elif not clipped:
            found[key] = miss(f"no command is clipped; {seen}")
        elif not np.array_equal(np.clip(wanted, -largest, largest), sent):
            reason = "no single limit clips the unclipped commands to those sent"
            found[key] = miss(f"{reason}; {seen}")
        else:
            found[key] = find_exactly(largest, f"{clipped} of {len(sent)} commands are there")
    return found


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


def list_candidates(findings: Mapping[str, Finding]) -> list[str]:
    """Return sentences on the keys of which several values fit equally well."""
    return [
        f"of {key} the values {', '.join(map(str, finding.candidates))} fit alike:"
        f" {finding.evidence}"
        for key, finding in findings.items()
        if finding.certainty is Certainty.AMBIGUOUS
    ]
