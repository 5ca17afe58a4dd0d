"""References: recordings, trajectories, or metrics as `turtlelog metrics --json` prints them."""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import msgspec

from turtlelog.check.spec import Spec, list_formula_names
from turtlelog.check.spec_file import require_reference
from turtlelog.check.vocabulary import TRAJECTORY_VALUES, TrajectoryJudge
from turtlelog.errors import CheckError, LogError
from turtlelog.files.text_files import format_toml
from turtlelog.log import (
    ReadChoice,
    read_as_chosen,
    read_run,
    read_trajectory,
    replace_when_complete,
    split_topic,
    write_recording,
)
from turtlelog.log.file_access import name_file, open_file
from turtlelog.log.planar_poses import JOINTS, TRANSFORMS
from turtlelog.log.ros2.bag_rows import open_bag
from turtlelog.measure import Metric, Status, find_metric_kind, measure_run
from turtlelog.run import Run
from turtlelog.scenario import nest_parameters


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricsFile:
    """Metrics in a file, and the scenario and software that produced them.

    Attributes:
        file: Name of the file.
        metrics: Metrics by id.
        scenario: Scenario of the run as TOML; empty if the file has no scenario.
        simulated_by: Software versions, as in `Run`.
    """

    file: str
    metrics: Mapping[str, Metric]
    scenario: str = ""
    simulated_by: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class ReferenceFile:
    """A file with which recordings are compared.

    Attributes:
        path: A recording, or metrics (.json).
        claims: Folder in which all processes of a session note which file they write from which
            recording; `matches` then writes the file anew. None: `matches` compares.
        is_written: Whether the file was written.
    """

    path: Path
    claims: Path | None = None
    is_written: bool = False

    def __repr__(self) -> str:
        return f"<reference {self.path}>"

    def load(self) -> Run | MetricsFile:
        """Return the run or metrics in the file; CheckError if it is missing or has no metrics."""
        return load_reference(self.path)

    def accept(self, run: Run, source: Path) -> None:
        """Write the file from a run; CheckError if one session writes it from two recordings."""
        self._claim(source.resolve())
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as err:
            raise CheckError(
                f"{self.path}: expected a place for it, found: {err.strerror}"
            ) from err
        if self.path.suffix.lower() == ".json":
            with replace_when_complete(self.path) as part:
                part.write_text(format_metrics(run, source.name), encoding="utf-8")
        elif self.path.resolve() != source.resolve():
            write_recording(run, self.path)
        self.is_written = True

    def _claim(self, source: Path) -> None:
        """Note the source of the file; raise an error if another process noted another source."""
        if self.claims is None:
            return
        self.claims.mkdir(parents=True, exist_ok=True)
        claim = self.claims / sha256(str(self.path.resolve()).encode()).hexdigest()
        draft = Path(mkdtemp(dir=self.claims))
        (draft / "source").write_text(str(source), encoding="utf-8")
        try:
            draft.rename(claim)
        except OSError:  # the first source noted is in the file
            rmtree(draft)
        first = (claim / "source").read_text(encoding="utf-8")
        if first != str(source):
            raise CheckError(
                f"{self.path}: expected one recording to accept, found {first} and {source};"
                " a name with {stem} gives each its own reference"
            )


def load_reference(path: Path) -> Run | MetricsFile:
    """Return the run or the metrics in a file."""
    if not path.exists():
        raise CheckError(
            f"{path}: expected a reference, found no such file; --turtlelog-accept writes it"
        )
    return read_metrics_file(path) or read_run(path)


def format_metrics(run: Run, file: str) -> str:
    """Return the metrics of a run as `turtlelog metrics --json` prints them, with their origin."""
    metrics = [metric.to_dict() for metric in measure_run(run).values()]
    entry: dict[str, Any] = {"file": file, "name": run.name, "metrics": metrics}
    if run.scenario_is_complete:
        entry["scenario"] = format_toml(nest_parameters(run.parameters))
    if run.simulated_by:
        entry["simulated_by"] = dict(run.simulated_by)
    return json.dumps([entry], indent=2) + "\n"


def read_metrics_file(path: Path) -> MetricsFile | None:
    """Return the metrics of a file (.json); None for a file of another kind, such as a log."""
    if path.suffix.lower() != ".json":
        return None
    with name_file(path, expected="a recording or metrics"), open_file(path) as stream:
        data = stream.read()
    try:
        found: Any = json.loads(data.decode())
    except (ValueError, RecursionError):
        return None
    if isinstance(found, list) and found and all(map(_has_metrics, found)):
        if len(found) > 1:
            raise CheckError(f"{path}: expected the metrics of one run, found {len(found)}")
        found = found[0]
    if not _has_metrics(found):
        return None
    metrics = [
        _parse_metric(entry, f"{path}: metrics[{i}]") for i, entry in enumerate(found["metrics"])
    ]
    if not metrics:
        raise CheckError(f"{path}: metrics: must not be empty")
    return MetricsFile(
        file=str(path),
        metrics={metric.id: metric for metric in metrics},
        scenario=_parse_entry(found, "scenario", str, path),
        simulated_by=_parse_entry(found, "simulated_by", dict[str, str], path),
    )


def _parse_entry(found: Mapping[str, Any], name: str, kind: Any, path: Path) -> Any:
    """Return an entry of a file; empty if the entry is missing."""
    try:
        return msgspec.convert(found.get(name, kind()), type=kind)
    except msgspec.ValidationError as err:
        raise CheckError(f"{path}: {name}: {err}") from err


def _has_metrics(found: Any) -> bool:
    return isinstance(found, dict) and isinstance(found.get("metrics"), list)


def _parse_metric(entry: Any, place: str) -> Metric:
    found = entry.get("id") if isinstance(entry, dict) else entry
    kind = find_metric_kind(found) if isinstance(found, str) else None
    if not isinstance(entry, dict) or kind is None:
        raise CheckError(f"{place}.id: expected the id of a metric, found {found!r}")
    unit, value, status = entry.get("unit"), entry.get("value"), entry.get("status")
    # For any loop the unit is `deg or m` if it depends on the controlled signal.
    if unit not in (kind.unit, *kind.unit.split(" or ")):
        raise CheckError(f"{place}.unit: expected {kind.unit}, found {unit!r}")
    if status not in list(Status):
        raise CheckError(f"{place}.status: expected one of a metric, found {status!r}")
    if (status == Status.OK) != _is_finite(value):
        raise CheckError(f"{place}.value: expected one that goes with {status}, found {value!r}")
    reason = entry.get("reason") or ""
    return Metric(id=entry["id"], value=value, unit=unit, status=Status(status), reason=str(reason))


def _is_finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max


def read_reference_run(spec: Spec, topics: ReadChoice | None = None) -> Run | MetricsFile | None:
    """Return the run or metrics to which tolerances refer; None if no reference is needed.

    `topics` are those of the runs, in addition to the specification's. A topic that the reference
    does not have gets the default. The reference must always be complete.
    """
    require_reference(spec)
    if not spec.tolerances or spec.reference is None:
        return None
    if (metrics := read_metrics_file(spec.reference)) is not None:
        _require_metrics(spec, metrics)
        return metrics
    choice = _restrict(spec.read.override(topics or ReadChoice()), spec.reference)
    return read_as_chosen(spec.reference, choice)


def _require_metrics(spec: Spec, reference: MetricsFile) -> None:
    """Raise an error for tolerances to which a file of metrics cannot be compared."""
    if spec.tolerances.signals:
        name = next(iter(spec.tolerances.signals))
        raise CheckError(
            f"{spec.source}: [signals.{name}] needs a recording as its reference, and"
            f" {reference.file} has metrics alone"
        )
    missing = next((one for one in spec.tolerances.metrics if one not in reference.metrics), None)
    if missing is not None:
        raise CheckError(f"{spec.source}: [metrics]: {reference.file} has no metric {missing}")


def read_reference_trajectory(
    spec: Spec, topics: ReadChoice | None = None, *, reads_files: bool = False
) -> TrajectoryJudge | None:
    """Return the judge of errors relative to the reference trajectory; None without a reference.

    `topics` are as in `read_reference_run`. With `reads_files`, runs are named by their files, from
    which poses in space are read.
    """
    names = sorted(list_formula_names(spec.checks) & TRAJECTORY_VALUES.keys())
    if not names:
        return None
    if spec.reference is None:
        raise CheckError(
            f"{spec.source}: {names[0]} needs a trajectory that is true: reference = FILE in the"
            " file, or --reference FILE"
        )
    choice = spec.read.override(topics or ReadChoice())
    if split_topic(spec.reference)[0].exists():
        return TrajectoryJudge(
            reference=read_trajectory(spec.reference, _restrict(choice, spec.reference)),
            settings=spec.trajectory,
            choice=choice,
            reads_files=reads_files,
        )
    raise CheckError(f"{spec.source}: reference: {spec.reference}: no such file")


def _restrict(choice: ReadChoice, path: Path) -> ReadChoice:
    """Return the choice without the topics that a file does not have."""
    try:
        bag = open_bag(split_topic(path)[0])
    except LogError:
        held, is_own = set[tuple[str, str]](), False  # a log, or nothing that can be read
    else:
        held = {(topic.topic, topic.type) for topic in bag.topics if topic.count}
        is_own = any(info.format_version is not None for info in bag.infos.values())
    names = {name for name, _ in held}
    changes: dict[str, Any] = {
        key: name if name in names else None
        for key in ("pose_topic", "command_topic", "path_topic")
        if (name := getattr(choice, key)) is not None
    }
    has_frames = TRANSFORMS in {kind for _, kind in held}
    changes |= {} if has_frames else {"pose_frame": None, "world_frame": None}
    if JOINTS not in {kind for _, kind in held}:
        changes |= {"wheel_joints": None, "wheels": None}
    # A turtlelog recording contains its own goal.
    changes |= {"goal": None} if is_own else {}
    return replace(choice, allow_partial=False, **changes)
