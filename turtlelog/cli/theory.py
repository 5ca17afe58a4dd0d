"""`turtlelog theory`: what the ideal loop and the sampled loop should do."""

import textwrap
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.list_names import complete_keys, complete_preset
from turtlelog.cli.options import (
    Json,
    LawOptions,
    TopicOptions,
    Whole,
    is_recording,
    load_changed_scenario,
    read_runs,
)
from turtlelog.cli.output import format_table, print_json, print_text
from turtlelog.cli.theory_loops import (
    LoopAnswer,
    answer_models,
    describe_pid_loop,
    describe_process,
    tabulate_answers,
)
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog.compare import Table
    from turtlelog.theory import Process, SampledLoop

_MOST_GAINS: Final = 100
_GAINS: Final = "1,2,4,10"
_WIDTH: Final = 96
"""Of notes that stand without a table [characters]."""
_MOST_COLUMNS: Final = 4
"""Gains beside each other: more would be wider than 100 characters."""
_TURTLE_TICK_S: Final = 0.016


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class TermOptions:
    """Terms of the controller beside P, and what its command passes.

    Attributes:
        ki: Integral gain [1/s^2].
        kd: Derivative gain, on the measurement [1].
        filter: Time constant of the derivative's first-order filter [s].
        gain: Gain K of the plant K exp(-theta s) / ((tau s + 1) s) [1]; 1 by default.
        lag: Time constant tau of the plant [s].
        dead_time_s: Dead time theta [s], any part of a period; adds to --dead-time.
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

    def build_process(self) -> "Process":
        """Return what the command passes."""
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
        list[str] | None,
        Parameter(name="--set", metavar="KEY=VALUE", completer=complete_keys),
    ] = None,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Say what theory expects of an integrator under P, PI, PD or PID control.

    The plant 1/s, the ideal loop Kp / (s + Kp), and the sampled loop with dead
    time: poles, overshoot, settling times, margins, and the gains at which
    overshoot and instability begin. Commands are not clipped. The paper's
    programs had 4 or 5 ticks of dead time while rotating, 6 while translating.

    With an integral, a derivative, a lag, a low-pass or dead time in seconds:
    the same of that loop, sampled exactly. Of a scenario or a recording: of
    each loop of its law, where each value comes from, and what is left out.

    Example: turtlelog theory --kp 1,2,4,10 --dead-time 6

    Example: turtlelog theory --kp 2 --ki 1 --lag 0.1 --dead-time-s 0.08

    Example: turtlelog theory kp10.mcap

    Args:
        scenario: A preset, a scenario file (.toml), or a recording, whose period and dead times are
            measured.
        kp: Gains [1/s], with commas between, at most 100; 1,2,4,10 by default. Of a scenario the
            one gain to set.
        terms: Other terms and the plant.
        period: Sampling period [s]; turtlesim's tick, 0.016, by default.
        dead_time: Dead time [ticks], 0 to 1000; 0, the default, is the least possible.
        assignments: Change one value of the scenario by its dotted key; may stand several times.
        topics: How a recording is read.
        json: Print one JSON object instead of tables.
    """
    terms = terms or TermOptions()
    if scenario is not None:
        given = terms.list_given()
        given += [] if period is None else ["--period"]
        given += [] if dead_time is None else ["--dead-time"]
        if given:
            raise UsageError(f"{given[0]}: expected no such option beside SCENARIO, found one")
        _answer_file(scenario, kp, assignments, topics, json=json)
        return
    if assignments:
        raise UsageError("--set: expected SCENARIO beside it, found none")
    gains = _parse_gains(_GAINS if kp is None else kp)
    period_s = _TURTLE_TICK_S if period is None else period
    if terms.list_given():
        _answer_terms(gains, terms, period_s, dead_time or 0, json=json)
        return
    loops = [
        tl.theory.analyse_sampled_loop(gain, period_s=period_s, dead_time_ticks=dead_time or 0)
        for gain in gains
    ]
    if json:
        print_json(_describe(loops))
        return
    print_text("\n".join(map(format_table, tabulate_theory(loops))))


def _answer_terms(
    gains: list[float], terms: TermOptions, period_s: float, dead_time: int, *, json: bool
) -> None:
    """Answer for a loop with more than P on 1/s, at each Kp."""
    process = terms.build_process()
    found = [
        tl.theory.analyse_pid_loop(
            tl.theory.PidGains(
                kp=kp, ki=terms.ki or 0.0, kd=terms.kd or 0.0, filter_s=terms.filter or 0.0
            ),
            period_s=period_s,
            dead_time_ticks=dead_time,
            process=process,
        )
        for kp in gains
    ]
    if not json:
        answers = [LoopAnswer(title=f"Kp = {loop.gains.kp:g}", found=loop) for loop in found]
        parts = [answers[k : k + _MOST_COLUMNS] for k in range(0, len(answers), _MOST_COLUMNS)]
        tables = [tabulate_answers("The sampled loop", part) for part in parts]
        print_text("\n".join(map(format_table, tables)))
        return
    ranges = found[0].stable_gains
    print_json(
        {
            "period_s": period_s,
            "dead_time_ticks": dead_time,
            "dead_time_s": found[0].dead_time_s,
            "process": describe_process(process),
            "overshoot_gain": None,
            "stability_gain": ranges[-1][1] if ranges else None,
            "gains": [describe_pid_loop(loop) for loop in found],
        }
    )


def _answer_file(
    word: str,
    kp: str | None,
    assignments: list[str] | None,
    topics: TopicOptions | None,
    *,
    json: bool,
) -> None:
    """Answer for each loop of a scenario or a recording."""
    path = Path(word)
    if is_recording(path):
        if kp is not None or assignments:
            option = "--set" if kp is None else "--kp"
            raise UsageError(f"{option}: expected a scenario beside it, found a recording, {path}")
        (run,) = read_runs([path], topics)
        name, source = run.name, "recording"
        models = tl.measure.model_run_loops(run, identified=_identify(run))
    else:
        options = LawOptions(kp=_parse_one_gain(kp), assignments=assignments)
        chosen = tl.scenario.resolve_scenario(load_changed_scenario(word, options))
        name, source = chosen.name, "scenario"
        parameters = tl.scenario.flatten_scenario(chosen)
        models = tl.theory.model_loops(tl.simulate.declare_scenario(chosen), parameters)
    answers = answer_models(models)
    if json:
        print_json({"name": name, "source": source, "loops": [one.describe() for one in answers]})
    elif answers:
        table = tabulate_answers(f"The loops of {name}", answers)
        lines = [textwrap.fill(note, _WIDTH) for note in table.notes]
        print_text(format_table(table) if table.rows else "\n".join(lines))
    else:
        print_text(f"{name}: no loop is declared, so theory says nothing of it.")


def _identify(run: "tl.Run") -> dict[str, Any]:
    """Return gains that a recording does not tell, as its commands do."""
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
        raise UsageError(f"--kp: expected one gain beside SCENARIO, found {len(gains)}")
    return gains[0]


def _parse_gains(text: str) -> list[float]:
    try:
        gains = [float(word) for word in text.split(",")]
    except ValueError as err:
        raise UsageError(f"--kp: expected gains as in 1,2,4,10, found {text[:60]!r}") from err
    if len(gains) > _MOST_GAINS:
        raise UsageError(f"--kp: expected at most {_MOST_GAINS} gains, found {len(gains)}")
    return gains


def _describe(loops: "list[SampledLoop]") -> dict[str, Any]:
    first = loops[0]
    overshoot_gain, stability_gain = compute_limits(first.period_s, first.dead_time_ticks)
    limits = [(ticks, *compute_limits(first.period_s, ticks)) for ticks in list_dead_times(first)]
    return {
        "period_s": first.period_s,
        "dead_time_ticks": first.dead_time_ticks,
        "overshoot_gain": overshoot_gain,
        "stability_gain": stability_gain,
        "plant": _describe_plant(),
        "gains": [_describe_loop(loop) for loop in loops],
        "limits": [
            {"dead_time_ticks": ticks, "overshoot_gain": overshoot, "stability_gain": stability}
            for ticks, overshoot, stability in limits
        ],
    }


def _describe_plant() -> dict[str, Any]:
    verdict = tl.theory.judge_bibo(*tl.theory.PLANT)
    ends = [(kind, tl.theory.find_plant_final_value(kind)) for kind in tl.theory.PLANT_INPUTS]
    return {
        "transfer_function": {"numerator": tl.theory.PLANT[0], "denominator": tl.theory.PLANT[1]},
        "bibo_stable": verdict.stable,
        "reason": verdict.reason,
        "final_values": [
            {"input": kind, "value": end.value, "status": end.status.value, "reason": end.reason}
            for kind, end in ends
        ],
    }


def _describe_loop(loop: "SampledLoop") -> dict[str, Any]:
    return {
        "kp": loop.kp,
        "tau_s": tl.theory.compute_time_constant(loop.kp),
        "settling_time_s": tl.theory.compute_settling_time(loop.kp),
        "exact_settling_time_s": tl.theory.compute_exact_settling_time(loop.kp),
        "poles": [{"re": float(pole.real), "im": float(pole.imag)} for pole in loop.poles],
        "stable": loop.stable,
        "overshoots": loop.overshoots,
        "damping_ratio": loop.damping_ratio,
        "overshoot_percent": loop.overshoot_percent,
        "sampled_settling_time_s": loop.settling_time_s,
        "gain_margin": loop.gain_margin,
        "phase_margin_rad": loop.phase_margin_rad,
        "delay_margin_ticks": loop.delay_margin_ticks,
        "delay_margin_s": loop.delay_margin_s,
    }


_LIMITS_UP_TO: Final = 8
_RESPONSES: Final = {"impulse": "1", "step": "t", "ramp": "t^2 / 2"}


def tabulate_theory(loops: "list[SampledLoop]") -> "list[Table]":
    """Return the plant, the ideal loop, the sampled loop and its limits as tables."""
    return [
        _tabulate_plant(),
        _tabulate_ideal(loops),
        _tabulate_loops(loops),
        _tabulate_limits(loops),
    ]


def compute_limits(period_s: float, ticks: int) -> tuple[float, float]:
    """Return the gains [1/s] at which overshoot and instability begin."""
    overshoot = tl.theory.compute_overshoot_gain(period_s, ticks)
    return overshoot, tl.theory.compute_stability_gain(period_s, ticks)


def list_dead_times(loop: "SampledLoop") -> list[int]:
    """Return the dead times [ticks] that a table of limits shows, that of the loop among them."""
    return sorted({*range(_LIMITS_UP_TO + 1), loop.dead_time_ticks})


def _tabulate_plant() -> "Table":
    ends = {kind: tl.theory.find_plant_final_value(kind) for kind in tl.theory.PLANT_INPUTS}
    endless = {
        end.reason: [kind for kind in ends if ends[kind].reason == end.reason]
        for end in ends.values()
        if end.value is None
    }
    verdict = tl.theory.judge_bibo(*tl.theory.PLANT)
    return tl.compare.Table(
        title="The plant 1/s",
        columns=tuple(
            tl.compare.Column(title=title) for title in ("input", "response", "final value")
        ),
        rows=tuple(
            (kind, _RESPONSES[kind], end.status.value if end.value is None else f"{end.value:g}")
            for kind, end in ends.items()
        ),
        notes=(
            f"BIBO stable: {_tell(verdict.stable)}; {verdict.reason}.",
            *(
                f"Final value theorem, {' and '.join(kinds)}: {reason}."
                for reason, kinds in endless.items()
            ),
        ),
    )


def _tabulate_ideal(loops: "list[SampledLoop]") -> "Table":
    rows = [
        (
            loop.kp,
            -loop.kp,
            tl.theory.compute_time_constant(loop.kp),
            tl.theory.compute_settling_time(loop.kp),
            tl.theory.compute_exact_settling_time(loop.kp),
        )
        for loop in loops
    ]
    return tl.compare.Table(
        title="The ideal loop Kp / (s + Kp)",
        columns=(
            tl.compare.Column(title="Kp", unit="1/s"),
            tl.compare.Column(title="pole", unit="1/s"),
            tl.compare.Column(title="tau", unit="s"),
            tl.compare.Column(title="4 tau", unit="s"),
            tl.compare.Column(title="ln 50 tau", unit="s"),
        ),
        rows=tuple(rows),
        notes=(
            "It settles to 2 % in ln 50 tau = 3.91 tau; 4 tau is the rule. It never overshoots.",
        ),
    )


def _tabulate_loops(loops: "list[SampledLoop]") -> "Table":
    return tl.compare.Table(
        title=f"Sampled every {_tell_period(loops[0])}, dead time {_tell_dead_time(loops[0])}",
        columns=(
            tl.compare.Column(title="Kp", unit="1/s"),
            tl.compare.Column(title="slowest pole"),
            tl.compare.Column(title="damping", digits=3),
            tl.compare.Column(title="overshoots"),
            tl.compare.Column(title="settles in", unit="s", digits=3),
            tl.compare.Column(title="gain margin", digits=2),
            tl.compare.Column(title="delay margin", unit="ticks", digits=1),
            tl.compare.Column(title="stable"),
        ),
        rows=tuple(
            (
                loop.kp,
                _tell_pole(complex(loop.poles[0])),
                loop.damping_ratio,
                _tell_overshoot(loop),
                loop.settling_time_s,
                loop.gain_margin,
                loop.delay_margin_ticks,
                _tell(loop.stable),
            )
            for loop in loops
        ),
        notes=(_summarise(loops),),
    )


def _tabulate_limits(loops: "list[SampledLoop]") -> "Table":
    period_s = loops[0].period_s
    rows = [
        (ticks, 1e3 * ticks * period_s, *compute_limits(period_s, ticks))
        for ticks in list_dead_times(loops[0])
    ]
    return tl.compare.Table(
        title=f"Limits of the gain, sampled every {_tell_period(loops[0])}",
        columns=(
            tl.compare.Column(title="dead time d", unit="ticks"),
            tl.compare.Column(title="d T", unit="ms"),
            tl.compare.Column(title="no overshoot up to Kp", unit="1/s"),
            tl.compare.Column(title="stable below Kp", unit="1/s"),
        ),
        rows=tuple(rows),
        notes=(
            "Overshoot begins at Kp T = d^d / (d + 1)^(d + 1), instability at 2 sin(pi / (2 (2 d +"
            " 1))). A command that is clipped hides both while it is clipped.",
        ),
    )


def _summarise(loops: "list[SampledLoop]") -> str:
    """Return on which side of both limits the gains stand."""
    overshoot, stability = compute_limits(loops[0].period_s, loops[0].dead_time_ticks)
    groups = {
        "no overshoot": [loop for loop in loops if loop.stable and not loop.overshoots],
        "overshoots, and settles": [loop for loop in loops if loop.stable and loop.overshoots],
        "unstable": [loop for loop in loops if not loop.stable],
    }
    verdicts = [
        f"Kp = {', '.join(f'{loop.kp:g}' for loop in group)}: {verdict}."
        for verdict, group in groups.items()
        if group
    ]
    limits = f"Overshoot begins above Kp = {overshoot:.4g} 1/s, instability at {stability:.4g} 1/s."
    return " ".join((limits, *verdicts))


def _tell_period(loop: "SampledLoop") -> str:
    return f"{1e3 * loop.period_s:.6g} ms"


def _tell_dead_time(loop: "SampledLoop") -> str:
    ticks = loop.dead_time_ticks
    return f"{ticks} tick{'' if ticks == 1 else 's'} ({1e3 * ticks * loop.period_s:.6g} ms)"


def _tell_pole(pole: complex) -> str:
    if pole.imag == 0.0:
        return f"{pole.real:.4f}"
    return f"{pole.real:.4f} +- {abs(pole.imag):.4f}j"


def _tell_overshoot(loop: "SampledLoop") -> str:
    if not loop.stable:
        return "without end"
    if not loop.overshoots:
        return "no"
    percent = loop.overshoot_percent
    return "yes" if percent is None else f"by {percent:.2f} %"


def _tell(value: object) -> str:
    return "yes" if value else "no"
