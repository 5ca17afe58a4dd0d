"""`turtlelog theory`: expected behaviour of the ideal and the sampled loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Literal, NamedTuple

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.console import print_json, print_text
from turtlelog.cli.list_names import complete_keys, complete_preset
from turtlelog.cli.options import Json, ReadingOptions, read_runs
from turtlelog.cli.scenario import LawOptions, is_recording, load_changed_scenario
from turtlelog.cli.theory_answer import format_file, format_integrator, format_terms
from turtlelog.cli.theory_gains import (
    ChosenGains,
    GainTrial,
    Recommended,
    RecommendedGains,
    WishOptions,
    build_recommended,
    find_kept,
    is_better,
    list_changes,
    simulate,
    tell_end,
)
from turtlelog.cli.theory_loops import LoopAnswer, PidAnswer, build_integrator, build_pid_loop
from turtlelog.cli.usage import Whole, parse_option
from turtlelog.errors import ScenarioError, TheoryError, UsageError
from turtlelog.files.urls import make_path
from turtlelog.run.stop_reasons import find_goal_end

_MOST_GAINS: Final = 100


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class LoopOptions:
    """The controller, the process that it controls, and their timing.

    Attributes:
        kp: Gains [1/s], separated by commas, at most 100. Default: 1,2,4,10. With SCENARIO, give
            one gain; it replaces all gains of the law.
        ki: Integral gain [1/s^2].
        kd: Derivative gain, on the measurement [1].
        filter: Time constant of the derivative's first-order filter [s].
        gain: Gain K of the plant K exp(-theta s) / ((tau s + 1) s) [1]. Default: 1.
        lag: Time constant tau of the plant [s].
        dead_time_s: Dead time theta [s], any fraction of a period, in addition to --dead-time.
        low_pass: Time constant of a first-order low-pass of the commands [s], as low_pass_s of
            [shaping].
        period: Sampling period [s]. Default: 0.016, turtlesim's tick.
        dead_time: Dead time [ticks], 0 to 1000. Default: 6, the longest of the paper's programs; 0
            with a period or an option of the plant.
        assignments: Set one key of the scenario. Can be repeated.
    """

    kp: Annotated[str | None, Parameter(metavar="GAINS")] = None
    ki: Annotated[float | None, Parameter(metavar="GAIN")] = None
    kd: Annotated[float | None, Parameter(metavar="GAIN")] = None
    filter: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    gain: Annotated[float | None, Parameter(metavar="GAIN")] = None
    lag: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    dead_time_s: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    low_pass: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    period: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    dead_time: Whole | None = None
    assignments: Annotated[
        list[str] | None, Parameter(name="--set", metavar="KEY=VALUE", completer=complete_keys)
    ] = None

    def list_terms(self) -> list[str]:
        """Return the given options of terms besides P, and of the process."""
        given = [name for name in _TERMS if getattr(self, name) is not None]
        return [f"--{name.replace('_', '-')}" for name in given]

    def choose_dead_time(self) -> int:
        """Return the dead time [ticks]."""
        own = self.gain, self.lag, self.dead_time_s, self.low_pass, self.period
        is_turtlesim = all(value is None for value in own)
        return (_LONGEST_TICKS if is_turtlesim else 0) if self.dead_time is None else self.dead_time


_LONGEST_TICKS: Final = 6
"""Dead time of the paper's programs while translating [ticks]. A loop of turtlesim without any
would have gains that no such loop can use."""

_TERMS: Final = ("ki", "kd", "filter", "gain", "lag", "dead_time_s", "low_pass")


def theory(
    scenario: Annotated[str | None, Parameter(name="SCENARIO", completer=complete_preset)] = None,
    /,
    *,
    options: LoopOptions = LoopOptions(),
    topics: ReadingOptions = ReadingOptions(),
    wishes: WishOptions = WishOptions(),
    details: bool = False,
    json: Json = False,
) -> None:
    """Recommend gains, and give the limits of P, PI, PD or PID control of an integrator.

    The first lines are recommended gains for a given overshoot or phase margin, the gains at which
    overshoot and instability begin, and how the loop responds at each Kp. Tables of both follow.
    Commands are not clipped. The paper's programs had 4 or 5 ticks of dead time while rotating, 6
    while translating.

    With an integral, a derivative, a time constant, a low-pass or a dead time in seconds, the loop
    is discretised exactly. For a scenario or a recording, the answer covers each loop of its law.

    With --details: the plant 1/s, the ideal loop Kp / (s + Kp), limits at other dead times, gains
    of published rules, and the source of each value.

    Example: turtlelog theory --kp 1,2,4,10 --dead-time 6

    Example: turtlelog theory --kp 2 --ki 1 --lag 0.1 --dead-time-s 0.08

    Example: turtlelog theory --lag 0.2 --dead-time-s 0.08 --overshoot 2

    Example: turtlelog theory kp10.mcap

    Args:
        scenario: A preset, a scenario file (.toml), or a recording, whose period and dead times are
            measured.
        details: Also print the tables and sources that few people need.
        json: Print one JSON object instead of text.
    """
    try:
        wanted = wishes.complete()
        if scenario is None:
            _answer_loop(options, wanted, details=details, json=json)
        else:
            subject = _read_subject(scenario, options, topics)
            chosen = _choose_gains(subject, wanted, is_given=wanted is wishes)
            _answer_file(scenario, options, subject, chosen, details=details, json=json)
    except TheoryError as err:
        option = _OPTIONS.get(err.quantity or "")
        if option is None:
            raise UsageError(str(err)) from err
        if not err.must:
            raise UsageError(f"{option}: {err.problem}") from err
        value = repr(err.value).removesuffix(".0")
        raise UsageError(f"{option} {value}: must be {err.must}") from err


_OPTIONS: Final = {
    **{name: f"--{name}" for name in ("kp", "ki", "kd", "gain")},
    "period_s": "--period",
    "dead_time_ticks": "--dead-time",
    "dead_time_s": "--dead-time-s",
    "filter_s": "--filter",
    "lag_s": "--lag",
    "low_pass_s": "--low-pass",
    "overshoot_percent": "--overshoot",
    "phase_margin_rad": "--phase-margin",
}
"""Options by the names of quantities in errors."""


def _answer_loop(options: LoopOptions, wanted: WishOptions, *, details: bool, json: bool) -> None:
    if options.assignments:
        raise UsageError("--set changes a scenario: turtlelog theory SCENARIO --set KEY=VALUE")
    kps = _parse_gains("1,2,4,10" if options.kp is None else options.kp)
    period_s = tl.plants.TURTLESIM.period_s if options.period is None else options.period
    ticks = options.choose_dead_time()
    process = tl.theory.Process(
        gain=1.0 if options.gain is None else options.gain,
        lag_s=options.lag or 0.0,
        dead_time_s=options.dead_time_s or 0.0,
        low_pass_s=options.low_pass or 0.0,
    )
    ki, kd, filter_s = options.ki or 0.0, options.kd or 0.0, options.filter or 0.0
    given = [tl.theory.PidGains(kp=kp, ki=ki, kd=kd, filter_s=filter_s) for kp in kps]

    def recommend() -> Recommended:
        late = replace(process, dead_time_s=process.dead_time_s + ticks * period_s)
        return wanted.recommend(late, period_s, filter_s, given=given).choose_given()

    if not options.list_terms():
        loops = [
            tl.theory.analyse_sampled_loop(kp, period_s=period_s, dead_time_ticks=ticks)
            for kp in kps
        ]
        if json:
            print_json(build_integrator(loops, recommend()))
        else:
            print_text(format_integrator(loops, recommend(), wanted, shows_all=details))
        return
    recommended = recommend()
    found = [
        tl.theory.analyse_pid_loop(one, period_s=period_s, dead_time_ticks=ticks, process=process)
        for one in given
    ]
    if not json:
        answers = [LoopAnswer(title=f"Kp = {loop.gains.kp:g}", found=loop) for loop in found]
        print_text(format_terms(answers, recommended, wanted, shows_all=details))
        return
    ranges = found[0].stable_gains
    print_json(
        _TermsAnswer(
            period_s=period_s,
            dead_time_ticks=ticks,
            dead_time_s=found[0].dead_time_s,
            process=process,
            stability_gain=ranges[-1][1] if ranges else None,
            gains=[build_pid_loop(loop) for loop in found],
            recommended=build_recommended(recommended),
            kept_kp=find_kept(recommended),
        )
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _TermsAnswer:
    """A loop with more than P on 1/s."""

    period_s: float
    dead_time_ticks: int
    dead_time_s: float
    process: "tl.theory.Process"
    overshoot_gain: None = None
    stability_gain: float | None
    gains: list[PidAnswer]
    recommended: list[RecommendedGains]
    kept_kp: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DeclaredLoopAnswer:
    """A loop that a law declares.

    Attributes:
        loop: Name of the loop.
        signal: Controlled signal.
        command: Command by which the loop acts.
        status: `ok`, or `unknown` if its gains or its plant are unknown.
        reason: Reason why gains or plant are unknown.
        sources: Sources of the values.
        left_out: Settings that theory's linear loop leaves out.
        most_dead_time_s: Largest dead time that queues may cause [s].
        largest_step: Largest step of recommended gains [m or rad]; None if they ignore limits.
        sampled: The sampled loop; None if the loop is unknown.
        recommended: Recommended gains.
        kept_kp: Present Kp, if it needs no change [1/s].
    """

    loop: str
    signal: str
    command: str
    status: Literal["ok", "unknown"]
    reason: str | None
    sources: Mapping[str, str]
    left_out: Sequence[str]
    most_dead_time_s: float | None
    largest_step: float | None
    sampled: PidAnswer | None
    recommended: list[RecommendedGains]
    kept_kp: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _FileAnswer:
    """Each loop of a scenario or a recording.

    Attributes:
        trials: Simulated runs with recommended gains, those of the answer last.
    """

    name: str
    source: str
    loops: list[DeclaredLoopAnswer]
    trials: Sequence[GainTrial]


class _Subject(NamedTuple):
    """A scenario or a recording with its loops, and the scenario to try gains with, if any."""

    name: str
    source: str
    models: "Sequence[tl.theory.LoopModel]"
    scenario: "tl.Scenario | None"


def _choose_gains(subject: _Subject, wanted: WishOptions, *, is_given: bool) -> ChosenGains:
    """Return gains that improve the simulated run: as wanted, or else without overshoot.

    Gains without overshoot are tried if the run with the wanted gains is no better, or still ends
    away from its goal.
    """
    models = subject.models
    chosen = ChosenGains(wanted, wanted.recommend_for(models), ())
    loops = [name for one in chosen.groups for name in one.loops]
    is_known = not any(model.oscillates for model in models)  # else the plant is another one
    may_try = is_known and list_changes(models, chosen.groups)
    present = best = simulate(subject.scenario) if may_try else None
    trials: list[GainTrial] = []
    seed = None
    if present and subject.scenario:
        from turtlelog.explain.causes import find_drawn_seed

        seed = find_drawn_seed(subject.scenario)
    for wish in (wanted,) if is_given else (wanted, replace(wanted, overshoot=0.0)):
        groups = chosen.groups if wish is wanted else wish.recommend_for(models)
        changes = list_changes(models, groups)
        run = simulate(subject.scenario, changes) if present and changes else None
        if run is None or present is None or best is None:
            break
        trial = GainTrial(
            gains=changes,
            ending=tell_end(run, loops),
            present_ending=tell_end(present, loops),
            is_better=is_better(run, best, loops),
            seed=seed,
        )
        if trial.is_better:
            chosen, best = ChosenGains(wish, groups, ()), run
        if trial.is_better or best is present:
            trials.append(trial)
        end = find_goal_end(best)
        if best is not present and not (end and end.is_away):
            break
    return chosen._replace(trials=trials)


def _answer_file(
    word: str,
    options: LoopOptions,
    subject: _Subject,
    chosen: ChosenGains,
    *,
    details: bool,
    json: bool,
) -> None:
    answers = [
        LoopAnswer(title=one.loop.name, found=None if one.reason else one.analyse(), model=one)
        for one in subject.models
    ]
    if not json:
        label = tl.compare.label_file(word) if subject.source == "recording" else subject.name
        given = [] if options.kp is None else ["--kp", options.kp]
        changed = chosen.trials[-1].gains if chosen.trials else {}
        kept = [one for one in options.assignments or () if one.partition("=")[0] not in changed]
        given += [part for one in kept for part in ("--set", one)]
        print_text(
            format_file(
                *(label, [word, *given], answers, chosen),
                shows_all=details,
            )
        )
        return
    recommended = {loop: one for one in chosen.groups for loop in one.loops}
    loops = [
        _build_declared(one.found, model, recommended.get(model.loop.name))
        for one, model in zip(answers, subject.models, strict=True)
    ]
    print_json(
        _FileAnswer(name=subject.name, source=subject.source, loops=loops, trials=chosen.trials)
    )


def _build_declared(
    found: "tl.theory.PidLoop | None", model: "tl.theory.LoopModel", gains: Recommended | None
) -> DeclaredLoopAnswer:
    return DeclaredLoopAnswer(
        loop=model.loop.name,
        signal=model.loop.signal,
        command=model.loop.command,
        status="ok" if found else "unknown",
        reason=model.reason or None,
        sources=model.sources,
        left_out=[one.describe() for one in model.left_out],
        most_dead_time_s=model.most_dead_time_s,
        largest_step=None if model.limits is None else model.limits.step,
        sampled=None if found is None else build_pid_loop(found),
        recommended=[] if gains is None else build_recommended(gains),
        kept_kp=None if gains is None else find_kept(gains, model.loop.name),
    )


def _read_subject(word: str, options: LoopOptions, topics: ReadingOptions) -> _Subject:
    """Return the loops of a scenario or a recording."""
    given = options.list_terms()
    timing = {"--period": options.period, "--dead-time": options.dead_time}
    given += [name for name, value in timing.items() if value is not None]
    if given:
        raise UsageError(f"{given[0]}: leave it out beside SCENARIO, which has its own")
    path = make_path(word)
    if is_recording(path):
        if options.kp is not None or options.assignments:
            option = "--set" if options.kp is None else "--kp"
            raise UsageError(f"{option}: needs a scenario; {path} is a recording")
        (run,) = read_runs([path], topics)
        models = tl.measure.model_run_loops(run, identified=_identify(run))
        return _Subject(run.name, "recording", models, _restore(run, word))
    gains = [] if options.kp is None else _parse_gains(options.kp)
    if len(gains) > 1:
        raise UsageError(f"--kp: takes one gain with SCENARIO, not {len(gains)}")
    for kp in gains:
        tl.theory.PidGains(kp=kp)  # an error on the option, not on a key of the law
    changes = LawOptions(kp=gains[0] if gains else None, assignments=options.assignments)
    chosen = tl.scenario.resolve_scenario(load_changed_scenario(word, changes))
    parameters = tl.scenario.flatten_scenario(chosen)
    models = tl.theory.model_loops(tl.simulate.declare_scenario(chosen), parameters)
    has_queue = any(one.most_dead_time_s and one.growth == "queues" for one in models)
    simulated = simulate(chosen) if has_queue else None
    if simulated is not None:  # as in a recording of this scenario
        measured = tl.measure.model_run_loops(simulated, place="the simulated run")
        models = tuple(_choose(a, b) for a, b in zip(models, measured, strict=True))
    return _Subject(chosen.name, "scenario", models, chosen)


def _choose(
    planned: "tl.theory.LoopModel", measured: "tl.theory.LoopModel"
) -> "tl.theory.LoopModel":
    return measured if measured.gains and not measured.unmeasured else planned


def _restore(run: "tl.Run", word: str) -> "tl.Scenario | None":
    """Return the scenario of a recording; None if it has none, or a law that may not run."""
    if not run.scenario_is_complete:
        return None
    try:
        return tl.scenario.resolve_scenario(tl.scenario.restore_scenario(run, source=word))
    except ScenarioError:
        return None


def _identify(run: "tl.Run") -> dict[str, Any]:
    """Return gains from the commands of a recording that does not contain them."""
    gains = [loop.gain for loop in run.declaration.loops if loop.gain]
    keys = [key for key in gains if key not in run.parameters]
    if not keys or not len(run.samples):
        return {}
    findings = tl.explain.identify_run(run).findings
    values = {key: findings[key].value for key in keys if key in findings}
    return {key: value for key, value in values.items() if value is not None}


def _parse_gains(text: str) -> list[float]:
    expected = "gains with commas between, as in 1,2,4,10"
    gains = parse_option("--kp", text, lambda text: [*map(float, text.split(","))], expected)
    if len(gains) > _MOST_GAINS:
        raise UsageError(f"--kp: takes at most {_MOST_GAINS} gains, not {len(gains)}")
    return gains
