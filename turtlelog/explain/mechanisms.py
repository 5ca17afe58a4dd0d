"""What an implementation adds to the ideal loop, each a switch of the scenario."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, Literal

from turtlelog.errors import ExplainError, suggest_names
from turtlelog.explain.finer import FINER, simulate_finer
from turtlelog.run import Run
from turtlelog.scenario import Scenario, override_scenario
from turtlelog.simulate import simulate_run

_NO_TOLERANCE: Final = 1e-6
"""The heading of a 32-bit pose comes no nearer to the bearing than about 1e-7 rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mechanism:
    """What can be taken out of a scenario.

    Attributes:
        kind: `effect`: it takes part where shares are divided; `property`: it belongs to any loop
            of this kind, and stands beside them, taken out alone.
        meaning: What taking it out means, in one clause.
        without: Values by key of the scenario that take it out.
        is_finer: Whether it takes a finer clock instead.
    """

    kind: Literal["effect", "property"]
    meaning: str
    without: Mapping[str, Any] = field(default_factory=dict)
    is_finer: bool = False


MECHANISMS: Final[Mapping[str, Mechanism]] = MappingProxyType(
    {
        "queue": Mechanism(
            kind="effect",
            meaning="the newest command wins, and no backlog at the start",
            without={"loop.queue_policy": "newest", "loop.start_backlog": 1},
        ),
        "pause": Mechanism(
            kind="effect", meaning="no pause after the rotation", without={"law.pause_ticks": 0}
        ),
        "delay": Mechanism(
            kind="effect", meaning="no transport delay", without={"loop.transport_delay_ticks": 0}
        ),
        "saturation": Mechanism(
            kind="property",
            meaning="no limit of speed and turn rate",
            without={"limits.speed_m_s": math.inf, "limits.turn_rate_rad_s": math.inf},
        ),
        "sampling": Mechanism(
            kind="property",
            meaning=f"a clock {FINER} times finer, dead times unchanged",
            is_finer=True,
        ),
        "float32": Mechanism(
            kind="property", meaning="poses of 64 bits", without={"loop.pose_precision": "float64"}
        ),
        "projection": Mechanism(
            kind="property",
            meaning="projection on the current heading",
            without={"law.projection": "heading"},
        ),
        "wrap": Mechanism(
            kind="effect", meaning="the error wrapped", without={"law.wrap_error": True}
        ),
        "tolerance": Mechanism(
            kind="property",
            meaning=f"tolerances of {_NO_TOLERANCE:g}",
            without={
                "law.heading_tolerance_rad": _NO_TOLERANCE,
                "law.position_tolerance_m": _NO_TOLERANCE,
            },
        ),
    }
)
"""Every mechanism by name."""

EFFECTS: Final = tuple(name for name, found in MECHANISMS.items() if found.kind == "effect")
"""Those that share a deviation among themselves."""


def is_present(scenario: Scenario, name: str) -> bool:
    """Return whether a mechanism is in a scenario: whether taking it out changes a setting.

    Raises:
        ExplainError: Where no mechanism has that name.
    """
    mechanism = find_mechanism(name)
    return mechanism.is_finer or override_scenario(scenario, mechanism.without) != scenario


def simulate_without(scenario: Scenario, names: Iterable[str]) -> Run:
    """Simulate a scenario without some of its mechanisms.

    Raises:
        ExplainError: Where no mechanism has that name.
    """
    mechanisms = [find_mechanism(name) for name in names]
    changes: dict[str, Any] = {}
    for mechanism in mechanisms:
        changes |= mechanism.without
    changed = override_scenario(scenario, changes)
    is_finer = any(mechanism.is_finer for mechanism in mechanisms)
    return simulate_finer(changed) if is_finer else simulate_run(changed)


def find_mechanism(name: str) -> Mechanism:
    """Return a mechanism by name.

    Raises:
        ExplainError: Where no mechanism has that name.
    """
    if name not in MECHANISMS:
        raise ExplainError(f"mechanism: expected {suggest_names(name, MECHANISMS)}, found {name!r}")
    return MECHANISMS[name]
