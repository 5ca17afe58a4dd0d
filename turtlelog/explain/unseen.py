"""Settings that no identification looks for, and findings where a run has them.

Sensing, disturbances, shaping, chances and rates: in poses and commands they look like one another,
or like the settings that are looked for. The recorded scenario tells them, where its re-simulation
reproduces the run.
"""

from collections.abc import Mapping
from typing import Final

from turtlelog.explain.causes import LOOP_CAUSES, PLANT_CAUSES
from turtlelog.explain.identification import (
    LAW_KEYS,
    LOOP_KEYS,
    Certainty,
    Finding,
    miss,
    take_recorded,
)
from turtlelog.run import Run
from turtlelog.scenario import Scenario, flatten_scenario

_TABLES: Final = ("limits.", "loop.", "plant.", "sensing.", "shaping.", "disturbance.")

_USUAL: Final = frozenset(flatten_scenario(Scenario()))
"""Keys that every scenario has."""

_NAMES: Final = {
    **{
        key: found.name
        for found in (*LOOP_CAUSES, *(one for causes in PLANT_CAUSES.values() for one in causes))
        for key in found.neutral
    },
    "loop.trigger": "a timer",
    "plant.kind": "another plant",
}
"""What a key belongs to; those that only say more of another have none."""

_LOOKED_FOR: Final = (Certainty.EXACT, Certainty.FITTED, Certainty.BOUNDED)


def list_unseen(run: Run) -> list[str]:
    """Return the causes of a run's own scenario that no identification looks for."""
    keys = [key for key in run.parameters if key.startswith(_TABLES) and key not in _USUAL]
    return list(dict.fromkeys(_NAMES[key] for key in keys if key in _NAMES))


def take_findings(
    findings: Mapping[str, Finding], scenario: Scenario, evidence: str
) -> dict[str, Finding]:
    """Return findings with the settings of the recorded scenario, which reproduces the run.

    Settings of the loop are the recorded ones; those of the law are where the samples do not tell
    them, or tell others.
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
    """Return the settings in ticks that the recorded scenario adds seconds to, or replaces."""
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
