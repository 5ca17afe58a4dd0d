"""Runs to replay, and recordings with one value changed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario

LAW = """
import dataclasses
from turtlelog.laws import Decision


@dataclasses.dataclass(frozen=True)
class Nothing:
    after: int = 3


class Law:
    Parameters = Nothing

    def __init__(self, parameters):
        self.left = parameters.after

    def reset(self, start, goal, path):
        pass

    def step(self, time_ns, pose):
        self.left -= 1
        if self.left < 0:
            {fails}
        return Decision(speed_m_s=0.0, turn_rate_rad_s=0.0{also})
"""


def write_law(path: Path, *, fails: str = "pass", also: str = "") -> str:
    """Write a law that stands still for a few samples, and return its kind."""
    path.write_text(LAW.format(fails=fails, also=also), encoding="utf-8")
    return f"{path}:Law"


def change_value(run: Run, table: str, column: str, row: Any, value: float) -> Run:
    columns = getattr(run, table)
    values = getattr(columns, column).copy()
    values[row] = value
    return replace(run, **{table: replace(columns, **{column: values})})


def change_scenario(preset: str, /, **values: Any) -> Scenario:
    return override_scenario(
        get_preset(preset), {key.replace("__", "."): value for key, value in values.items()}
    )


_WITHIN = st.floats(min_value=0.5, max_value=10.5)

scenarios = st.builds(
    change_scenario,
    st.sampled_from(["paper", "textbook"]),
    max_duration_s=st.floats(min_value=1.0, max_value=9.0),
    start__x_m=_WITHIN,
    start__y_m=_WITHIN,
    start__heading_rad=st.floats(min_value=-3.0, max_value=3.0),
    goal__x_m=_WITHIN,
    goal__y_m=_WITHIN,
    law__kp_angular=st.floats(min_value=0.1, max_value=30.0),
    law__kp_linear=st.floats(min_value=0.1, max_value=30.0),
    law__pause_ticks=st.integers(min_value=0, max_value=40),
    law__wrap_error=st.booleans(),
    law__projection=st.sampled_from(["bearing", "heading"]),
    limits__speed_m_s=st.floats(min_value=0.1, max_value=5.0) | st.just(float("inf")),
    limits__turn_rate_rad_s=st.floats(min_value=0.1, max_value=5.0) | st.just(float("inf")),
    loop__period_ticks=st.integers(min_value=1, max_value=5),
    loop__start_backlog=st.integers(min_value=1, max_value=8),
    loop__queue_policy=st.sampled_from(["one-per-tick", "newest"]),
    loop__transport_delay_ticks=st.integers(min_value=0, max_value=6),
    loop__pose_precision=st.sampled_from(["float32", "float64"]),
)
