"""The samples in a file that holds turtlelog's topics, and not its metadata record."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.laws.sequential_p import DECLARATION as SEQUENTIAL_P
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.recording.head import MAY_BE_ABSENT
from turtlelog.log.recording.topics import CONTROL, CONTROL_COLUMNS, PHASE, POSE
from turtlelog.log.ros2.bag import Bag
from turtlelog.run import Run, SampleColumns
from turtlelog.run.loops import DONE, PAUSE, Declaration

Times = NDArray[np.int64]

_NAMED: Final = "phases are named by /turtle1/phase"
_GUESSED: Final = "phases are named as those of sequential-p, as nothing else names them"
_UNKNOWN: Final = "the law, its loops and its parameters are not known"


def add_samples(run: Run, bag: Bag, start_ns: int) -> Run:
    """Return a run with the samples of its bag, where they fit its poses; a note says so.

    Args:
        run: Of the bag, with the poses of `/turtle1/pose`.
        bag: What it was read from.
        start_ns: The recorder's time at which the run's times are 0 [ns].
    """
    kinds = {(topic.topic, topic.type) for topic in bag.topics if topic.count}
    if (CONTROL.name, CONTROL.schema) not in kinds:
        return run
    names = {name for name, kind in kinds if (name, kind) == (PHASE.name, PHASE.schema)}
    files = bag.read({CONTROL.name, *names})
    found = [of_file[CONTROL.name] for of_file in files if CONTROL.name in of_file]
    phases = [of_file[PHASE.name] for of_file in files if PHASE.name in of_file]
    try:
        time_ns, columns = _join(found)
        written = sum(topic.count for topic in bag.topics if topic.topic == POSE.name)
        _require_fit(run, written, time_ns - start_ns, columns)
    except LogError as err:
        return replace(run, notes={**run.notes, "samples": f"not read: {err}"})
    told = _read_names(phases, time_ns, columns["phase"])
    highest = int(columns["phase"].max())
    samples = SampleColumns(time_ns=time_ns - start_ns, **columns)
    note = f"from {CONTROL.name}; {_GUESSED if told is None else _NAMED}; {_UNKNOWN}"
    return replace(
        run,
        samples=samples,
        declaration=_declare(told, highest),
        absent=("declaration", *(name for name in run.absent if name != "samples")),
        notes={**run.notes, "samples": note},
    )


def _join(found: list[TopicColumns]) -> tuple[Times, dict[str, Any]]:
    """Return time and columns of the samples of all files, by their numbers.

    Raises:
        LogError: Where they are not as turtlelog writes them.
    """
    try:
        fields = {
            name: np.concatenate([columns.fields[name] for columns in found])
            for names in CONTROL_COLUMNS.values()
            for name in names
        }
    except KeyError as err:
        raise LogError(f"the field {err.args[0]} is missing") from err
    order = np.argsort(fields["sequence"], kind="stable")
    time_ns = np.concatenate([columns.log_time_ns for columns in found])[order]
    numbers = fields["sequence"][order].astype(np.int64)
    if (np.diff(numbers) <= 0).any() or (np.diff(time_ns) < 0).any():
        raise LogError("expected numbers and times that rise together, found others")
    columns: dict[str, Any] = {}
    for name, parts in CONTROL_COLUMNS.items():
        values = np.column_stack([fields[part][order] for part in parts])
        kind = np.float64 if values.dtype.kind == "f" else np.int64
        columns[name] = (values if len(parts) > 1 else values[:, 0]).astype(kind)
    return time_ns, {
        name: None if name in MAY_BE_ABSENT and _lacks(name, values) else values
        for name, values in columns.items()
    }


def _lacks(name: str, values: NDArray[np.float64]) -> bool:
    """Return whether a column was not recorded; a sample may have no velocity in the world."""
    unknown = np.isnan(values)
    return bool(unknown.all() if name == "world_velocity_m_s" else unknown.any())


def _require_fit(run: Run, written: int, time_ns: Times, columns: Mapping[str, Any]) -> None:
    """Refuse samples whose numbers of poses are not the rows of the run's.

    Args:
        run: With its poses.
        written: Poses in the file.
        time_ns: When each sample was answered, by the run's clock [ns].
        columns: Of the samples.

    Raises:
        LogError: Where they are not.
    """
    read, poses = columns["pose_sequence"], run.poses
    if written != len(poses):
        raise LogError(f"expected the {written} poses as they are numbered, found {len(poses)}")
    if int(read.max()) >= len(poses):
        raise LogError(f"expected pose {read.max()}, which a sample read, found {len(poses)} poses")
    early = time_ns < poses.time_ns[read]
    if early.any() or (np.diff(read) < 0).any():
        row = int(early.argmax())
        raise LogError(f"expected pose {read[row]} before the sample that read it, found it later")
    speeds = columns["speed_m_s"], columns["turn_rate_rad_s"]
    if not np.isfinite(speeds).all():
        raise LogError("expected commands that are numbers, found nan or infinity")


def _read_names(
    phases: list[TopicColumns], time_ns: Times, phase: NDArray[np.int64]
) -> dict[int, str] | None:
    """Return the names of the phases by their numbers, None where they are not told alike."""
    named: dict[int, str] = {}
    for columns in phases:
        pairs = zip(columns.log_time_ns.tolist(), columns.fields["data"].tolist(), strict=True)
        for at_ns, name in pairs:
            row = int(np.searchsorted(time_ns, at_ns))
            if name in {PAUSE, DONE} or row >= len(time_ns) or time_ns[row] != at_ns:
                continue
            if named.setdefault(int(phase[row]), name) != name:
                return None
    is_whole = {*phase.tolist()} <= {*named}
    return named if is_whole and len({*named.values()}) == len(named) else None


def _declare(named: Mapping[int, str] | None, highest: int) -> Declaration:
    """Return phases without loops, by number; those that nothing names are called by it."""
    usual = dict(enumerate(SEQUENTIAL_P.phase_names))
    if named is None or all(usual.get(number) == name for number, name in named.items()):
        named = usual
    names = [named.get(number, f"phase_{number}") for number in range(max(highest, *named) + 1)]
    return Declaration(phases=dict.fromkeys(names, ()))
