"""Runs to write, and what it means that two are the same."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog.run import (
    CommandColumns,
    Event,
    Origin,
    PoseColumns,
    Run,
    SampleColumns,
    SourceTopic,
)
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

SHARED = Path(__file__).parents[2].parent / "shared"


STRANGE = Declaration(
    loops=(
        ControlLoop(name="b", signal="heading", command="turn_rate", reference="recorded"),
        ControlLoop(
            name="a",
            signal="distance",
            command="speed",
            reference="zero",
            gain="law.kp",
            limit="law.v",
        ),
    ),
    phases={"two": ("b", "a"), "one": ("a",)},
    states=("time_ns", "integral_2"),
)
"""Of a law with two loops, one of which has a moving reference, two phases and two states."""


def simulate_preset(name: str, **values: Any) -> Run:
    changes = {key.replace("__", "."): value for key, value in values.items()}
    return simulate_run(override_scenario(get_preset(name), changes))


def simulate_short_run() -> Run:
    return simulate_preset("paper", max_duration_s=0.4)


def find_shared(*parts: str) -> Path:
    path = SHARED.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"the recordings of others are not here: {'/'.join(parts)}")
    return path


def make_run(values: NDArray[np.float64], **changes: Any) -> Run:
    """Return a run whose every number is one of `values`, without limits to 32 bits."""
    rows = len(values)
    time_ns = np.arange(rows, dtype=np.int64) * 7
    pairs = np.column_stack([values, values[::-1]])
    columns: dict[str, Any] = {
        "name": "made",
        "source": "test",
        "poses": PoseColumns(
            time_ns=time_ns,
            xy_m=pairs,
            heading_rad=wrap_angle(values),
            speed_m_s=values,
            turn_rate_rad_s=values,
        ),
        "commands": CommandColumns(
            time_ns=time_ns, speed_m_s=values, lateral_speed_m_s=values, turn_rate_rad_s=values
        ),
        "samples": SampleColumns(
            time_ns=time_ns,
            sequence=np.arange(rows) + 3,
            pose_sequence=np.arange(rows),
            phase=np.arange(rows) % 4,
            bearing_rad=values,
            heading_error_rad=values,
            error_xy_m=pairs,
            distance_m=values,
            wanted_speed_m_s=values,
            wanted_turn_rate_rad_s=values,
            speed_m_s=values,
            turn_rate_rad_s=values,
            world_velocity_m_s=pairs,
            states=pairs[:, ::-1].copy(),
            reference_xy_m=np.where(np.arange(rows)[:, None] % 3, pairs, np.nan),
            reference_heading_rad=np.where(np.arange(rows) % 3, values, np.nan),
        ),
        "declaration": STRANGE,
    }
    return Run(**(columns | changes))


def make_bare_run() -> Run:
    """Return a run of one row that lacks what a run may lack, and holds odd texts and numbers."""
    run = make_run(np.array([-0.0]))
    return replace(
        run,
        name="L\u00e4ufer \U0001f422",
        poses=PoseColumns(
            time_ns=np.array([5]), xy_m=np.array([[0.1, 1e300]]), heading_rad=np.array([-0.0])
        ),
        samples=replace(run.samples, wanted_speed_m_s=None),
        goal_xy_m=(0.1, -3.0),
        goal_heading_rad=0.1 + 0.2,
        parameters={"law.kp_linear": 0.1, "limits.speed_m_s": float("inf"), "seed": 3, "a.b": True},
        events=(Event(time_ns=7, kind="wall_hit", text='The "wall" \t \u00fc'),),
        simulated_by={"turtlelog": "0.0.9", "platform": "Plan 9 \u00fc, 64", "": ""},
        absent=("events", "poses.speed_m_s"),
        origin=Origin(
            began_ns=-3,
            poses=SourceTopic(name='/"od m" (a)', type="", frames=("m\u00e4p", "\\")),
            table_run=(2, 3),
            unread_topics=("", "/a"),
            lost="summary",
        ),
        notes={"original_timestamp": "2026-01-22T12:20:06", "": "\\"},
    )


def assert_same(found: Any, expected: Any, place: str = "run") -> None:
    """Compare runs to the last bit, types included."""
    assert type(found) is type(expected), place
    if is_dataclass(expected):
        for column in fields(expected):
            name = column.name
            assert_same(getattr(found, name), getattr(expected, name), f"{place}.{name}")
    elif isinstance(expected, Mapping):
        # TOML puts values before tables.
        assert sorted(found.items()) == sorted(expected.items()), place
        assert repr(sorted(found.items())) == repr(sorted(expected.items())), place
    elif isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype, place
        assert found.shape == expected.shape, place
        assert found.tobytes() == expected.tobytes(), place
    else:
        assert found == expected, place
        assert repr(found) == repr(expected), place
