"""References of a run, and the results of comparing a run with one: a recording or metrics."""

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any, Final, TypeAlias

import msgspec

from turtlelog import measure
from turtlelog.check.result import CheckResult, JudgedSignal, Verdict, fail_recording
from turtlelog.check.spec import Tolerances, choose_signals
from turtlelog.check.spec_file import load_tolerances
from turtlelog.compare import Tolerance
from turtlelog.compare.common_clock import find_zero_ns
from turtlelog.compare.difference import compare_metrics, compare_signals, explain_lack
from turtlelog.display import format_number, format_pair
from turtlelog.errors import CheckError
from turtlelog.files.text_files import format_toml
from turtlelog.files.urls import make_path
from turtlelog.log import read_run, replace_when_complete, write_recording
from turtlelog.log.file_access import name_file, open_file
from turtlelog.replay import Difference, LawReplay, LoopReplay, PlantReplay, SignalDifference
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
    metrics: Mapping[str, measure.Metric]
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
    metrics = [metric.to_dict() for metric in measure.measure_run(run).values()]
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
    entries = enumerate(found["metrics"])
    metrics = [_parse_metric(entry, f"{path}: metrics[{number}]") for number, entry in entries]
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


def _parse_metric(entry: Any, place: str) -> measure.Metric:
    found = entry.get("id") if isinstance(entry, dict) else entry
    kind = measure.find_metric_kind(found) if isinstance(found, str) else None
    if not isinstance(entry, dict) or kind is None:
        raise CheckError(f"{place}.id: expected the id of a metric, found {found!r}")
    unit, status = entry.get("unit"), entry.get("status")
    value: Any = entry.get("value")
    # For any loop the unit is `deg or m` if it depends on the controlled signal.
    if unit not in (kind.unit, *kind.unit.split(" or ")):
        raise CheckError(f"{place}.unit: expected {kind.unit}, found {unit!r}")
    if status not in list(measure.Status):
        raise CheckError(f"{place}.status: expected one of a metric, found {status!r}")
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    is_finite = is_number and abs(value) <= sys.float_info.max
    if (status == measure.Status.OK) != is_finite:
        raise CheckError(f"{place}.value: expected one that goes with {status}, found {value!r}")
    reason = entry.get("reason") or ""
    return measure.Metric(
        id=entry["id"], value=value, unit=unit, status=measure.Status(status), reason=str(reason)
    )


AnyTolerance: TypeAlias = Tolerance | Tolerances | str | Path | None
AnyReference: TypeAlias = (
    Run | ReferenceFile | MetricsFile | Mapping[str, measure.Metric] | str | Path
)

_OF_MOTION: Final = ("distance", "speed", "turn_rate")
"""Signals shown around a violation that has no signal of its own."""

_SIGNALS_APART: Final = Tolerance(abs=1e-6, reason="other platforms round otherwise")
_METRICS_APART: Final = Tolerance(abs=1e-9, rel=1e-6, reason="other platforms round otherwise")


def match_run(
    run: Run,
    reference: AnyReference,
    tolerance: AnyTolerance = None,
    *,
    file: str = "",
    alignment: str = "first_sample",
) -> list[CheckResult]:
    """Return the results of comparing a run with a reference.

    Args:
        run: Run that is judged.
        reference: A run, its file, or metrics. If the reference is metrics, a value that is missing
            there must also be missing in the run.
        tolerance: Tolerance of every signal or metric; `Tolerances` or a file of them select the
            signals and metrics to judge. None: signals may differ by 1e-6, and metrics may be worse
            by a millionth.
        file: Name of the run in results; empty: the run's own name.
        alignment: Alignment, as in `compare_runs`.

    Raises:
        CheckError: If the reference cannot be read, or the tolerance does not fit it.
        CompareError: If there is no such alignment, or the runs do not overlap.
    """
    if isinstance(reference, ReferenceFile):
        reference = reference.path
    if isinstance(reference, str | Path):
        reference = load_reference(make_path(reference))
    if isinstance(tolerance, str | Path):
        tolerance = load_tolerances(tolerance)
    if isinstance(tolerance, Tolerances) and not tolerance:
        raise CheckError("tolerance: names no signal or metric")
    if not isinstance(reference, Run):
        metrics = reference.metrics if isinstance(reference, MetricsFile) else reference
        results = _match_metrics(run, metrics, tolerance)
    elif isinstance(tolerance, Tolerances):
        results = [*_judge_run(run, reference, tolerance, alignment)]
    else:
        tolerances = _spread(run, reference, tolerance or _SIGNALS_APART)
        length = _judge_length(run, reference, 0.0 if tolerance is None else tolerance.time_s)
        results = [*_judge_run(run, reference, tolerances, alignment), length]
    shown = reference if isinstance(reference, Run | MetricsFile) else None
    return [replace(one, file=file or run.name, reference=shown) for one in results]


def judge_replay(
    run: Run, found: LawReplay | LoopReplay | PlantReplay, *, file: str
) -> list[CheckResult]:
    """Return whether a replay equals the recording: every signal, numbers of rows, and the end."""
    mode = {LawReplay: "law", LoopReplay: "loop", PlantReplay: "plant"}[type(found)]
    verb = "the law answers" if mode == "law" else "replayed"

    def describe(difference: Difference) -> str:
        unit = units.get(difference.signal, "")
        recorded, replayed = format_pair(difference.recorded, difference.replayed, unit)
        return f"recorded {recorded}, {verb} {replayed}"

    units = {signal.signal: signal.unit for signal in found.signals}
    known = measure.list_signals(run.declaration)
    signals = [
        replace(
            _judge_signal(signal, f"{mode}.{signal.signal}", run.start_ns, describe),
            file=file,
            expected="as recorded",
            names=(signal.signal,) if signal.signal in known else ("speed", "turn_rate"),
        )
        for signal in found.signals
    ]
    others = [
        CheckResult(
            file=file,
            check=f"{mode}.{other.signal}",
            verdict=Verdict.FAIL,
            expected="as recorded",
            first_violation_s=(other.time_ns - run.start_ns) / 1e9,
            reason=describe(other),
            names=_OF_MOTION,
        )
        for other in found.others
    ]
    return [*signals, *others]


def _judge_run(
    run: Run, reference: Run, tolerances: Tolerances, alignment: str
) -> Iterator[CheckResult]:
    differences = compare_signals(reference, run, tolerances.signals, alignment=alignment)
    zero_ns = find_zero_ns(run, alignment, reference)
    start_ns = run.start_ns - zero_ns  # zero of the times in results

    def describe(difference: Difference) -> str:
        sides = (difference.replayed, difference.recorded)
        at_s = (difference.time_ns - start_ns) / 1e9
        return f"{_tell_sides(sides, units[difference.signal])} at {at_s:.3f} s"

    units = measure.list_signal_units([reference.declaration, run.declaration])
    for name, tolerance in tolerances.signals.items():
        check, names = f"signals.{name}", choose_signals([name], run.declaration)
        if name not in differences:
            reason = explain_lack(name, reference, run)
            yield _leave_open(check, units.get(name, ""), reason, names)
            continue
        found = differences[name]
        expected = f"within {format_number(found.limit, found.unit)} of the reference"
        if tolerance.time_s and alignment == "sample":
            expected = f"{expected}, sample by sample: no tolerance in time applies"
        elif tolerance.time_s:
            expected = f"{expected} within {tolerance.time_s:g} s"
        judged = JudgedSignal(
            name=name, reference=reference, tolerance=tolerance, alignment=alignment
        )
        result = _judge_signal(found, check, start_ns, describe)
        yield replace(result, expected=expected, names=names, judged=judged)
    known = measure.list_metrics(reference.declaration, run.declaration)
    for pair in compare_metrics(reference, run, list(tolerances.metrics)):
        metric, names = pair.metric, choose_signals([pair.metric.id], run.declaration)
        if metric.id in known:
            tolerance = tolerances.metrics[metric.id]
            yield _judge_metric(metric, pair.reference, tolerance, names, is_strict=True)
        else:
            yield _leave_open(f"metrics.{metric.id}", metric.unit, metric.lack, names)


def _judge_signal(
    found: SignalDifference, check: str, start_ns: int, describe: Callable[[Difference], str]
) -> CheckResult:
    """Return the verdict on a signal. A value that is missing on one side has no distance."""
    first, furthest = found.first_difference, found.largest_difference
    margin = found.limit - found.largest
    has_distance = math.isfinite(margin) and (first is None or margin < 0)
    told = furthest if has_distance and furthest is not None else first
    return CheckResult(
        file="",
        check=check,
        verdict=Verdict.PASS if first is None else Verdict.FAIL,
        value=found.largest if has_distance else None,
        limit=found.limit,
        margin=margin if has_distance else None,
        unit=found.unit,
        value_s=(furthest.time_ns - start_ns) / 1e9 if has_distance and furthest else None,
        first_violation_s=None if first is None else (first.time_ns - start_ns) / 1e9,
        reason="" if first is None or told is None else describe(told),
    )


def _judge_metric(
    metric: measure.Metric,
    reference: measure.Metric,
    tolerance: Tolerance,
    names: tuple[str, ...],
    *,
    is_strict: bool,
) -> CheckResult:
    """Return the verdict on a metric, which fails in its bad direction or with another status.

    If neither has a value, the metric passes unless `is_strict`.
    """
    check, unit = f"metrics.{metric.id}", metric.unit
    if metric.value is None or reference.value is None:
        is_same = metric.status == reference.status
        reason = f"same status as the reference: {_tell_status(metric)}"
        if not is_same:
            reason = f"{_tell_status(metric)}, where the reference has {_tell_status(reference)}"
        found = _leave_open(check, unit, reason, names)
        if is_strict or not is_same:
            return found
        return replace(found, verdict=Verdict.PASS, is_decided=True)
    kind = measure.find_metric_kind(metric.id)
    if kind is None or metric.unit != reference.unit:
        reason = f"in {metric.unit}, where the reference has {reference.unit}: not compared"
        return _leave_open(check, unit, reason, names)
    off = kind.compute_loss(metric.value, reference.value)
    limit = max(tolerance.abs, tolerance.rel * abs(reference.value))
    reason = _tell_sides((metric.value, reference.value), unit)
    expected = f"within {format_number(limit, unit)} of the reference"
    return _judge_distance(check, off, limit, unit, reason, expected=expected, names=names)


def _judge_distance(
    check: str, off: float, limit: float, unit: str, reason: str, **more: Any
) -> CheckResult:
    """Return the verdict on a distance, with the reason if it is beyond its limit."""
    verdict, told = (Verdict.PASS, "") if off <= limit else (Verdict.FAIL, reason)
    numbers: Any = {"value": off, "limit": limit, "margin": limit - off, "unit": unit}
    return CheckResult(file="", check=check, verdict=verdict, reason=told, **numbers, **more)


def _leave_open(check: str, unit: str, reason: str, names: tuple[str, ...]) -> CheckResult:
    """Return that a metric or signal cannot be judged, which does not count as a pass."""
    return replace(fail_recording("", reason), check=check, unit=unit, names=names)


def _tell_sides(sides: tuple[float | str | None, ...], unit: str) -> str:
    texts = [side if isinstance(side, str) else format_number(side, unit) for side in sides]
    return f"{texts[0]} where the reference has {texts[1]}"


def _tell_status(metric: measure.Metric) -> str:
    return metric.lack if metric.reason else metric.status.value


def _spread(run: Run, reference: Run, tolerance: Tolerance) -> Tolerances:
    """Return one tolerance for every signal that either run contains."""
    label = replace(tolerance, abs=0.0, rel=0.0)
    kinds = {**measure.list_signals(run.declaration), **measure.list_signals(reference.declaration)}
    return Tolerances(
        signals={
            name: label if kinds[name].compared_as == "label" else tolerance
            for name in measure.list_signal_units([run.declaration, reference.declaration])
            if any(measure.find_signal(found, name) is not None for found in (run, reference))
        }
    )


def _judge_length(run: Run, reference: Run, window_s: float) -> CheckResult:
    """Return whether both runs have the same length; signals are compared on the overlap."""
    lengths_s = [(found.end_ns - found.start_ns) / 1e9 for found in (run, reference)]
    off_s, limit_s = abs(lengths_s[0] - lengths_s[1]), max(window_s, 1e-6)
    reason, expected = (
        f"{lengths_s[0]:g} s long, not {lengths_s[1]:g} s",
        "as long as the reference",
    )
    more = {"first_violation_s": None if off_s <= limit_s else min(lengths_s), "names": _OF_MOTION}
    return _judge_distance("length", off_s, limit_s, "s", reason, expected=expected, **more)


def _match_metrics(
    run: Run, reference: Mapping[str, measure.Metric], tolerance: Tolerance | Tolerances | None
) -> list[CheckResult]:
    if isinstance(tolerance, Tolerances):
        if tolerance.signals:
            name = next(iter(tolerance.signals))
            raise CheckError(f"tolerance: expected metrics alone, as the reference's: {name}")
        wanted = dict(tolerance.metrics)
    else:
        wanted = dict.fromkeys(reference, tolerance or _METRICS_APART)
    missing = sorted(wanted.keys() - reference.keys())
    if missing:
        raise CheckError(f"reference: has no metric {missing[0]}")
    measured = measure.measure_run(run, only=list(wanted))
    shown = {name: choose_signals([name], run.declaration) for name in wanted}
    return [
        _judge_metric(measured[name], reference[name], limit, shown[name], is_strict=False)
        for name, limit in wanted.items()
    ]
