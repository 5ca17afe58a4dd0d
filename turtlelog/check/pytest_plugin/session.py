"""The state of one session: recordings and references, checks, messages and tracebacks."""

import glob
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any, Final, NoReturn

import pytest

from turtlelog.display import describe_count
from turtlelog.errors import LawError, SimulationError, TurtlelogError
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog.check import ArtifactWriter, CheckResult
    from turtlelog.check.recording_fixture import Recording
    from turtlelog.check.reference import ReferenceFile


class Session:
    """State of the session in one process; with xdist, in one worker."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._recordings: dict[tuple[Path, bool, bool, str], Recording] = {}
        self._references: dict[Path, ReferenceFile] = {}
        self._writer: ArtifactWriter | None = None
        self._used: dict[str, Recording] = {}
        self._results: list[tuple[Recording, CheckResult]] = []

    def open_recording(
        self,
        path: Path,
        *,
        allow_partial: bool | None = None,
        trust_law: bool = False,
        **reading: Any,
    ) -> "Recording":
        """Return the recording of a file, one object per file; it is read on first use."""
        from turtlelog.check.recording_fixture import Recording

        if allow_partial is None:
            allow_partial = bool(self._config.getini("turtlelog_allow_partial"))
        key = path.resolve(), allow_partial, trust_law, repr(sorted(reading.items()))
        if key not in self._recordings:
            name = escape_controls(_show_path(path, self._config.rootpath))
            self._recordings[key] = Recording(
                path,
                name=name,
                allow_partial=allow_partial,
                trust_law=trust_law,
                watch=self.watch,
                **reading,
            )
        return self._recordings[key]

    def open_reference(self, path: Path, scratch: Path) -> "ReferenceFile":
        """Return the reference of a file; repeated calls return the same object.

        `scratch` is the folder of this session; with xdist, a folder inside that of all workers.
        """
        from turtlelog.check.reference import ReferenceFile

        shared = scratch.parent if hasattr(self._config, "workerinput") else scratch
        is_accepting = self._config.getoption("--turtlelog-accept")
        claims = shared / "turtlelog-accept" if is_accepting else None
        reference = ReferenceFile(path=path, claims=claims)
        return self._references.setdefault(path.resolve(), reference)

    def end(self) -> None:
        """Release the resources that must not outlive the session."""
        if self._writer is not None:
            self._writer.close()

    def begin(self) -> None:
        """Forget the checks of the previous test."""
        self._used, self._results = {}, []

    def watch(self, recording: "Recording", result: "CheckResult | None") -> None:
        """Note that a recording was used, or note the result of a check."""
        self._used[recording.file] = recording
        if result is not None:
            self._results.append((recording, result))

    def list_properties(self) -> Iterator[tuple[str, object]]:
        """Yield every metric of the used recordings, if a report needs them."""
        for name in self._used if self._config.getoption("xmlpath", None) else ():
            from turtlelog.measure import measure_run

            try:
                metrics = measure_run(self._used[name].run)
            except TurtlelogError:  # the test has failed because of it
                continue
            yield "recording", name
            prefix = f"{name}: " if len(self._used) > 1 else ""
            for metric in metrics.values():
                unit = "" if metric.unit == "1" else f" [{metric.unit}]"
                value = metric.status.value if metric.value is None else repr(metric.value)
                yield f"{prefix}{metric.id}{unit}", value

    def complete_report(self, item: pytest.Item, report: pytest.TestReport) -> None:
        """Add the checks of a test to its report; for a failure, also message and artifacts."""
        if not self._used:
            return
        has_failed = report.failed
        report.turtlelog = {  # type: ignore[attr-defined]
            "recordings": list(self._used),
            "checks": [_pack(result, has_failed=has_failed) for _, result in self._results],
            "accepted": [str(path) for path, one in self._references.items() if one.is_written],
        }
        failed: dict[Recording, dict[tuple[str, str], CheckResult]] = {}
        for recording, result in self._results:
            if result.verdict == "FAIL":
                failed.setdefault(recording, {})[result.check, result.expected] = result
        if has_failed and failed:
            self._explain(item, report, {who: [*found.values()] for who, found in failed.items()})

    def _explain(
        self,
        item: pytest.Item,
        report: pytest.TestReport,
        failed: "dict[Recording, list[CheckResult]]",
    ) -> None:
        from turtlelog.check import ArtifactWriter

        lines: list[str] = []
        explains = not self._config.getoption("--turtlelog-no-why")
        for recording, results in failed.items():
            try:
                found = recording.explain_failures(results) if explains else results
                lines += [*recording.describe(*found), ""]
            except TurtlelogError as err:
                reason = str(err).removeprefix(f"{recording.path}: ")
                lines += [f"{recording.file}: {reason}", ""]
        folder = self._config.getoption("--turtlelog-artifacts")
        if folder:
            place = self._config.invocation_params.dir / folder
            self._writer = self._writer or ArtifactWriter(place)
            for recording, results in failed.items():
                lines += _keep_artifacts(recording, results, self._writer, prefix=item.nodeid)
        add_section: Any = getattr(report.longrepr, "addsection", None)
        if add_section is not None:
            add_section("turtlelog", "\n".join(lines).rstrip())


def explain_comparison(operator: str, left: object, right: object) -> list[str] | None:
    """Return the first lines of the message of a comparison; the section below has the details."""
    from turtlelog.check.result import RecordedMetric
    from turtlelog.measure import MIRRORED, Metric

    watched = [one for one in (left, right) if isinstance(one, Metric) and one.watch is not None]
    if not watched or operator not in MIRRORED:
        return None
    metric, watch = watched[0], watched[0].watch
    asked, other = (operator, right) if metric is left else (MIRRORED[operator], left)
    if not isinstance(watch, RecordedMetric):
        return None
    try:
        result = watch.judge(metric, asked, other)
    except TurtlelogError:
        return None
    check = f"{result.check} of {result.file}: expected {result.expected}"
    return [escape_controls(line) for line in (f"{left!r} {operator} {right!r}", check)]


def _keep_artifacts(
    recording: "Recording",
    results: "Sequence[CheckResult]",
    writer: "ArtifactWriter",
    *,
    prefix: str,
) -> list[str]:
    """Write files for the first violation; return lines with their names, or with errors."""
    dated = [result for result in results if result.first_violation_s is not None]
    result = min(dated, key=lambda found: found.first_violation_s or 0.0, default=results[0])
    try:
        found = writer.write(recording.run, result, prefix=prefix)
    except (TurtlelogError, OSError) as err:
        return [f"artifacts: {err}"]
    lines = [*(f"wrote {path}" for path in found.files), *found.notes]
    return [escape_controls(line) for line in lines]


def _pack(result: "CheckResult", *, has_failed: bool) -> dict[str, object]:
    """Return the data for the summary in types that can be sent between processes."""
    margin, verdict = result.margin, result.verdict.value
    if not has_failed:
        # A denied comparison, as in `assert not overshoot > 2`, passes if it is false.
        margin, verdict = None if margin is None else abs(margin), "PASS"
    names = {"file": result.file, "check": result.check, "unit": result.unit}
    return {**names, "verdict": verdict, "margin": margin}


def _show_path(path: Path, root: Path) -> str:
    """Return a path relative to the root if it is inside it."""
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else str(path)


SESSION = pytest.StashKey[Session]()

_MOST = 3
_WIDTH = 60


class SessionSummary:
    """Collector of data from the reports of all processes."""

    def __init__(self) -> None:
        self._recordings: set[str] = set()
        self._accepted: set[str] = set()
        self._checks: list[dict[str, Any]] = []

    def add(self, told: dict[str, Any] | None) -> None:
        """Add the data of one report, if it has data."""
        if not told:
            return
        self._recordings.update(told["recordings"])
        self._accepted.update(told["accepted"])
        self._checks += told["checks"]

    def format_line(self) -> str:
        """Return the summary line; empty if no recording was used."""
        if not self._recordings:
            return ""
        failed = sum(check["verdict"] == "FAIL" for check in self._checks)
        parts = [
            f"turtlelog: {describe_count(len(self._recordings), 'recording')}",
            describe_count(len(self._checks), "check") + (f" ({failed} failed)" if failed else ""),
        ]
        if self._checks:
            from turtlelog.check.result import CheckResult, find_worst
            from turtlelog.display import format_number

            worst = find_worst(CheckResult(**check) for check in self._checks)[:_MOST]
            names = [shorten(one.check, _WIDTH, placeholder="...") for one in worst]
            margins = [format_number(one.margin, one.unit) for one in worst]
            told = zip(margins, names, (one.file for one in worst), strict=True)
            texts = "; ".join(f"{margin} {name} ({file})" for margin, name, file in told)
            parts.append(f"worst margins: {texts}")
        accepted = [f"accepted {path}" for path in sorted(self._accepted)]
        return escape_controls(", ".join([*parts, *accepted]))


SUMMARY = pytest.StashKey[SessionSummary]()

_PACKAGE = Path(__file__).parents[1]


def end_at_test(error: BaseException) -> None:
    """Cut the traceback of a deliberate turtlelog error at the point where turtlelog begins.

    pytest reads tracebacks again, so frames can be left out only here.
    """
    if not isinstance(error, TurtlelogError):
        return
    last, frame = None, error.__traceback__
    while frame is not None:
        if Path(frame.tb_frame.f_code.co_filename).is_relative_to(_PACKAGE):
            break
        last, frame = frame, frame.tb_next
    if last is not None:
        last.tb_next = None
    if not isinstance(error, LawError | SimulationError):  # these show the frames of a user's law
        error.__cause__, error.__suppress_context__ = None, True


_FLAGS: Final = ("allow_partial", "trust_law")
"""Settings of the marker that are True or False."""


def choose_recordings(
    metafunc: pytest.Metafunc, marker: pytest.Mark
) -> tuple[list[Path], dict[str, Any]]:
    """Return the files of a marker, and the settings that the marker gives for them.

    Patterns are searched in the folder of the test, then in the root.
    """
    from turtlelog.log.read_choice import ReadOptions

    place = f"{metafunc.definition.nodeid}: recordings"
    known = dict.fromkeys((*_FLAGS, *ReadOptions.__annotations__))
    del known["allow_no_poses"]  # a check needs poses
    unknown = sorted(marker.kwargs.keys() - known.keys())
    if unknown:
        _refuse(f"{place}: expected one of {', '.join(known)}, found {unknown[0]}")
    _require_settings(marker.kwargs, place)
    if not marker.args:
        _refuse(f'{place}: needs a pattern such as "runs/*.mcap"')
    folders = [metafunc.definition.path.parent, metafunc.config.rootpath]
    paths: dict[Path, None] = {}
    for pattern in marker.args:
        if not isinstance(pattern, str | os.PathLike):
            _refuse(f"{place}: expected a pattern, found {pattern!r}")
        found = _find_files(os.fspath(pattern), folders)
        if not found:
            where = " or ".join(dict.fromkeys(map(str, folders)))
            _refuse(f"{place}: no files match {os.fspath(pattern)!r} in {where}")
        paths |= dict.fromkeys(map(_shorten, found))
    return list(paths), dict(marker.kwargs)


def _shorten(path: Path) -> Path:
    """Return a path without `..`, if it is still the same file without them."""
    short = Path(os.path.normpath(path))
    return short if path.exists() and short.exists() and short.samefile(path) else path


def _require_settings(settings: Mapping[str, Any], place: str) -> None:
    kinds: dict[str, tuple[type | tuple[type, ...], str]] = {
        **dict.fromkeys(_FLAGS, (bool, "True or False")),
        "goal": ((tuple, list), "(x, y) or (x, y, heading)"),
        "wheels": ((tuple, list), "(radius, track)"),
        "wheelbase": ((int, float), "a length in m"),
        "columns": (Mapping, "a dictionary"),
    }
    for name, value in settings.items():
        kind, expected = kinds.get(name, (str, "text"))
        if not isinstance(value, kind):
            _refuse(f"{place}: {name}: expected {expected}, found {value!r}")
    if settings.get("time", "auto") not in {"auto", "log", "stamp"}:
        _refuse(f"{place}: time: expected auto, log or stamp, found {settings['time']!r}")


def name_recordings(paths: Sequence[Path], root: Path) -> list[str]:
    """Return a unique name for every file, as short as possible."""
    names = [find_stem(path) for path in paths]
    counts = Counter(names)
    pairs = zip(paths, names, strict=True)
    return [name if counts[name] == 1 else _show_path(path, root) for path, name in pairs]


def find_stem(path: Path) -> str:
    """Return a file's name without suffix, valid for a file; for FILE:TOPIC, with the topic."""
    from turtlelog.log.read_choice import split_topic

    head, topic = split_topic(path)
    return path.stem if topic is None else f"{head.stem}-{topic.strip('/').replace('/', '-')}"


def find_reference(request: pytest.FixtureRequest, stem: str | None) -> Path:
    """Return the reference file in a test's marker or the ini option; UsageError without one."""
    marker = request.node.get_closest_marker("reference")
    given: Any = request.config.getini("turtlelog_reference") or None
    folders = [request.config.rootpath]
    if marker is not None:
        given = marker.args[0] if len(marker.args) == 1 and not marker.kwargs else None
        folders = [request.node.path.parent, request.config.rootpath]
    if not isinstance(given, str | os.PathLike):
        raise pytest.UsageError(
            f'{request.node.nodeid}: the test needs @pytest.mark.reference("good.mcap") or'
            " turtlelog_reference = ... in the ini file"
        )
    name = os.fspath(given)
    if "{stem}" in name and stem is None:
        raise pytest.UsageError(
            f"{request.node.nodeid}: reference {name!r}: needs a recording beside it"
        )
    name = name.replace("{stem}", stem or "")
    places = [folder / name for folder in folders]
    return next((place for place in places if place.exists()), places[0])


def _find_files(pattern: str, folders: Sequence[Path]) -> list[Path]:
    for folder in folders:
        # An existing name has priority over a pattern.
        if (folder / pattern).exists():
            return [folder / pattern]
        start = glob.escape(str(folder)) + os.sep
        whole = pattern if Path(pattern).is_absolute() else start + pattern
        found = sorted(Path(path) for path in glob.glob(whole, recursive=True))  # noqa: PTH207
        if found:
            return found
    head, colon, topic = pattern.rpartition(":")
    if colon and head:  # FILE:TOPIC, for each matching file
        return [path.parent / f"{path.name}:{topic}" for path in _find_files(head, folders)]
    return []


def _refuse(message: str) -> NoReturn:
    raise pytest.Collector.CollectError(message)
