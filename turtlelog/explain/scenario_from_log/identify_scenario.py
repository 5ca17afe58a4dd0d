"""Identification of the scenario that produced a log.

Commands show the parameters of sequential-p. For any other law, only facts about the loop are
found: dead times, limits and queues, from poses, commands and the clock.
"""

from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from turtlelog.display import join_words
from turtlelog.errors import ScenarioError, SimulationError
from turtlelog.explain.scenario_from_log import (
    DEAD_TIME,
    LAW_KEYS,
    LOOP_KEYS,
    Certainty,
    Finding,
    Identification,
    describe_dead_times,
    describe_stop_rule,
    find_command_limits,
    find_dead_times,
    find_lag_slack,
    fit_value,
    give_up,
    identify_plant,
    law_identification,
    list_candidates,
    list_unseen,
    loop_settings,
    miss,
    take_findings,
    take_recorded,
    take_seconds,
)
from turtlelog.explain.scenario_from_log.gain_fit import CommandFit
from turtlelog.explain.scenario_from_log.law_identification import PHASES, RULE_KEYS
from turtlelog.explain.scenario_from_log.resimulation import (
    LONGEST_S,
    NOT_DETERMINISTIC,
    RecordedScenario,
    check_recorded_scenario,
    compare_samples,
    cut_where_logged,
    describe_difference,
)
from turtlelog.explain.scenario_from_log.setting_search import Fits, drive_loop, search_loop
from turtlelog.explain.scenario_from_log.trace import (
    Trace,
    describe_trace_breaks,
    mark_breaks,
    space_out,
    trace_run,
)
from turtlelog.laws import LAWS
from turtlelog.measure import DeadTime, Missing, Status, find_dead_time
from turtlelog.measure.dead_time import LagInstead
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.run import Run, require_run, slice_run
from turtlelog.scenario import DEFAULT_LAW, flatten_scenario, override_scenario
from turtlelog.simulate import simulate_run

_MOST_PHASES: Final = 6  # largest number of listed phases: three runs in one file

_BEGINNING_S: Final = 600.0
"""Length of the used beginning of a run that is too long to simulate [s]: forty times one of the
paper's runs, and some ten seconds of work."""

_SLOWEST_S: Final = 4.0
"""Longest time between samples [s]: 250 ticks of turtlesim, some 25 times as slow as any known
loop. With fewer samples, each of several hundred settings needs a longer simulation to differ from
the others."""

_MOST_ALIKE: Final = 8
"""Largest number of equally good settings that are simulated again for their dead times: a second
of work."""


def identify_run(run: Run, *, trust_law: bool = False) -> Identification:
    """Identify the scenario of a run from its samples alone: poses read, commands published, times.

    From the run's parameters, only the law's name and the plant are read. No parameter is
    identified for a law other than sequential-p or a plant other than turtlesim. Gains, limits and
    tolerances come from the commands. Queues and pause come from dead times and time stamps: every
    setting that agrees with these is simulated, and the settings that reproduce all samples are
    kept. If no setting does, the plant is driven with the log's commands, and settings that fit
    within the noise are marked as fitted. A run without samples gives almost no findings; the
    findings contain the reason. If a run is too long to simulate again, only its beginning is used,
    and no scenario reproduces the run.

    A recorded scenario is a hypothesis, which its re-simulation tests. For another law, the
    recorded scenario is accepted if it reproduces every sample. For sequential-p, it is also
    required that the identified scenario does not reproduce the run, or that the recorded scenario
    contains effects that cannot be identified.

    Args:
        run: Any run.
        trust_law: Whether to run the code of a recorded law that is not built in. Otherwise the
            scenario of such a run is not tested.

    Raises:
        ScenarioError: If a trusted law cannot be loaded, or a parameter is wrong.
    """
    require_run(run)
    if not len(run.samples):
        return identify_plant(run)
    length_s = float(run.end_ns - run.poses.time_ns[0]) / 1e9
    if length_s > LONGEST_S:
        return _identify_beginning(run, length_s, trust_law=trust_law)
    # Commands may have any size; those whose squares overflow fit no law.
    with np.errstate(over="ignore", invalid="ignore"):
        reason = _find_other_law(run)
        if reason:
            return _identify_other_law(run, reason, trust_law=trust_law)
        trace, plant = mark_breaks(trace_run(run, PHASES)), find_plant(run).name
        recorded = _identify_recorded(trace)
        if recorded is None and plant != TURTLESIM.name:
            return _identify_other_law(run, f"its plant is {plant}: {_AROUND}", trust_law=trust_law)
        return recorded or _prefer_recorded(trace, _identify_samples(trace))


def _identify_beginning(run: Run, length_s: float, *, trust_law: bool) -> Identification:
    """Return the findings of a long run's first minutes, without its end."""
    end_ns = int(run.poses.time_ns[0]) + round(_BEGINNING_S * 1e9)
    found = identify_run(slice_run(run, end_ns=end_ns), trust_law=trust_law)
    reason = (
        f"it lasts {length_s:.0f} s, and up to {LONGEST_S:.0f} s are simulated again:"
        f" what is found is of its first {_BEGINNING_S:.0f} s"
    )
    ends = found.findings.keys() & {"stop_reason", *RULE_KEYS}
    unseen = dict.fromkeys(ends, miss("the end of the run is not looked at"))
    findings = {**found.findings, **unseen}
    return replace(found, findings=findings, scenario=None, notes=(reason, *found.notes))


def _identify_recorded(trace: Trace) -> Identification | None:
    """Return the findings on a run whose scenario contains effects that cannot be identified.

    An effect may be invisible, or look like another setting. So the recorded settings are used if
    they reproduce every sample; None if they do not, or contain no such effect.
    """
    run, unseen = trace.run, list_unseen(trace.run)
    if not (unseen and run.scenario_is_complete):
        return None
    recorded = check_recorded_scenario(trace, trust_law=False)
    if recorded.scenario is None:
        return None
    rotation, turning = law_identification.identify_rotation(trace)
    translation, driving = law_identification.identify_translation(trace)
    is_law = _contradict_law(trace, turning, driving) is None
    findings = {**loop_settings.describe_goal(trace), **(rotation | translation if is_law else {})}
    motion = space_out(trace)
    dead_times = find_dead_times(motion, PHASES)
    findings |= describe_dead_times(dead_times, motion, run)
    note = f"{recorded.reach}; it holds {join_words(unseen)}, so its settings stand as recorded"
    findings |= take_findings(findings, recorded.scenario, note)
    findings["stop_reason"] = describe_stop_rule(run, recorded)
    findings["lost_commands"] = miss(f"with {join_words(unseen)} they are not counted")
    return Identification(
        name=run.name,
        findings=findings,
        resimulation=recorded.resimulation,
        scenario=recorded.scenario,
        is_recorded=True,
        notes=(note,),
    )


def _prefer_recorded(trace: Trace, found: Identification) -> Identification:
    """Return the recorded scenario if it reproduces the run and the identified one does not.

    If the identified scenario does, it gets the recorded settings that the samples do not show.
    """
    again = found.resimulation
    if not trace.run.scenario_is_complete:
        return found
    if again is not None and again.is_exact:
        return _add_recorded(trace, found)
    recorded = check_recorded_scenario(trace, trust_law=False)
    if recorded.scenario is None or recorded.resimulation is None:
        return found
    identified = "no scenario is identified" if again is None else "the identified one does not"
    return replace(
        found,
        scenario=recorded.scenario,
        resimulation=recorded.resimulation,
        is_recorded=True,
        notes=(f"{recorded.reach}; {identified}", *list_candidates(found.findings)),
    )


def _add_recorded(trace: Trace, found: Identification) -> Identification:
    """Return findings with recorded settings of the law that the samples do not show, if exact."""
    given = trace.run.parameters
    recorded = {
        key: given[key]
        for key in LAW_KEYS
        if key in given and found.findings[key].certainty is Certainty.UNKNOWN
    }
    changed = {key: value for key, value in recorded.items() if value != found.findings[key].used}
    if found.scenario is None or not changed:
        return found
    scenario = override_scenario(found.scenario, changed)
    again = compare_samples(trace, simulate_run(scenario))
    if not again.is_exact:
        return found
    findings = {
        key: take_recorded(value, f"as recorded: {found.findings[key].evidence}")
        for key, value in recorded.items()
    }
    return replace(
        found,
        findings={**found.findings, **findings},
        scenario=scenario,
        resimulation=again,
    )


def _identify_samples(trace: Trace) -> Identification:
    run, motion = trace.run, space_out(trace)
    dead_times = find_dead_times(motion, PHASES)
    findings = describe_dead_times(dead_times, motion, run)
    findings |= loop_settings.describe_goal(trace)
    rotation, turning = law_identification.identify_rotation(trace)
    translation, driving = law_identification.identify_translation(trace)
    breaks = describe_trace_breaks(trace)
    if obstacle := _contradict_law(trace, turning, driving):
        return give_up(run.name, findings, obstacle, breaks)
    if obstacle := _find_obstacle(trace):
        # Commands that follow their errors bit for bit determine their gain alone.
        pairs = ((rotation, turning), (translation, driving))
        sure = [found for found, fit in pairs if fit is not None and fit.is_certain]
        return give_up(run.name, {**findings, **dict(ChainMap(*sure))}, obstacle, breaks)
    findings |= {**rotation, **translation}
    is_certain = all(
        fit is None or fit.gain is None or fit.is_certain for fit in (turning, driving)
    )
    ending = law_identification.find_stop_rule(
        trace, is_certain=is_certain, is_finished=run.is_complete
    )
    findings |= ending.rules
    hints = loop_settings.read_hints(trace)
    tables = ("start.", "goal.", "law.", "limits.", "loop.")
    known = {key: finding.used for key, finding in findings.items() if key.startswith(tables)}
    known |= loop_settings.read_start(trace)
    try:
        fits = search_loop(trace, known, hints, tuple(dead_times.values()))
        scenario = fits.scenario
        if not fits.is_reproduced and ending.reason.value in {None, "cut"}:
            scenario = cut_where_logged(scenario, trace)  # no search has found the log's end
        again = simulate_run(scenario)
    except (ScenarioError, SimulationError) as err:
        return give_up(run.name, findings, f"it cannot be simulated again: {err}", breaks)
    findings |= loop_settings.describe_start(trace, fits)
    fits = _reject_lag(fits, dead_times)
    findings |= _describe_fits(trace, fits, dead_times)
    if not fits.is_reproduced:
        findings |= law_identification.withhold_law(findings, turning, driving)
    if not (fits.is_reproduced or fits.is_fitted):
        reason = "no setting of the loop explains the motion"
        findings |= {key: miss(reason, findings[key].used) for key in LAW_KEYS}
    findings |= loop_settings.describe_pause(trace, hints, fits)
    findings["stop_reason"] = ending.reason
    resimulation = compare_samples(trace, again)
    notes = (*breaks, *describe_difference(trace, fits, resimulation), *list_candidates(findings))
    return Identification(
        name=run.name,
        findings=findings,
        resimulation=resimulation,
        scenario=scenario,
        tried=fits.ranges,
        notes=notes,
    )


def _describe_fits(
    trace: Trace, fits: Fits, dead_times: Mapping[str, DeadTime | Missing]
) -> dict[str, Finding]:
    """Return the settings of the loop, with the dead times of those that only fit."""
    slack = find_lag_slack(trace.run, dead_times)
    findings = loop_settings.describe_loop(trace, fits, slack)
    if fits.is_fitted and not (fits.is_exact or fits.is_partial):
        findings |= _describe_dead_times_again(dead_times, fits, slack)
    return findings


def _describe_dead_times_again(
    dead_times: Mapping[str, DeadTime | Missing], fits: Fits, lag_slack: int
) -> dict[str, Finding]:
    """Return the dead times of the found settings if noise hides those in the log."""
    found: dict[str, Finding] = {}
    if len(fits.scenarios) > _MOST_ALIKE:
        return found
    runs = [simulate_run(scenario) for scenario in fits.scenarios]
    for loop, logged in dead_times.items():
        is_hidden = isinstance(logged, DeadTime) and not logged.is_exact
        is_hidden |= isinstance(logged, Missing) and logged.status is Status.UNDETERMINED
        again = [find_dead_time(run, loop) for run in runs] if is_hidden else []
        ticks = [one.ticks for one in again if isinstance(one, DeadTime)]
        if ticks and len(ticks) == len(runs):
            interval = (max(min(ticks) - lag_slack, 0), max(ticks))
            evidence = "of the settings that explain the motion"
            found[f"{DEAD_TIME}{loop}"] = fit_value(ticks[0], evidence, interval)
    return found


def _find_other_law(run: Run) -> str | None:
    """Return why the law is not sequential-p with constant gains, by its name or its loops."""
    kind = run.parameters.get("law.kind", DEFAULT_LAW)
    told = f"parameters are identified from commands only for {DEFAULT_LAW}"
    if kind != DEFAULT_LAW:
        return f"its law is {kind}: {told}"
    names = [loop.name for loop in run.declaration.loops]
    if not {*PHASES} <= {*names}:
        return f"its loops are {', '.join(names) or 'not recorded'}: {told}"
    if len(names) > len(PHASES):
        return f"its loops are {', '.join(names)}: {told} that rotates and translates"
    if any(loop.gain is None for loop in run.declaration.loops):
        return f"its gains are scheduled: {told} with constant gains"
    return None


def _contradict_law(
    trace: Trace, turning: CommandFit | None, driving: CommandFit | None
) -> str | None:
    """Return why the commands do not come from the sequential law."""
    for name, fit in (("rotating", turning), ("translating", driving)):
        if fit is not None and fit.obstacle:
            return f"{name}: {fit.obstacle}"
    turned = trace.turn_rate_rad_s[trace.rotating :][: trace.translating]
    if trace.speed_m_s[: trace.rotating].any() or turned.any():
        return "it drives while rotating, or turns while translating"
    return None


def _find_obstacle(trace: Trace) -> str | None:
    """Return why this is not a whole run of the sequential law, or cannot be simulated."""
    if trace.rotating + trace.translating < len(trace) or not trace.rotating:
        phases, names = trace.run.samples.phase, trace.run.phase_names
        begins = np.flatnonzero(np.diff(phases, prepend=-1) != 0)
        listed = [names[phase] for phase in phases[begins[:_MOST_PHASES]].tolist()]
        listed += ["..."] * (len(begins) > _MOST_PHASES)
        return f"its phases are not one rotation and one translation: {', '.join(listed)}"
    if trace.goal_xy_m is None:
        return "the log does not hold the goal"
    if trace.answered_after_s >= find_plant(trace.run).period_s:
        return (
            f"poses are answered {trace.answered_after_s:.3g} s after their publication (median):"
            " what delays them, the log does not tell"
        )
    times_ns = trace.time_ns if len(trace) > 1 else [trace.run.poses.time_ns[0], trace.run.end_ns]
    apart_s = float(np.median(np.diff(times_ns))) / 1e9
    if apart_s > _SLOWEST_S:
        return (
            f"its samples come every {apart_s:.3g} s (median); loops of up to {_SLOWEST_S:g} s are"
            " simulated again"
        )
    return None


_AROUND: Final = "a loop is identified from commands only around turtlesim"

_UNSURE: Final = Missing(status=Status.UNDETERMINED, reason="not every step is explained")


def _identify_other_law(run: Run, reason: str, *, trust_law: bool) -> Identification:
    """Return facts about the loop around a law whose parameters, for a reason, are unknown."""
    kind = str(run.parameters.get("law.kind", ""))
    trace = mark_breaks(trace_run(run))
    motion = space_out(trace)
    dead_times = find_dead_times(motion)
    if not run.scenario_is_complete:
        recorded = RecordedScenario(reach="")
    elif not trust_law and kind not in LAWS:
        reach = "the recorded scenario is not tested, as the code of its law is not trusted"
        recorded = RecordedScenario(reach=reach)
    else:
        recorded = check_recorded_scenario(trace, trust_law=trust_law)
    fits, settings, plant = None, dict[str, Finding](), find_plant(run).name
    around = reason if plant == TURTLESIM.name else f"its plant is {plant}: {_AROUND}"
    if plant == TURTLESIM.name:  # only its motion shows the loop around it
        fits = _reject_lag(_fit_loop(trace, recorded, [*dead_times.values()]), dead_times)
        if recorded.scenario is not None and fits.is_driven:
            recorded = RecordedScenario(reach=NOT_DETERMINISTIC)
        slack = find_lag_slack(run, dead_times)
        precision = loop_settings.describe_start(trace, fits)["loop.pose_precision"]
        settings = loop_settings.describe_loop(trace, fits, slack)
        settings["loop.pose_precision"] = precision
    findings = {
        **{key: miss(reason) for key in LAW_KEYS},
        **{key: miss(around) for key in (*LOOP_KEYS, "lost_commands")},
        **describe_dead_times(dead_times, motion, run),
        **loop_settings.describe_goal(trace),
        **find_command_limits(run),
        **settings,
        **({} if recorded.scenario is None else take_seconds(recorded.scenario)),
        "stop_reason": describe_stop_rule(run, recorded),
    }
    return Identification(
        name=run.name,
        findings=findings,
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


def _fit_loop(
    trace: Trace, recorded: RecordedScenario, dead_times: Sequence[DeadTime | Missing]
) -> Fits:
    """Return the settings that reproduce the log, with its law if known, else without a law."""
    hints = replace(loop_settings.read_hints(trace), pauses=())
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
        if fits.is_reproduced:
            return fits
    return drive_loop(trace, hints, dead_times)


def _reject_lag(fits: Fits, dead_times: Mapping[str, DeadTime | Missing]) -> Fits:
    """Return settings without an explained motion if the robot clearly has a time constant."""
    has_lag = any(isinstance(one, LagInstead) for one in dead_times.values())
    if fits.drive is None or not has_lag:
        return fits
    return replace(fits, drive=replace(fits.drive, explains=False))
