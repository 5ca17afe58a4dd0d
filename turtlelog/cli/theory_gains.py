"""Recommended gains as one small table and as JSON."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.display import join_words
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog.compare import Cell, Table
    from turtlelog.theory import LoopModel, Process, Recommendation


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WishOptions:
    """What recommended gains shall give.

    Attributes:
        overshoot: Recommend gains for this overshoot [% of the step], from 0 to below 100; 5 unless
            --phase-margin stands alone.
        phase_margin: Recommend gains for this phase margin [deg], above 0 and below 180; 60 unless
            --overshoot stands alone.
    """

    overshoot: Annotated[float | None, Parameter(metavar="PERCENT")] = None
    phase_margin: Annotated[float | None, Parameter(metavar="DEGREES")] = None

    def read(self) -> "Wishes":
        """Return what is wanted.

        Raises:
            UsageError: Where a number is out of its range.
        """
        percent, degrees = self.overshoot, self.phase_margin
        if percent is not None and not 0.0 <= percent < 100.0:
            raise UsageError(f"--overshoot {percent}: must be percent from 0 to below 100")
        if degrees is not None and not 0.0 < degrees < 180.0:
            expected = "degrees above 0 and below 180"
            raise UsageError(f"--phase-margin {degrees}: must be {expected}")
        if percent is None and degrees is None:
            return Wishes(
                overshoot_percent=tl.theory.OVERSHOOT_PERCENT,
                phase_margin_rad=tl.theory.PHASE_MARGIN_RAD,
            )
        margin_rad = None if degrees is None else math.radians(degrees)
        return Wishes(overshoot_percent=percent, phase_margin_rad=margin_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """What is wanted, None: nothing.

    Attributes:
        overshoot_percent: Of the step [%].
        phase_margin_rad: In rad.
    """

    overshoot_percent: float | None
    phase_margin_rad: float | None

    def recommend(
        self, process: "Process", period_s: float, filter_s: float = 0.0
    ) -> "tuple[Recommendation, ...]":
        """Return gains for a process with all dead time in it, and its period."""
        return tl.theory.recommend_gains(
            process,
            period_s=period_s,
            filter_s=filter_s,
            overshoot_percent=self.overshoot_percent,
            phase_margin_rad=self.phase_margin_rad,
        )

    def recommend_for(self, models: "Sequence[LoopModel]") -> "list[Recommended]":
        """Return gains for the declared loops that theory knows, alike loops together.

        They are for the most dead time that a loop may have.
        """
        groups: dict[tuple[Process, float, float], list[str]] = {}
        longest_s: dict[str, float] = {}
        for model in tl.theory.list_known(models):
            gains, settings = model.require()
            process = settings["process"]
            if model.most_dead_time_s is not None:
                process = replace(process, dead_time_s=model.most_dead_time_s)
                longest_s[model.loop.name] = model.most_dead_time_s
            key = process, settings["period_s"], gains.filter_s
            groups.setdefault(key, []).append(model.loop.name)
        return [
            Recommended(self.recommend(*key), loops, longest_s.get(loops[0]))
            for key, loops in groups.items()
        ]

    def tell(self, one: "Recommendation") -> str:
        """Return controller and rule in words, for a table."""
        if one.rule in _RULES:
            return f"{one.controller} for {self.describe(one.rule)}".replace("phase ", "")
        return f"{one.controller} by {_RULE_NAMES[one.rule]}"

    def describe(self, rule: str) -> str:
        """Return what a rule gives: `5 % overshoot`, `60 deg phase margin`, or its name."""
        if rule == "overshoot":
            return f"{self.overshoot_percent:g} % overshoot"
        if rule == "phase-margin" and self.phase_margin_rad is not None:
            return f"{math.degrees(self.phase_margin_rad):g} deg phase margin"
        return f"the rule of {_RULE_NAMES[rule]}"


class Recommended(NamedTuple):
    """Gains, the names of the loops that they are for, and the most dead time where it may grow."""

    found: "tuple[Recommendation, ...]"
    loops: Sequence[str] = ()
    most_dead_time_s: float | None = None


_RULES: Final = ("overshoot", "phase-margin")
"""Those that compute gains for what is wanted."""

_RULE_NAMES: Final = {"simc": "SIMC", "ziegler-nichols": "Ziegler-Nichols"}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecommendedGains:
    """Gains of a rule as JSON has them; None where the reason says why."""

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


def build_recommended(recommended: Recommended) -> list[RecommendedGains]:
    """Return recommended gains for JSON."""
    return [_build(one) for one in recommended.found]


def _build(one: "Recommendation") -> RecommendedGains:
    gains, motion, margins = one.gains, one.motion, one.margins
    return RecommendedGains(
        rule=one.rule,
        controller=one.controller,
        source=one.source,
        kp=None if gains is None else gains.kp,
        ki=None if gains is None else gains.ki,
        kd=None if gains is None else gains.kd,
        filter_s=None if gains is None else gains.filter_s,
        overshoot_percent=None if motion is None else motion.overshoot_percent,
        settling_time_s=None if motion is None else motion.settling_time_s,
        gain_margin=None if margins is None else margins.gain_margin,
        phase_margin_rad=None if margins is None else margins.phase_margin_rad,
        reason=one.reason or None,
    )


def tabulate_recommended(recommended: Recommended, wishes: Wishes, *, shows_all: bool) -> "Table":
    """Return a table of recommended gains.

    Args:
        recommended: The gains.
        wishes: What they shall give.
        shows_all: With published rules, and why rules give no gains.
    """
    of = f" of {join_words(recommended.loops)}" if recommended.loops else ""
    found = [one for one in recommended.found if shows_all or one.rule in _RULES]
    return tl.compare.Table(
        title=f"Recommended gains{of}",
        columns=(
            tl.compare.Column(title=""),
            tl.compare.Column(title="Kp", unit="1/s"),
            tl.compare.Column(title="Ki", unit="1/s^2"),
            tl.compare.Column(title="Kd"),
            tl.compare.Column(title="overshoot", unit="%", digits=2, lines=("over-", "shoot")),
            tl.compare.Column(title="settles", unit="s", digits=2),
            tl.compare.Column(title="gain margin", digits=2, lines=("gain", "margin")),
            tl.compare.Column(
                title="phase margin", unit="deg", digits=1, lines=("phase", "margin")
            ),
        ),
        rows=tuple(_list_cells(one, wishes.tell(one)) for one in found if one.gains),
        notes=tuple(_list_notes(recommended, wishes, shows_all=shows_all)),
    )


def _list_cells(one: "Recommendation", name: str) -> "tuple[Cell, ...]":
    gains, motion, margins = one.gains, one.motion, one.margins
    if gains is None:
        return (name,)
    phase_rad = None if margins is None else margins.phase_margin_rad
    return (
        name,
        gains.kp,
        gains.ki or None,
        gains.kd or None,
        None if motion is None else max(motion.overshoot_percent, 0.0),
        None if motion is None else motion.settling_time_s,
        None if margins is None else margins.gain_margin,
        None if phase_rad is None else math.degrees(phase_rad),
    )


def _list_notes(recommended: Recommended, wishes: Wishes, *, shows_all: bool) -> Iterator[str]:
    if recommended.most_dead_time_s is not None:
        most = f"{1e3 * recommended.most_dead_time_s:.6g} ms"
        yield f"They are for the most dead time, {most}."
    if not shows_all:
        return
    yield (
        "Overshoot is that of the motion, between samples too, without limits. SIMC: Skogestad"
        " (2003); Ziegler-Nichols (1942): half of the gain at which instability begins."
    )
    reasons: dict[str, list[str]] = {}
    for one in recommended.found:
        if one.reason:
            reasons.setdefault(one.reason, []).append(wishes.tell(one))
    for reason, names in reasons.items():
        yield f"No {join_words(names)}: {reason}."
