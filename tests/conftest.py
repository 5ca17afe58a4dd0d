"""What holds for all tests."""

import atexit
import gc
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Generator
from pathlib import Path
from secrets import token_hex
from typing import Final

import pytest
from hypothesis import settings

from tests.costly import list_unexplained, measure_time, require_reason, thin_out

# How long an example takes says more of the machine than of the code.
settings.register_profile("everyday", deadline=None, max_examples=20)
settings.register_profile("thorough", deadline=None, max_examples=100)
settings.load_profile("everyday")

# A shell without job control turns the keyboard's signals off for what it starts in the background,
# as nohup does that of a terminal that hangs up; every program that a test starts and ends would
# inherit that.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if sys.platform != "win32":
    for number in (signal.SIGQUIT, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


_LONGEST_S: Final = 300.0
"""Collecting takes half a minute on a slow machine; where the first worker is lost, the others go
on without it."""


_MEMORY: Final = Path("/dev/shm")
"""What Linux has for files that are kept in memory."""

_ROOM_BYTES: Final = 4 * 2**30
"""What must be free there: the files of all tests together are below 1 GiB, a container may have
64 MiB."""


def pytest_configure(config: pytest.Config) -> None:
    """Let tests write into memory, where there is room: half of their time they wait for a disk.

    A folder for temporary files that is named, by TMPDIR or --basetemp, is taken as it is.
    """
    is_named = "TMPDIR" in os.environ or config.option.basetemp
    if is_named or not os.access(_MEMORY, os.W_OK):
        return
    if shutil.disk_usage(_MEMORY).free >= _ROOM_BYTES:
        # Without the underscores of mkdtemp, which Markdown escapes in names of files.
        folder = _MEMORY / f"tests-{token_hex(8)}"
        folder.mkdir(mode=0o700)
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
        # At the very end: what other modules leave there they remove before.
        atexit.register(_give_back, tempfile.tempdir, os.getpid())


def _give_back(folder: str, owner: int) -> None:
    if os.getpid() == owner:  # no process that a test forks
        shutil.rmtree(folder, ignore_errors=True)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Look for garbage once behind the collection, of which all else stays: not 6000 times in it.

    Nor do the tests look through it again. The first worker of several compiles the tests for all:
    in a fresh clone each would compile every test, which takes longer than all else in it.
    """
    worker = getattr(session.config, "workerinput", {}).get("workerid")
    collected = Path(session.config.option.basetemp or "").parent / "collected"
    if worker not in {None, "gw0"}:
        _wait_for(collected)
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()
        if worker == "gw0":
            collected.touch()


def _wait_for(file: Path) -> None:
    deadline_s = time.monotonic() + _LONGEST_S
    while not file.exists() and time.monotonic() < deadline_s:
        time.sleep(0.05)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark as thorough what is not for every day, before `-m` chooses."""
    thin_out(items, is_whole=not any("::" in word for word in config.args))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Measure what a test takes."""
    with measure_time(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Let no test take long without a reason."""
    report = yield
    require_reason(item, report)
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name what takes long without a reason on this machine."""
    reports = [one for found in terminalreporter.stats.values() for one in found]
    if names := list_unexplained(reports):
        terminalreporter.section("over 2 s, and the first line does not say why")
        for name in names:
            terminalreporter.line(name)
