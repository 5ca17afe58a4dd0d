"""`turtlelog theory`: expected behaviour of the ideal and the sampled loop."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, NamedTuple

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.list_names import complete_keys, complete_preset
from turtlelog.cli.options import Json, ReadingOptions, Whole, read_runs
from turtlelog.cli.output import print_json, print_text
from turtlelog.cli.scenario_options import LawOptions, is_recording, load_changed_scenario
from turtlelog.cli.theory_answer import format_file, format_integrator, format_terms
from turtlelog.cli.theory_gains import (
    RecommendedGains,
    Wishes,
    WishOptions,
    build_recommended,
    find_kept,
)
from turtlelog.cli.theory_loops import (
    LoopAnswer,
    PidAnswer,
    answer_models,
    build_integrator,
    build_pid_loop,
)
from turtlelog.errors import TheoryError, UsageError
from turtlelog.files.urls import make_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turtlelog.theory import LoopModel, PidGains, PidLoop, Process

_MOST_GAINS: Final = 100
_GAINS: Final = "1,2,4,10"


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class TermOptions:
    """Further terms of the controller besides P, and the process that it controls.

    Attributes:
        ki: Integral gain [1/s^2].
        kd: Derivative gain, on the measurement [1].
        filter: Time constant of the derivative's first-order filter [s].
        gain: Gain K of the plant K exp(-theta s) / ((tau s + 1) s) [1]. Default: 1.
        lag: Time constant tau of the plant [s].
        dead_time_s: Dead time theta [s], any fraction of a period, in addition to --dead-time.
        low_pass: Time constant of a first-order low-pass of the commands [s], as low_pass_s of
            [shaping].
    """

    ki: Annotated[float | None, Parameter(metavar="GAIN")] = None
    kd: Annotated[float | None, Parameter(metavar="GAIN")] = None
    filter: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    gain: Annotated[float | None, Parameter(metavar="GAIN")] = None
    lag: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    dead_time_s: Annotated[float | None, Parameter(metavar="SECONDS")] = None
    low_pass: Annotated[float | None, Parameter(metavar="SECONDS")] = None

    def list_given(self) -> list[str]:
        """Return the options that are given."""
        given = [one.name for one in fields(self) if getattr(self, one.name) is not None]
        return [f"--{name.replace('_', '-')}" for name in given]

    def build_gains(self, kp: float) -> "PidGains":
        """Return the gains of the controller."""
        return tl.theory.PidGains(
            kp=kp, ki=self.ki or 0.0, kd=self.kd or 0.0, filter_s=self.filter or 0.0
        )

    def build_process(self) -> "Process":
        """Return the process that the command passes through."""
        return tl.theory.Process(
            gain=1.0 if self.gain is None else self.gain,
            lag_s=self.lag or 0.0,
            dead_time_s=self.dead_time_s or 0.0,
            low_pass_s=self.low_pass or 0.0,
        )


def theory(  # noqa: PLR0913 (each is an option of the command)
    scenario: Annotated[str | None, Parameter(name="SCENARIO", completer=complete_preset)] = None,
    /,
    *,
    kp: Annotated[str | None, Parameter(metavar="GAINS")] = None,
    terms: TermOptions | None = None,
    period: Annotated[float | None, Parameter(metavar="SECONDS")] = None,
    dead_time: Annotated[Whole | None, Parameter()] = None,
    assignments: Annotated[
        list[str] | None, Parameter(name="--set", metavar="KEY=VALUE", completer=complete_keys)
    ] = None,
    topics: ReadingOptions | None = None,
    wishes: WishOptions | None = None,
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
        kp: Gains [1/s], separated by commas, at most 100. Default: 1,2,4,10. With SCENARIO, give
            one gain; it replaces all gains of the law.
        terms: Other terms and the plant.
        period: Sampling period [s]. Default: 0.016, turtlesim's tick.
        dead_time: Dead time [ticks], 0 to 1000. Default: 0, the smallest possible.
        assignments: Set one key of the scenario. Can be repeated.
        topics: Options for reading a recording.
        wishes: Requirements for recommended gains.
        details: Also print the tables and sources that few people need.
        json: Print one JSON object instead of text.
    """
    form = _Form(is_json=json, shows_all=details)
    changes, timing = _Changes(kp, assignments), (period, dead_time)
    try:
        wanted = (wishes or WishOptions()).read()
        if scenario is None:
            _answer_loop(changes, terms or TermOptions(), timing, wanted, form)
        else:
            _require_alone(terms or TermOptions(), timing)
            _answer_file(scenario, changes, topics, wanted, form)
    except TheoryError as err:
        raise UsageError(_name_option(err)) from err


def _name_option(err: TheoryError) -> str:
    """Return the message of an error, with the option that sets the refused quantity."""
    option = _OPTIONS.get(err.quantity or "")
    if option is None:
        return str(err)
    if not err.must:
        return f"{option}: {err.problem}"
    return f"{option} {repr(err.value).removesuffix('.0')}: must be {err.must}"


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


_Timing = tuple[float | None, int | None]
"""Period [s] and dead time [ticks], as given."""


def _require_alone(terms: TermOptions, timing: _Timing) -> None:
    """Refuse options of a plant together with a scenario, which has its own plant."""
    given = terms.list_given()
    given += [
        name for name, value in zip(("--period", "--dead-time"), timing, strict=True) if value
    ]
    if given:
        raise UsageError(f"{given[0]}: leave it out beside SCENARIO, which has its own")


def _answer_loop(
    changes: "_Changes", terms: TermOptions, timing: _Timing, wanted: Wishes, form: "_Form"
) -> None:
    """Print the answer for P, PI, PD or PID control of an integrator, at each Kp."""
    (kp, assignments), (period, dead_time) = changes, timing
    if assignments:
        raise UsageError("--set changes a scenario: turtlelog theory SCENARIO --set KEY=VALUE")
    gains = _parse_gains(_GAINS if kp is None else kp)
    period_s = tl.plants.TURTLESIM.period_s if period is None else period
    if terms.list_given():
        _answer_terms(gains, terms, (period_s, dead_time or 0), wanted, form)
        return
    loops = [
        tl.theory.analyse_sampled_loop(gain, period_s=period_s, dead_time_ticks=dead_time or 0)
        for gain in gains
    ]
    late = tl.theory.Process(dead_time_s=(dead_time or 0) * period_s)
    given = [tl.theory.PidGains(kp=gain) for gain in gains]
    recommended = wanted.recommend(late, period_s, given=given).choose_given()
    if form.is_json:
        gains_json = build_recommended(recommended)
        print_json(build_integrator(loops, gains_json, find_kept(recommended)))
        return
    print_text(format_integrator(loops, recommended, wanted, shows_all=form.shows_all))


class _Form(NamedTuple):
    """Format of the answer."""

    is_json: bool
    shows_all: bool


def _answer_terms(
    gains: list[float], terms: TermOptions, timing: tuple[float, int], wanted: Wishes, form: _Form
) -> None:
    """Print the answer for a loop with more than P on 1/s, at each Kp."""
    process = terms.build_process()
    period_s, dead_time = timing
    late = replace(process, dead_time_s=process.dead_time_s + dead_time * period_s)
    given = [terms.build_gains(kp) for kp in gains]
    recommended = wanted.recommend(late, period_s, terms.filter or 0.0, given=given).choose_given()
    found = [
        tl.theory.analyse_pid_loop(
            one, period_s=period_s, dead_time_ticks=dead_time, process=process
        )
        for one in given
    ]
    if not form.is_json:
        answers = [LoopAnswer(title=f"Kp = {loop.gains.kp:g}", found=loop) for loop in found]
        print_text(format_terms(answers, recommended, wanted, shows_all=form.shows_all))
        return
    ranges = found[0].stable_gains
    print_json(
        _TermsAnswer(
            period_s=period_s,
            dead_time_ticks=dead_time,
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
    process: "Process"
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
    left_out: list[str]
    most_dead_time_s: float | None
    sampled: PidAnswer | None
    recommended: list[RecommendedGains]
    kept_kp: float | None


def _build_declared_loop(
    model: "LoopModel",
    found: "PidLoop | None",
    recommended: list[RecommendedGains],
    kept_kp: float | None,
) -> DeclaredLoopAnswer:
    """Return a declared loop for JSON, with its sources and, if known, its values."""
    return DeclaredLoopAnswer(
        loop=model.loop.name,
        signal=model.loop.signal,
        command=model.loop.command,
        status="ok" if found else "unknown",
        reason=model.reason or None,
        sources=dict(model.sources),
        left_out=list(model.left_out),
        most_dead_time_s=model.most_dead_time_s,
        sampled=None if found is None else build_pid_loop(found),
        recommended=recommended,
        kept_kp=kept_kp,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _FileAnswer:
    """Each loop of a scenario or a recording."""

    name: str
    source: str
    loops: list[DeclaredLoopAnswer]


class _Changes(NamedTuple):
    """Changes to a scenario."""

    kp: str | None
    assignments: list[str] | None


def _answer_file(
    word: str, changes: _Changes, topics: ReadingOptions | None, wanted: Wishes, form: _Form
) -> None:
    """Print the answer for each loop of a scenario or a recording."""
    name, source, models = _read_models(word, changes, topics)
    answers = answer_models(models)
    groups = wanted.recommend_for(models)
    if form.is_json:
        recommended = {
            loop: (build_recommended(one), find_kept(one, loop))
            for one in groups
            for loop in one.loops
        }
        loops = [
            _build_declared_loop(one.model, one.found, *recommended.get(one.title, ([], None)))
            for one in answers
            if one.model is not None
        ]
        print_json(_FileAnswer(name=name, source=source, loops=loops))
    else:
        label = tl.compare.label_file(word) if source == "recording" else name
        print_text(format_file(label, word, answers, groups, wanted, shows_all=form.shows_all))


def _read_models(
    word: str, changes: _Changes, topics: ReadingOptions | None
) -> "tuple[str, str, Sequence[LoopModel]]":
    """Return the name of a scenario or recording, its kind, and its loops."""
    path = make_path(word)
    if is_recording(path):
        if changes.kp is not None or changes.assignments:
            option = "--set" if changes.kp is None else "--kp"
            raise UsageError(f"{option}: needs a scenario; {path} is a recording")
        (run,) = read_runs([path], topics)
        return run.name, "recording", tl.measure.model_run_loops(run, identified=_identify(run))
    options = LawOptions(kp=_parse_one_gain(changes.kp), assignments=changes.assignments)
    chosen = tl.scenario.resolve_scenario(load_changed_scenario(word, options))
    parameters = tl.scenario.flatten_scenario(chosen)
    models = tl.theory.model_loops(tl.simulate.declare_scenario(chosen), parameters)
    return chosen.name, "scenario", models


def _identify(run: "tl.Run") -> dict[str, Any]:
    """Return gains from the commands of a recording that does not contain them."""
    gains = [loop.gain for loop in run.declaration.loops if loop.gain]
    keys = [key for key in gains if key not in run.parameters]
    if not keys or not len(run.samples):
        return {}
    findings = tl.explain.identify_run(run).findings
    values = {key: findings[key].value for key in keys if key in findings}
    return {key: value for key, value in values.items() if value is not None}


def _parse_one_gain(text: str | None) -> float | None:
    if text is None:
        return None
    gains = _parse_gains(text)
    if len(gains) != 1:
        raise UsageError(f"--kp: takes one gain with SCENARIO, not {len(gains)}")
    return gains[0]


def _parse_gains(text: str) -> list[float]:
    try:
        gains = [float(word) for word in text.split(",")]
    except ValueError as err:
        raise UsageError(
            f"--kp {text[:60]}: must be gains with commas between, as in 1,2,4,10"
        ) from err
    if len(gains) > _MOST_GAINS:
        raise UsageError(f"--kp: takes at most {_MOST_GAINS} gains, not {len(gains)}")
    return gains
