"""Which recordings and references a test asks for."""

import glob
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn

import pytest

_FLAGS: Final = ("allow_partial", "trust_law")
_SETTINGS: Final = (
    *_FLAGS,
    *("pose_topic", "command_topic", "path_topic", "pose_frame", "world_frame"),
    *("robot", "wheel_joints", "wheels", "wheelbase", "goal", "time", "columns"),
)
"""What the marker takes beside patterns: the fields of a `ReadChoice`, and whose code may run."""


def choose_recordings(
    metafunc: pytest.Metafunc, marker: pytest.Mark
) -> tuple[list[Path], dict[str, Any]]:
    """Return the files of a marker, and the settings that it gives for them.

    Patterns are looked for beside the test, then below the root.

    Raises:
        CollectError: Where the marker is wrong, or a pattern has no file.
    """
    place = f"{metafunc.definition.nodeid}: recordings"
    unknown = sorted(marker.kwargs.keys() - {*_SETTINGS})
    if unknown:
        _refuse(f"{place}: expected one of {', '.join(_SETTINGS)}, found {unknown[0]}")
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
        paths |= dict.fromkeys(found)
    return list(paths), dict(marker.kwargs)


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
    """Return a name for every file, as short as tells them apart."""
    names = [find_stem(path) for path in paths]
    counts = Counter(names)
    pairs = zip(paths, names, strict=True)
    return [name if counts[name] == 1 else show_path(path, root) for path, name in pairs]


def find_stem(path: Path) -> str:
    """Return a file's name without its suffix; of FILE:TOPIC with the topic, fit for a file."""
    from turtlelog.log.read_choice import split_topic

    head, topic = split_topic(path)
    return path.stem if topic is None else f"{head.stem}-{topic.strip('/').replace('/', '-')}"


def show_path(path: Path, root: Path) -> str:
    """Return a path as seen from the root, where it lies below."""
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else str(path)


def find_reference(request: pytest.FixtureRequest, stem: str | None) -> Path:
    """Return the file that a test's marker or the ini option names.

    Raises:
        UsageError: Where neither names one, or the name cannot be filled in.
    """
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
        # A name that is there is itself, whatever signs are in it.
        if (folder / pattern).exists():
            return [folder / pattern]
        start = glob.escape(str(folder)) + os.sep
        whole = pattern if Path(pattern).is_absolute() else start + pattern
        found = sorted(Path(path) for path in glob.glob(whole, recursive=True))  # noqa: PTH207
        if found:
            return found
    head, colon, topic = pattern.rpartition(":")
    if colon and head:  # FILE:TOPIC, each file of which it is one
        return [path.parent / f"{path.name}:{topic}" for path in _find_files(head, folders)]
    return []


def _refuse(message: str) -> NoReturn:
    raise pytest.Collector.CollectError(message)
