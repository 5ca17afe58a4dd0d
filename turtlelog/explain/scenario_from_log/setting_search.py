"""Search for the loop settings that reproduce a log, by simulating possible settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, product
from math import ceil
from typing import Any, Final

import numpy as np

from turtlelog.explain.scenario_from_log import driven_plant, loop_settings, resimulation
from turtlelog.explain.scenario_from_log.driven_plant import Drive
from turtlelog.explain.scenario_from_log.loop_settings import Guess, Hints, set_pause
from turtlelog.explain.scenario_from_log.resimulation import Depths, Row
from turtlelog.explain.scenario_from_log.trace import Trace
from turtlelog.measure import DeadTime, Missing
from turtlelog.measure.motion import CERTAIN, COARSE, LIKE_THE_BEST
from turtlelog.scenario import Scenario, build_scenario, nest_parameters

_MOST_TICKS: Final = 150_000
"""Largest number of simulated ticks if no setting is exact: about four seconds of work."""

_MOST_BOUNDED: Final = 8
"""Largest number of equally good settings whose starts are bounded together: half a second of
work."""

_FEWEST_ROWS: Final = 150
"""Smallest number of rows over which settings are compared: half a turn at 1 rad/s has 200."""

_MOST_SAMPLES: Final = 100_000
"""Number of simulated samples from which rare queue depths are no longer tried: about three
seconds."""

_SPARE_S: Final = 3.0
"""Time by which a simulation may be longer than the log before it counts as different [s]."""

_USUAL_S: Final = Scenario().max_duration_s

Settings = Mapping[str, Any]

_Exact = tuple[Guess, int]
"""Settings that reproduce every sample, and the number of simulated samples."""

_Driven = tuple[Guess, Drive]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fits:
    """Settings that fit a log.

    Attributes:
        guesses: Values by key of the scenario, the most likely first; at least one.
        scenarios: The same guesses as whole scenarios; empty without a law.
        is_exact: Whether the settings reproduce every sample bit for bit.
        is_close: Whether the settings reproduce every sample within rounding.
        drive: Plant driven with the log's commands and the likeliest settings, if that was needed.
        reproduced: Number of samples, from the first, that the likeliest settings reproduce.
        tried: Number of simulated settings.
        ranges: Values of each key among the tried settings, in ascending order.
        is_driven: Whether the plant was driven with the log's commands, without a law.
        is_partial: Whether the log is too long to try all settings that may explain its motion.
        hidden: Keys whose value makes no difference in this run.
        bounds: Bounds of the start, if the residual is the rounding of poses alone.
    """

    guesses: tuple[Guess, ...]
    scenarios: tuple[Scenario, ...]
    is_exact: bool
    is_close: bool = False
    drive: Drive | None = None
    reproduced: int
    tried: int
    ranges: Mapping[str, tuple[Any, ...]]
    is_driven: bool = False
    is_partial: bool = False
    hidden: frozenset[str] = frozenset()
    bounds: driven_plant.StartBounds | None = None

    @property
    def is_reproduced(self) -> bool:
        """Whether the settings reproduce every sample, bit for bit or within rounding."""
        return self.is_exact or self.is_close

    @property
    def scenario(self) -> Scenario:
        """The most likely scenario."""
        return self.scenarios[0]

    @property
    def is_fitted(self) -> bool:
        """Whether the settings explain the motion within noise."""
        return self.drive is not None and self.drive.explains

    def list_values(self, key: str) -> tuple[Any, ...]:
        """Return the values of a key, the most likely first."""
        return tuple(dict.fromkeys(guess[key] for guess in self.guesses))


def search_loop(
    trace: Trace,
    known: Settings,
    hints: Hints,
    dead_times: Sequence[DeadTime | Missing],
    *,
    recorded: Guess | None = None,
) -> Fits:
    """Return the loop settings that reproduce a log; `known` contains all other settings.

    The usual queue depths are tried first, after `recorded` settings, if any. Other depths are
    tried if the usual ones do not fit, or fit only with a pause or an initial queue that the clock
    contradicts. If no setting is exact, the plant is driven with the log's own commands, and the
    settings that explain the motion best are returned. `dead_times` are those of the loops, in the
    order in which they act; at least one.
    """
    search = _Search(trace, known, hints)
    tiers = loop_settings.list_queues(trace, hints, dead_times[0], dead_times[-1])
    if recorded is not None:
        others = [[guess for guess in tier if guess != recorded] for tier in tiers]
        tiers = [[recorded, *loop_settings.list_neighbours(recorded)], *others]
    found = search.find_in_tiers(tiers)
    if found is None:
        likeliest = search.find_likeliest(next(filter(None, tiers)))
        found = search.start_between_floats(tiers, likeliest)
        search.to_rounding = found is None
        found = found or search.find_in_tiers(tiers) or likeliest
    return found


def drive_loop(trace: Trace, hints: Hints, dead_times: Sequence[DeadTime | Missing]) -> Fits:
    """Return the settings with which the log's commands move the plant best; no law is used."""
    search = _Search(trace, {}, hints)
    tiers = loop_settings.list_queues(trace, hints, dead_times[0], dead_times[-1])
    return search.drive_only([guess for tier in tiers for guess in tier])


class _Search:
    """Simulation and counting of scenarios, bit for bit or `to_rounding`.

    Without a law (`is_driven`), the numbers of the answered poses count as well.
    """

    def __init__(self, trace: Trace, known: Settings, hints: Hints) -> None:
        self._trace, self._known, self._hints = trace, dict(known), hints
        self._rows = resimulation.list_recorded_rows(trace)
        # A law without a known pause has none to search.
        self._pauses = pauses = hints.pauses or (None,)
        near = [
            pause for pause in hints.pauses if loop_settings.agrees_with_clock(pause, hints, trace)
        ]
        self._near: Sequence[int | None] = near or pauses
        self._most_s = float(trace.run.end_ns - trace.run.poses.time_ns[0]) / 1e9 + _SPARE_S
        self._tried = self._simulated = 0
        self._is_partial = False
        self._values: dict[str, set[Any]] = {}
        self.to_rounding = self.is_driven = False
        self._base: Scenario | None = None
        self._base_values: Settings = {}
        self._counted: dict[tuple[Any, ...], list[tuple[Depths, int]]] = {}

    def build(self, guess: Settings, **more: Any) -> Scenario:
        """Return the scenario of a guess, which sets only the loop and the pause."""
        known = {**self._known, **more}
        if self._base is None or known != self._base_values:
            name = self._trace.run.name
            usual: Settings = {"name": name, "max_duration_s": self._most_s}
            tables = nest_parameters({**usual, **known, **guess})
            # A search with a law implies that the law may run.
            self._base = build_scenario(tables, source=name, trust_law=True)
            self._base_values = known
        base, values = self._base, dict(guess)
        law = base.law
        if loop_settings.PAUSE_KEY in values:
            pause_ticks = values.pop(loop_settings.PAUSE_KEY)
            law = replace(law, parameters=replace(law.parameters, pause_ticks=pause_ticks))
        loop = {key.removeprefix("loop."): value for key, value in values.items()}
        return replace(base, law=law, loop=replace(base.loop, **loop))

    def find_in_tiers(self, tiers: Sequence[Sequence[Guess]]) -> Fits | None:
        """Return the settings that reproduce every sample; None if no settings do."""
        exact: list[_Exact] = []
        for tier in tiers:
            # Once one setting agrees with the clock, only others that agree count.
            is_settled = any(self.contradict_clock(guess) == (False, False) for guess, _ in exact)
            agreeing = [one for one in tier if one["loop.start_backlog"] in self._hints.backlogs]
            exact += self.find_exact(agreeing if is_settled else tier)
            if self._simulated > _MOST_SAMPLES:
                break
        if not exact:
            return None
        least = min(self.contradict_clock(guess) for guess, _ in exact)
        return self.build_exact_fits(
            [found for found in exact if self.contradict_clock(found[0]) == least]
        )

    def find_exact(self, queues: Sequence[Guess]) -> list[_Exact]:
        """Of the settings that reproduce every sample, return those nearest to the clock."""
        self._note_values(queues, self._pauses)
        first = self._pauses[0]
        rotation = self._rows[: int(self._trace.number[self._trace.rotating - 1]) + 1]
        alike = [
            guess
            for guess in queues
            if self._count(set_pause(guess, first), rotation) >= len(rotation)
        ]
        guesses = [set_pause(guess, pause) for pause, guess in product(self._pauses, alike)]
        guesses.sort(key=self.contradict_clock)
        for _, group in groupby(guesses, key=self.contradict_clock):
            counted = [(guess, self._count(guess, self._rows)) for guess in group]
            exact = [(guess, count) for guess, count in counted if count >= len(self._rows)]
            if exact:
                return exact
        return []

    def contradict_clock(self, guess: Guess) -> tuple[bool, bool]:
        """Return whether time stamps and pose numbers contradict the pause, and the queue."""
        return (
            guess.get(loop_settings.PAUSE_KEY) not in self._near,
            guess["loop.start_backlog"] not in self._hints.backlogs,
        )

    def build_exact_fits(self, exact: Sequence[_Exact]) -> Fits:
        """Return the found settings as scenarios that end with the log."""
        rows = self._rows
        hidden = {
            key
            for key in loop_settings.DEPTHS
            if any(self._count({**one, key: one[key] + 1}, rows) >= len(rows) for one, _ in exact)
        }
        return self._build_fits(
            guesses=tuple(guess for guess, _ in exact),
            scenarios=tuple(
                self._end(self.build(guess), goes_on=count > len(rows)) for guess, count in exact
            ),
            is_exact=not self.to_rounding,
            is_close=self.to_rounding,
            reproduced=len(rows),
            hidden=frozenset(hidden),
        )

    def find_likeliest(self, queues: Sequence[Guess]) -> Fits:
        """Return the settings with which the log's commands move the plant as logged."""
        first = self._near[0]
        before = self._drive(queues, [first], rows=self._trace.rotating)
        guesses = [guess for guess, _ in before] or [set_pause(queues[0], first)]
        agreeing = self._choose_agreeing(self._drive(guesses, self._near, rows=None))
        if not agreeing:
            return self._build_nearest(guesses[:1], [])
        found = self._build_nearest(
            [guess for guess, _ in agreeing], [drive for _, drive in agreeing]
        )
        return replace(found, hidden=self._find_hidden(agreeing))

    def _choose_agreeing(self, driven: Sequence[_Driven]) -> list[_Driven]:
        """Return those of equally good settings that the clock contradicts least."""
        least = min((self.contradict_clock(guess) for guess, _ in driven), default=None)
        return [pair for pair in driven if self.contradict_clock(pair[0]) == least]

    def drive_only(self, queues: Sequence[Guess]) -> Fits:
        """Return the settings with which the log's commands alone move the plant as logged."""
        self.is_driven = True
        self._note_values(queues, self._pauses)
        agreeing = self._choose_agreeing(self._drive(queues, self._pauses, rows=None))
        drives = [drive for _, drive in agreeing]
        return self._build_fits(
            guesses=tuple(guess for guess, _ in agreeing) or (queues[0],),
            scenarios=(),
            is_exact=False,
            drive=driven_plant.join_starts(drives) if drives else None,
            reproduced=0,
            is_driven=True,
            is_partial=self._is_partial,
            hidden=self._find_hidden(agreeing),
        )

    def _find_hidden(self, driven: Sequence[_Driven]) -> frozenset[str]:
        """Return queue depths above which deeper queues move the plant equally."""

        def is_alike(guess: Guess, drive: Drive, key: str) -> bool:
            deeper = {**guess, key: guess[key] + 1}
            found = driven_plant.drive_plant(self._trace, deeper, reads_alike=self.is_driven)
            return found is not None and np.array_equal(found.left, drive.left)

        return frozenset(
            key for key in loop_settings.DEPTHS if any(is_alike(*one, key) for one in driven)
        )

    def start_between_floats(self, tiers: Sequence[Sequence[Guess]], fits: Fits) -> Fits | None:
        """Return settings that reproduce every sample from a start that is not a 32-bit float.

        A plant has such a start if it moved before, as in a second run without a reset.
        """
        poses = np.column_stack([self._trace.xy_m, self._trace.heading_rad])
        if fits.bounds is None or not (poses == poses.astype(np.float32)).all():
            return None
        start, kept = driven_plant.keep_in_world(fits.bounds.middle), self._known
        precise = dict(zip(loop_settings.START_KEYS, start, strict=True))
        self._known = {**kept, **precise, "start.precision": "float64"}
        if found := self.find_in_tiers(tiers):
            return replace(found, bounds=fits.bounds)
        self._known = kept
        return None

    def _drive(
        self, guesses: Sequence[Guess], pauses: Sequence[int | None], *, rows: int | None
    ) -> list[_Driven]:
        """Return the settings that fit equally well, the best first."""
        every = [set_pause(guess, pause) for pause, guess in product(pauses, guesses)]
        if rows is not None:
            # All settings are tried over the first rows, instead of some over all rows.
            enough = max(_MOST_TICKS // (len(every) * self._trace.period_ticks), _FEWEST_ROWS)
            rows = min(rows, enough)
        ticks = (len(self._rows) if rows is None else rows) * self._trace.period_ticks
        ticks += pauses[0] or 0
        tried = every[: max(int(_MOST_TICKS / max(ticks, 1)), 1)]
        self._is_partial |= len(tried) < len(every)
        self._tried += len(tried)
        drive = partial(
            driven_plant.drive_plant, self._trace, rows=rows, reads_alike=self.is_driven
        )
        driven = [(guess, found) for guess in tried if (found := drive(guess)) is not None]
        if not driven:
            return []
        # The residual of the best setting shows how independent the rows are.
        first = min(driven, key=lambda pair: sum(np.log(pair[1].noise)))[1]
        misfits = [one.compute_misfit(first.whiteness) for _, one in driven]
        order = np.argsort(misfits, kind="stable").tolist()
        # Residuals within the quantisation of the poses are as good as the best.
        steps, spans = np.array(self._trace.coarse_steps), np.array([d.spans for _, d in driven])
        most = np.maximum(COARSE * steps, LIKE_THE_BEST * spans[order[0]] + driven_plant.FLOOR)
        within = (spans <= most).all(axis=1) & steps.any()
        return [
            driven[row] for row in order if within[row] or misfits[row] < min(misfits) + CERTAIN
        ]

    def _build_nearest(self, guesses: Sequence[Guess], drives: Sequence[Drive]) -> Fits:
        drive = driven_plant.join_starts([*drives]) if drives else None
        start: dict[str, float] = {}
        if drive is not None:
            start = dict(
                zip(loop_settings.START_KEYS, driven_plant.keep_in_world(drive.start), strict=True)
            )
        self.to_rounding = True
        scenarios = tuple(self._end(self.build(guess, **start), goes_on=False) for guess in guesses)
        reproduced = self._count(guesses[0], self._rows)
        bounds = None
        if len(drives) <= _MOST_BOUNDED:
            found = [driven_plant.bound_start(one, self._trace) for one in drives]
            bounds = driven_plant.join_bounds(found)
        self.to_rounding = False
        return self._build_fits(
            guesses=tuple(guesses),
            scenarios=scenarios,
            is_exact=False,
            drive=drive,
            bounds=bounds,
            is_partial=self._is_partial,
            reproduced=reproduced,
        )

    def _note_values(self, guesses: Sequence[Guess], pauses: Sequence[int | None]) -> None:
        for key, value in (pair for guess in guesses for pair in guess.items()):
            self._values.setdefault(key, set()).add(value)
        if self._hints.pauses:
            self._values.setdefault(loop_settings.PAUSE_KEY, set()).update(pauses)

    def _build_fits(self, **found: Any) -> Fits:
        ranges = {key: tuple(sorted(values)) for key, values in self._values.items()}
        return Fits(tried=self._tried, ranges=ranges, **found)

    def _count(self, guess: Guess, rows: list[Row | None]) -> int:
        self._tried += 1
        scenario = self.build(guess)
        others = frozenset(pair for pair in guess.items() if pair[0] not in loop_settings.DEPTHS)
        start = tuple(
            self._known.get(key) for key in (*loop_settings.START_KEYS, "start.precision")
        )
        key = (others, start, len(rows), self.to_rounding)
        alike, depths = self._counted.setdefault(key, []), resimulation.read_depths(scenario)
        equal = next((equal for needed, equal in alike if depths.hold(needed)), None)
        if equal is None:  # no guess with other sufficient queue depths was simulated
            equal, needed = resimulation.count_equal(scenario, rows, to_rounding=self.to_rounding)
            if depths.hold(needed):
                alike.append((needed, equal))
        self._simulated += equal
        return equal

    def _end(self, scenario: Scenario, *, goes_on: bool) -> Scenario:
        """Return the scenario, ended with a log that was cut off, else with the usual duration."""
        if not goes_on:
            return replace(scenario, max_duration_s=max(_USUAL_S, ceil(self._most_s)))
        end_s = resimulation.find_end_s(self._trace, scenario, len(self._rows))
        return replace(scenario, max_duration_s=end_s)
