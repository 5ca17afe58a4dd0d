"""The values of many measurements, bit for bit: a change of the code under them changes none.

`NPY_DISABLE_CPU_FEATURES="X86_V4 AVX512_ICL AVX512_SPR" python tests/test_known_values.py >
tests/known_values.json` writes the values of today's code. Where it changes one, the commit says
which and why.
"""

import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import turtlelog as tl

ROOT = Path(__file__).parents[1]
KNOWN = Path(__file__).with_name("known_values.json")
WIDER = "X86_V4 AVX512_ICL AVX512_SPR"
"""With these a processor's sines, and what else numpy computes, differ in the last bit."""
SHARED = ROOT.parent / "shared" / "paper"

Make = Callable[[], tl.Run]

CHANGES: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    **{name: (name, {}) for name in tl.PRESETS},
    "full turn": ("paper-kp4", {"start.heading_rad": 3.0, "goal.x_m": 2.0, "goal.y_m": 5.0}),
    "full turn, wrapped": ("textbook", {"start.heading_rad": -3.0, "goal.x_m": 2.0}),
    "cut while rotating": ("paper-kp4", {"max_duration_s": 1.5}),
    "cut in the pause": ("paper-kp4", {"max_duration_s": 3.1}),
    "cut while translating": ("paper-kp4", {"max_duration_s": 4.0}),
    "every fifth pose": ("textbook", {"loop.period_ticks": 5, "law.kp_angular": 4.0}),
    "delayed": ("textbook", {"loop.transport_delay_ticks": 6, "law.kp_linear": 10.0}),
    "delayed turn": ("textbook", {"loop.transport_delay_ticks": 6, "law.kp_angular": 10.0}),
    "double precision": ("textbook", {"loop.pose_precision": "float64"}),
    "no limits": ("textbook", {"limits.speed_m_s": float("inf"), "law.kp_linear": 4.0}),
    "another goal": ("paper-kp10", {"goal.x_m": 2.0, "goal.y_m": 5.6}),
    "goal heading": ("paper-kp2", {"goal.heading_rad": 1.0}),
    "timeout": ("paper-kp1", {"law.timeout_s": 6.0}),
}


def list_runs() -> dict[str, Make]:
    """Return what makes each run, by name; those of the paper's logs only where these are."""
    makes: dict[str, Make] = {
        name: partial(simulate, preset, values) for name, (preset, values) in CHANGES.items()
    }
    for path in sorted((ROOT / "recordings" / "paper").glob("*.mcap")):
        makes[f"recording {path.stem}"] = partial(tl.read_recording, path)
    for path in sorted(SHARED.glob("kp*_210*.*")):
        makes[f"log {path.name}"] = partial(tl.log.import_log, path)
    makes["from sample 50"] = lambda: drop_samples(simulate("paper-kp4", {}), 50)
    makes["from sample 200"] = lambda: drop_samples(simulate("paper-kp4", {}), 200)
    makes["from pose 30"] = lambda: drop_poses(simulate("paper-kp1", {}), 30)
    return makes


def simulate(preset: str, values: dict[str, Any]) -> tl.Run:
    return tl.simulate_run(tl.override_scenario(tl.load_scenario(preset), values))


def drop_samples(run: tl.Run, count: int) -> tl.Run:
    """Return a run whose first samples and commands are lost."""
    return replace(
        run,
        samples=cut(run.samples, slice(count, None)),
        commands=cut(run.commands, slice(count, None)),
    )


def drop_poses(run: tl.Run, count: int) -> tl.Run:
    """Return a run that begins later."""
    samples = run.samples
    kept = int((samples.pose_sequence < count).sum())
    rest = cut(samples, slice(kept, None))
    return replace(
        run,
        poses=cut(run.poses, slice(count, None)),
        samples=replace(rest, pose_sequence=rest.pose_sequence - count),
        commands=cut(run.commands, slice(kept, None)),
    )


def cut(columns: Any, rows: slice) -> Any:
    values = {field.name: getattr(columns, field.name) for field in fields(columns)}
    return replace(
        columns, **{name: found[rows] for name, found in values.items() if found is not None}
    )


def describe(run: tl.Run) -> dict[str, Any]:
    """Return metrics, signals and phases as text that holds every bit."""
    metrics = {
        name: metric.status.value
        if metric.value is None
        else [float(metric.value).hex(), None if metric.at_s is None else metric.at_s.hex()]
        for name, metric in tl.measure_run(run).items()
    }
    return {"metrics": metrics, "signals": dict(digest_signals(run)), "phases": list_phases(run)}


def digest_signals(run: tl.Run) -> Iterator[tuple[str, str]]:
    for name in tl.SIGNALS:
        signal = tl.measure.find_signal(run, name)
        if signal is not None:
            columns = signal.time_ns, np.ascontiguousarray(signal.values)
            yield name, hashlib.sha256(b"".join(map(bytes, columns))).hexdigest()[:16]


def list_phases(run: tl.Run) -> list[Any]:
    return [[span.phase, span.start_ns, span.end_ns] for span in run.find_phase_spans()]


@pytest.fixture(scope="module")
def found() -> Any:
    """Describe all runs in a process in which numpy takes sines as on every processor."""
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        pytest.skip("the last bit of a sine is another elsewhere")
    done = subprocess.run(
        [sys.executable, __file__],
        env={**os.environ, "PYTHONPATH": str(ROOT), "NPY_DISABLE_CPU_FEATURES": WIDER},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", list_runs())
def test_values_are_those_known(name: str, found: Any) -> None:
    known = json.loads(KNOWN.read_text())[name]
    for part, values in known.items():
        assert found[name][part] == values


if __name__ == "__main__":
    described = {name: describe(make()) for name, make in list_runs().items()}
    sys.stdout.write(json.dumps(described, indent=0) + "\n")
