"""Recommended gains as a small table and as JSON."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, NamedTuple

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.console import build_table
from turtlelog.display import format_short, join_words
from turtlelog.errors import TurtlelogError, UsageError
from turtlelog.run.stop_reasons import find_goal_end


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WishOptions:
    """Requirements for recommended gains.

    Attributes:
        overshoot: Recommend gains for this overshoot [% of the step], from 0 to below 100. Default:
            5, unless only --phase-margin is given.
        phase_margin: Recommend gains for this phase margin [deg], above 0 and below 180. Default:
            60, unless only --overshoot is given.
    """

    overshoot: Annotated[float | None, Parameter(metavar="PERCENT")] = None
    phase_margin: Annotated[float | None, Parameter(metavar="DEGREES")] = None

    def complete(self) -> "WishOptions":
        """Return the requirements; without any, those of theory."""
        percent, degrees = self.overshoot, self.phase_margin
        if percent is not None and not 0.0 <= percent < 100.0:
            raise UsageError(f"--overshoot {percent}: must be percent from 0 to below 100")
        if degrees is not None and not 0.0 < degrees < 180.0:
            raise UsageError(f"--phase-margin {degrees}: must be degrees above 0 and below 180")
        if percent is not None or degrees is not None:
            return self
        return WishOptions(
            overshoot=tl.theory.OVERSHOOT_PERCENT,
            phase_margin=math.degrees(tl.theory.PHASE_MARGIN_RAD),
        )

    def recommend(
        self,
        process: "tl.theory.Process",
        period_s: float,
        filter_s: float = 0.0,
        limits: "tl.theory.StepLimits | None" = None,
        *,
        given: "Sequence[tl.theory.PidGains]" = (),
    ) -> "Recommended":
        """Return gains for a process with all dead time, and the results of given gains."""
        found = tl.theory.recommend_gains(
            process,
            period_s=period_s,
            filter_s=filter_s,
            overshoot_percent=self.overshoot,
            phase_margin_rad=None if self.phase_margin is None else math.radians(self.phase_margin),
            limits=limits,
        )
        measured = [
            tl.theory.measure_gains(one, process, period_s=period_s, limits=limits) for one in given
        ]
        return Recommended(found, tuple(measured))

    def recommend_for(self, models: "Sequence[tl.theory.LoopModel]") -> "list[Recommended]":
        """Return gains for the declared loops that theory knows. Equal loops share gains.

        The gains are for the largest dead time of a loop, and for steps of all sizes.
        """
        groups: dict[_Design, dict[str, tl.theory.LoopModel]] = {}
        for model in tl.theory.list_known(models):
            gains, settings = model.require()[0], model.require_latest()
            key = settings["process"], settings["period_s"], gains.filter_s, model.limits
            groups.setdefault(key, {})[model.loop.name] = model
        found = []
        for key, loops in groups.items():
            first = next(iter(loops.values()))
            recommended = self.recommend(*key, given=[one.require()[0] for one in loops.values()])
            found.append(
                recommended._replace(
                    loops=tuple(loops),
                    most_dead_time_s=first.most_dead_time_s,
                    steps=_tell_steps(first),
                )
            )
        return found

    def tell(self, one: "tl.theory.Recommendation") -> str:
        """Return controller and rule as text, for a table."""
        if one.rule == "given":
            return f"{one.controller} as given"
        if one.rule in _RULES:
            return f"{one.controller} for {self.describe(one.rule)}".replace("phase ", "")
        return f"{one.controller} by {_RULE_NAMES[one.rule]}"

    def describe(self, rule: str) -> str:
        """Return the result of a rule: `5 % overshoot`, `60 deg phase margin`, or its name."""
        if rule == "overshoot":
            return f"{self.overshoot:g} % overshoot"
        if rule == "phase-margin":
            return f"{self.phase_margin:g} deg phase margin"
        return f"the rule of {_RULE_NAMES[rule]}"


class Recommended(NamedTuple):
    """Recommended gains, together with given gains.

    Attributes:
        found: Recommended gains.
        given: Results of the given gains, in the order of the loops.
        loops: Names of the loops with these gains.
        most_dead_time_s: Largest dead time, if the dead time may grow [s].
        steps: Measured steps in words, if gains allow for limits of acceleration.
    """

    found: "tuple[tl.theory.Recommendation, ...]"
    given: "tuple[tl.theory.Recommendation, ...]" = ()
    loops: Sequence[str] = ()
    most_dead_time_s: float | None = None
    steps: str = ""

    def find_best(self, controller: str) -> "tl.theory.Recommendation | None":
        """Return gains of a controller that fulfil a wish, or else of P; None without either."""
        wished = [one for one in self.found if one.gains and one.rule in _RULES]
        known = {one.controller: one for one in reversed(wished)}
        return known.get(controller) or known.get("P")

    def find_missing(self, controller: str) -> "tl.theory.Recommendation | None":
        """Return the first wish that no gains of a controller, or of P if it has none, fulfil.

        None if other gains of this controller are recommended.
        """
        best = self.find_best(controller)
        if best is not None and best.controller == controller:
            return None
        missing = [one for one in self.found if one.reason and one.rule in _RULES]
        known = {one.controller: one for one in reversed(missing)}
        return known.get(controller) if best else next(iter(missing), None)

    def keeps(self, given: "tl.theory.Recommendation") -> bool:
        """Return whether given gains need no change."""
        best = self.find_best(given.controller)
        return best is not None and tl.theory.is_no_worse(given, best)

    def choose_given(self) -> "Recommended":
        """Keep, of several given gains, those that are compared with the recommended gains."""
        return self._replace(given=tuple(sorted(self.given, key=self._rank)[:1]))

    def _rank(self, given: "tl.theory.Recommendation") -> tuple[bool, float, float]:
        """Return a sort key: gains without change first, then gains with the least overshoot."""
        if given.motion is None:
            return True, math.inf, math.inf
        best = self.find_best(given.controller)
        wished = 0.0 if best is None or best.motion is None else best.motion.overshoot_percent
        settles_s = given.motion.settling_time_s
        excess = max(given.motion.overshoot_percent - wished, 0.0)
        return not self.keeps(given), excess, math.inf if settles_s is None else settles_s


def list_changes(
    models: "Sequence[tl.theory.LoopModel]", groups: Sequence[Recommended]
) -> dict[str, float]:
    """Return recommended gains of loops that need a change, by key, in three digits."""
    loops = {model.loop.name: model.loop for model in models}
    found = {}
    for one in groups:
        for name, given in zip(one.loops, one.given, strict=True):
            best, loop = one.find_best(given.controller), loops[name]
            if best is None or best.gains is None or given.gains is None or one.keeps(given):
                continue
            new, old = best.gains, given.gains
            terms = (
                (loop.gain, new.kp, old.kp),
                (loop.integral_gain, new.ki, old.ki),
                (loop.derivative_gain, new.kd, old.kd),
            )
            found.update({key: float(f"{a:.3g}") for key, a, b in terms if key and (a or b)})
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class GainTrial:
    """A simulated run with recommended gains by key, beside the run with the present gains.

    Attributes:
        is_better: Whether the run ends nearer to a missed goal, or settles or ends earlier, and no
            later in the other.
        seed: Seed of both runs; None if nothing is random.
    """

    gains: Mapping[str, float]
    ending: str
    present_ending: str
    is_better: bool
    seed: int | None = None


class ChosenGains(NamedTuple):
    """Recommended gains, the wish that they are for, and the runs that tried gains."""

    wanted: WishOptions
    groups: list[Recommended]
    trials: Sequence[GainTrial]


def simulate(scenario: "tl.Scenario | None", changes: Mapping[str, float] = {}) -> "tl.Run | None":
    """Return the run of a scenario with changes; None if it cannot run, or may not."""
    try:
        return None if scenario is None else tl.simulate_run(scenario, changes=changes)
    except TurtlelogError:  # of a law of one's own, for example
        return None


def is_better(run: "tl.Run", other: "tl.Run", loops: Sequence[str]) -> bool:
    """Return whether a run ends better than another one.

    What counts first: whether it ends at its goal, its distance if not, how many loops settle, and
    when. A run that settles earlier must not end later. Of runs that settle at the same time, the
    one that ends earlier and no farther is better. Distances from a missed goal are equal within
    the tolerances of the law, times within a sample.
    """
    end, other_end = find_goal_end(run), find_goal_end(other)
    if end is not None and other_end is not None:
        if end.is_away != other_end.is_away:
            return other_end.is_away
        if end.is_away and abs(end.error_m - other_end.error_m) > end.allowed_m:
            return end.error_m < other_end.error_m
    times_s, other_s = _find_settling_times(run, loops), _find_settling_times(other, loops)
    if len(times_s) != len(other_s):
        return len(times_s) > len(other_s)
    earlier_s = sum(other_s.values()) - sum(times_s.values())
    sample_s = run.duration_s / max(len(run.samples), 1)
    if abs(earlier_s) > sample_s * len(times_s):
        return earlier_s > 0.0 and run.duration_s - other.duration_s <= sample_s
    is_no_farther = end is None or other_end is None or end.error_m <= other_end.error_m
    return is_no_farther and other.duration_s - run.duration_s > sample_s


def tell_end(run: "tl.Run", loops: Sequence[str]) -> str:
    """Return how a run ended, and when its loops settled, without a subject."""
    end, times_s = find_goal_end(run), _find_settling_times(run, loops)
    told = [f"{one} {times_s[one]:.3g} s" if one in times_s else f"{one} none" for one in loops]
    return f"{end.describe() if end else 'ended'} (settling time: {', '.join(told)})"


def _find_settling_times(run: "tl.Run", loops: Sequence[str]) -> dict[str, float]:
    """Return the settling times of the loops that settle [s]."""
    metrics = tl.measure_run(run, only=[f"{loop}.settling_time" for loop in loops])
    values = {loop: metrics[f"{loop}.settling_time"].value for loop in loops}
    return {loop: float(value) for loop, value in values.items() if isinstance(value, float)}


_Design = tuple["tl.theory.Process", float, float, "tl.theory.StepLimits | None"]


def _tell_steps(model: "tl.theory.LoopModel") -> str:
    if model.limits is None:
        return ""
    unit = "rad" if model.loop.signal == "heading" else "m"
    gain = model.require()[1]["process"].gain
    sizes = sorted(one.step for one in model.limits.list_steps(gain))
    low, high = (format_short(size, unit) for size in (sizes[0], sizes[-1]))
    return f"{len(sizes)} steps of {low} to {high}"


def show_gains(gains: "tl.theory.PidGains") -> str:
    """Return gains with their units: `Kp = 4 1/s and Ki = 0.5 1/s^2`."""
    said = [f"Kp = {format_short(gains.kp)} 1/s"]
    said += [f"Ki = {format_short(gains.ki)} 1/s^2"] if gains.ki else []
    said += [f"Kd = {format_short(gains.kd)}"] if gains.kd else []
    return join_words(said)


def tell_step(motion: "tl.theory.StepMotion | tl.theory.PidLoop | None", where: str = "") -> str:
    """Return overshoot and settling time of a stable loop after a step, as text."""
    said = []
    if motion is not None and motion.overshoot_percent is not None:
        percent = motion.overshoot_percent
        told = (
            "no overshoot"
            if percent < tl.theory.EQUAL_PERCENT
            else f"overshoots by {percent:.2f} %"
        )
        said.append(f"{told}{where}")
    if motion is not None and motion.settling_time_s is not None:
        said.append(f"settles in {motion.settling_time_s:.3g} s")
    return ", ".join(said)


def compare_gains(best: "tl.theory.Recommendation", given: "tl.theory.Recommendation") -> str:
    """Return the figures in which recommended gains are better, and worse, than given gains."""
    name = show_gains(given.gains) if given.gains else ""
    if given.margins is None:
        return f"{name} is unstable."
    better: list[str] = []
    worse: list[str] = []
    pairs = zip(_list_figures(best), _list_figures(given), strict=True)
    for (noun, unit, more_is_better), (new, old) in zip(_FIGURES, pairs, strict=True):
        if noun == "settling time" and old is None and new is not None:
            better.append(f"{noun} ({format_short(new, unit)} instead of none)")
        if new is None or old is None:
            continue
        shown, before = format_short(new, unit), format_short(old, unit)
        if shown != before:
            values = f" ({shown} instead of {before})" if unit else ""
            (better if (new > old) == more_is_better else worse).append(f"{noun}{values}")
    if not better:
        return ""
    said = [f"better than {name} in {join_words(better)}"]
    said += [f"worse in {join_words(worse)}"] if worse else []
    return f"{'; '.join(said)}."


_FIGURES: Final = (
    ("overshoot", "%", False),
    ("settling time", "s", False),
    ("gain margin", "", True),
    ("phase margin", "", True),
)
"""Figures of gains: name, unit (the value of a margin is only in the table), and whether more is
better."""


def _list_figures(one: "tl.theory.Recommendation") -> tuple[float | None, ...]:
    """Return the values of the figures; None if unknown."""
    overshoot, settles_s = take_fields(one.motion, "overshoot_percent", "settling_time_s").values()
    if overshoot is not None and overshoot < tl.theory.EQUAL_PERCENT:
        overshoot = 0.0
    factor, phase_rad = take_fields(one.margins, "gain_margin", "phase_margin_rad").values()
    return overshoot, settles_s, factor, None if phase_rad is None else math.degrees(phase_rad)


_RULES: Final = ("overshoot", "phase-margin")
"""Rules that compute gains for given requirements."""

_RULE_NAMES: Final = {"simc": "SIMC", "ziegler-nichols": "Ziegler-Nichols"}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecommendedGains:
    """JSON entry of a rule's gains; None if the reason explains why the rule gives none."""

    rule: str
    controller: str
    source: str
    kp: float | None
    ki: float | None
    kd: float | None
    filter_s: float | None
    overshoot_percent: float | None
    settling_time_s: float | None
    gain_margin: float | None
    phase_margin_rad: float | None
    reason: str | None


def find_kept(recommended: Recommended, loop: str = "") -> float | None:
    """Return the given Kp that needs no change [1/s], of several loops any; else None."""
    given = recommended.given[recommended.loops.index(loop) if loop else 0]
    return given.gains.kp if given.gains and recommended.keeps(given) else None


def take_fields(source: object, *names: str) -> dict[str, Any]:
    """Return fields by name; each is None if the source has none."""
    return {name: getattr(source, name, None) for name in names}


def build_recommended(recommended: Recommended) -> list[RecommendedGains]:
    """Return recommended gains for JSON."""
    return [
        RecommendedGains(
            rule=one.rule,
            controller=one.controller,
            source=one.source,
            **take_fields(one.gains, "kp", "ki", "kd", "filter_s"),
            **take_fields(one.motion, "overshoot_percent", "settling_time_s"),
            **take_fields(one.margins, "gain_margin", "phase_margin_rad"),
            reason=one.reason or None,
        )
        for one in recommended.found
    ]


def tabulate_recommended(
    recommended: Recommended, wishes: WishOptions, *, shows_all: bool
) -> "tl.compare.Table":
    """Return a table of recommended gains."""
    of = f" of {join_words(recommended.loops)}" if recommended.loops else ""
    found = [*dict.fromkeys(recommended.given)]
    found += [one for one in recommended.found if shows_all or one.rule in _RULES]
    column = tl.compare.Column
    columns = (
        column(title="overshoot", unit="%", digits=2, lines=("over-", "shoot")),
        column(title="settles", unit="s", digits=2),
        column(title="gain margin", digits=2, lines=("gain", "margin")),
        column(title="phase margin", unit="deg", digits=1, lines=("phase", "margin")),
    )
    heads = ("", "Kp [1/s]", "Ki [1/s^2]", "Kd", *columns)
    rows = []
    for one in found:
        if one.gains is not None:
            gains = one.gains.kp, one.gains.ki or None, one.gains.kd or None
            rows.append((wishes.tell(one), *gains, *_list_figures(one)))
    notes = _list_notes(recommended, wishes, shows_all=shows_all)
    return build_table(f"Recommended gains{of}", heads, rows, notes)


def _list_notes(recommended: Recommended, wishes: WishOptions, *, shows_all: bool) -> Iterator[str]:
    if recommended.most_dead_time_s is not None:
        most = f"{1e3 * recommended.most_dead_time_s:.6g} ms"
        yield f"They are for the most dead time, {most}."
    motions = [one.motion for one in (*recommended.given, *recommended.found) if one.motion]
    if recommended.steps and motions:
        yield (
            f"Overshoot and settling time are the largest of {recommended.steps},"
            " with all limits. Margins are for small steps."
        )
    if any(motion.settling_time_s is None for motion in motions):
        still = "after 10 oscillations" if recommended.steps else "after 200,000 samples"
        yield f"Without a settling time: the loop still moves {still}."
    if not shows_all:
        return
    ideal = "" if recommended.steps else " and ignores limits"
    yield (
        f"Overshoot includes the motion between samples{ideal}. SIMC: Skogestad (2003);"
        " Ziegler-Nichols (1942): half of the gain at which instability begins."
    )
    reasons: dict[str, list[str]] = {}
    for one in recommended.found:
        if one.reason:
            reasons.setdefault(one.reason, []).append(wishes.tell(one))
    for reason, names in reasons.items():
        yield f"No {join_words(names)}: {reason}."
