"""Add noise to the poses that the controller reads."""

from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Action, Effect, Size, Stream, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseKeys:
    """Noise of the poses that the controller reads; x and y have independent noise of equal size.

    Attributes:
        noise_position_m: Standard deviation of the noise of both x and y [m].
        noise_heading_rad: Standard deviation of the noise of the heading [rad].
    """

    noise_position_m: Size = absent(0.0)
    noise_heading_rad: Size = absent(0.0)


def add_noise(
    settings: Any, drawn: Any, value: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the pose that the controller reads."""
    noise_m, noise_rad = settings.sensing.noise_position_m, settings.sensing.noise_heading_rad
    if noise_m == 0.0 and noise_rad == 0.0:
        return value
    x_m, y_m, heading_rad = value
    x_m += noise_m * drawn.x
    y_m += noise_m * drawn.y
    heading_rad += noise_rad * drawn.heading
    return x_m, y_m, heading_rad


_NEUTRAL = {"sensing.noise_position_m": 0.0, "sensing.noise_heading_rad": 0.0}

PART = Effect(
    name="noise",
    tables={"sensing": NoiseKeys},
    actions={
        "sense": Action(
            step=add_noise,
            stream=Stream(
                number=0, kind="normal", fields=("x", "y", "heading"), keys=tuple(_NEUTRAL)
            ),
        )
    },
    causes=(
        Cause(
            name="noise", kind="effect", neutral=_NEUTRAL, meaning="poses are read without noise"
        ),
    ),
)
