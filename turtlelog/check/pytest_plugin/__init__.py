"""The pytest plugin: recordings as fixtures, and messages that locate failures (docs/checking.md).

pytest loads this module in every session. Before a test uses a recording, the module imports
neither numpy nor rerun, nor any part of turtlelog that imports them.
"""

import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest

from turtlelog.check.pytest_plugin.session import (
    SESSION,
    SUMMARY,
    Session,
    SessionSummary,
    choose_recordings,
    end_at_test,
    explain_comparison,
    find_reference,
    find_stem,
    name_recordings,
)

if TYPE_CHECKING:
    from turtlelog.check.recording_fixture import Recording
    from turtlelog.check.reference import ReferenceFile

_MARKERS = (
    "recordings(*patterns, allow_partial=False, trust_law=False, **reading): run the test once per"
    " recording; patterns are relative to the test's folder, else to the root; trust_law lets"
    " driven_by() run the code of a law that a recording names; reading are the fields of a"
    " ReadChoice, such as pose_topic and goal",
    "reference(path): what turtlelog_reference is; {stem} is the recording's",
)

NAME: Final = "turtlelog.check.pytest_plugin"


class Entry:
    """The entry point of an installed turtlelog, with the name that `-p no:turtlelog` blocks.

    The entry point loads the plugin under the name of its module. Therefore `-p
    turtlelog.check.pytest_plugin`, which works without an installation, does not load the plugin
    again.
    """

    @staticmethod
    def pytest_addoption(pluginmanager: pytest.PytestPluginManager) -> None:
        """Load the plugin unless it is already loaded or blocked."""
        if not pluginmanager.is_blocked(NAME) and not pluginmanager.has_plugin(NAME):
            pluginmanager.register(sys.modules[NAME], NAME)


ENTRY: Final = Entry()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the plugin's options."""
    group = parser.getgroup("turtlelog", "recordings of turtlelog")
    group.addoption(
        "--turtlelog-accept",
        action="store_true",
        help="write references anew from the recordings instead of comparing",
    )
    group.addoption(
        "--turtlelog-artifacts",
        metavar="DIR",
        help="put a Rerun view, a picture and the cut recording of what fails into DIR",
    )
    group.addoption(
        "--turtlelog-no-why",
        action="store_true",
        help="do not explain why a recording that fails differs from its reference",
    )
    parser.addini("turtlelog_reference", "reference of tests without the marker", default="")
    parser.addini(
        "turtlelog_allow_partial",
        "whether recordings may have lost something",
        type="bool",
        default=False,
    )


def pytest_configure(config: pytest.Config) -> None:
    """Declare the markers, and start the session."""
    for marker in _MARKERS:
        config.addinivalue_line("markers", marker)
    config.stash[SESSION] = Session(config)
    config.stash[SUMMARY] = SessionSummary()


def pytest_unconfigure(config: pytest.Config) -> None:
    """Release the resources of the session."""
    if SESSION in config.stash:
        config.stash[SESSION].end()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Create one test item per recording."""
    marker = metafunc.definition.get_closest_marker("recordings")
    if marker is None or "turtlelog_recording" not in metafunc.fixturenames:
        return
    paths, settings = choose_recordings(metafunc, marker)
    names = name_recordings(paths, metafunc.config.rootpath)
    cases = [(str(path), settings) for path in paths]
    metafunc.parametrize("turtlelog_recording", cases, ids=names, indirect=True)


@pytest.fixture
def turtlelog_recording(request: pytest.FixtureRequest) -> "Recording":
    """Recording from the test's marker, which is read on first use."""
    if not hasattr(request, "param"):
        raise pytest.UsageError(
            f'{request.node.nodeid}: the test needs @pytest.mark.recordings("runs/*.mcap")'
        )
    path, settings = request.param
    return request.config.stash[SESSION].open_recording(Path(path), **settings)


@pytest.fixture
def turtlelog_reference(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> "ReferenceFile":
    """Reference of recordings: the file that the marker or the ini option names."""
    has_recording = "turtlelog_recording" in request.fixturenames
    stem = find_stem(request.getfixturevalue("turtlelog_recording").path) if has_recording else None
    path = find_reference(request, stem)
    return request.config.stash[SESSION].open_reference(path, tmp_path_factory.getbasetemp())


@pytest.fixture
def turtlelog_simulate(
    request: pytest.FixtureRequest, tmp_path: Path
) -> "Callable[..., Recording]":
    """Simulate, record and read back: `turtlelog_simulate("paper", kp=4)`, also with an own law."""
    from turtlelog.check.recording_fixture import SimulatedRuns

    return SimulatedRuns(tmp_path, request.config.stash[SESSION].watch).simulate


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Clear the records of the previous test."""
    item.config.stash[SESSION].begin()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the test's checks to the report: properties, the complete message, artifacts."""
    session = item.config.stash[SESSION]
    if call.when == "call":
        item.user_properties += session.list_properties()
        if call.excinfo is not None and not item.config.getoption("fulltrace"):
            end_at_test(call.excinfo.value)
    report = yield
    if call.when == "call":
        session.complete_report(item, report)
    return report


def pytest_assertrepr_compare(op: str, left: object, right: object) -> list[str] | None:
    """Write the message for a failed comparison of a metric."""
    if "turtlelog.measure.metric" not in {type(left).__module__, type(right).__module__}:
        return None
    return explain_comparison(op, left, right)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print the summary line."""
    for reports in terminalreporter.stats.values():
        for report in reports:
            config.stash[SUMMARY].add(getattr(report, "turtlelog", None))
    line = config.stash[SUMMARY].format_line()
    if line:
        terminalreporter.write_line(line)
