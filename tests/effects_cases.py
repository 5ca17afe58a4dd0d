"""One change of a scenario per effect, for tests of whatever handles runs with effects."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from turtlelog.scenario import Scenario, get_preset, override_scenario

Changes = Mapping[str, Any]

EFFECTS: Final[Mapping[str, Changes]] = MappingProxyType(
    {
        "noise": {"sensing.noise_position_m": 0.01, "sensing.noise_heading_rad": 0.01},
        "bias": {"sensing.bias_position_m": 0.05, "sensing.bias_heading_rad": 0.02},
        "quantum": {"sensing.quantum_position_m": 0.001, "sensing.quantum_heading_rad": 0.0005},
        "dropout": {"sensing.dropout_probability": 0.2},
        "outlier": {
            "sensing.outlier_probability": 0.05,
            "sensing.outlier_m": 0.5,
            "sensing.outlier_rad": 0.3,
        },
        "sensing_delay": {"sensing.delay_s": 0.021},
        "sensing_jitter": {"sensing.jitter_s": 0.02},
        "transport_delay": {"loop.transport_delay_s": 0.05},
        "transport_jitter": {"loop.jitter_s": 0.05},
        "loss": {"loop.loss_probability": 0.2},
        "repeat": {"loop.repeat_probability": 0.2, "loop.queue_policy": "one-per-tick"},
        "late": {"loop.late_probability": 0.1, "loop.late_s": 0.08},
        "timer": {"loop.trigger": "timer", "loop.period_s": 0.03},
        "disturbance": {
            "disturbance.speed_m_s": 0.1,
            "disturbance.turn_rate_rad_s": -0.05,
            "disturbance.from_s": 0.3,
            "disturbance.to_s": 1.1,
        },
        "disturbance_noise": {
            "disturbance.noise_speed": 0.02,
            "disturbance.noise_turn_rate": 0.02,
        },
        "low_pass": {"shaping.low_pass_s": 0.1},
        "dead_zone": {"shaping.dead_zone_speed_m_s": 0.1},
        "command_quantum": {
            "shaping.quantum_speed_m_s": 0.05,
            "shaping.quantum_turn_rate_rad_s": 0.0005,
        },
        "acceleration": {"limits.acceleration_m_s2": 1.0, "limits.turn_acceleration_rad_s2": 2.0},
        "jerk": {
            "limits.acceleration_m_s2": 1.0,
            "limits.turn_acceleration_rad_s2": 2.0,
            "limits.jerk_m_s3": 5.0,
            "limits.turn_jerk_rad_s3": 10.0,
        },
        "lagged": {
            "plant.kind": "lagged",
            "plant.period_s": 0.05,
            "plant.speed_gain": 0.9,
            "plant.speed_dead_time_s": 0.08,
            "plant.speed_lag_s": 0.1,
            "plant.turn_gain": 1.1,
            "plant.turn_dead_time_s": 0.06,
            "plant.turn_lag_s": 0.15,
        },
        "robot_limits": {
            "plant.kind": "lagged",
            "plant.speed_lag_s": 0.1,
            "plant.speed_acceleration": 0.8,
            "plant.speed_bound": 0.7,
            "plant.speed_deadband": 0.02,
            "plant.speed_reverse_gain": 0.6,
            "plant.turn_gain": 0.9,
            "plant.turn_acceleration": 2.0,
            "plant.turn_bound": 0.8,
            "plant.turn_deadband": 0.01,
            "plant.turn_friction": 0.01,
            "plant.turn_reverse_gain": 1.1,
        },
    }
)
"""What turns each effect on, by a name for it; on top of any preset."""

RANDOM: Final = frozenset(
    {
        "noise",
        "dropout",
        "outlier",
        "sensing_jitter",
        "transport_jitter",
        "loss",
        "repeat",
        "late",
        "disturbance_noise",
    }
)
"""Those that draw random numbers."""

SENSED: Final = frozenset({"noise", "bias", "quantum", "dropout", "outlier"})
"""Those with which the controller reads other poses than the plant's: `poses.sensed_*`."""

SHAPED: Final = frozenset({"low_pass", "dead_zone", "command_quantum"})
"""Those with which commands are shaped: `samples.shaped_*`."""


def build_case(
    *effects: str, preset: str = "textbook", max_duration_s: float = 60.0, **changes: Any
) -> Scenario:
    """Return a preset with effects and more changes, `loop__seed` for `loop.seed`."""
    values: dict[str, Any] = {"max_duration_s": max_duration_s}
    for effect in effects:
        values |= EFFECTS[effect]
    values |= {key.replace("__", "."): value for key, value in changes.items()}
    return override_scenario(get_preset(preset), values)
