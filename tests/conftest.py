"""What holds for all tests."""

import gc
import signal
import sys
from collections.abc import Generator

import pytest
from hypothesis import settings

# How long an example takes says more of the machine than of the code.
settings.register_profile("turtlelog", deadline=None)
settings.load_profile("turtlelog")

# A shell without job control turns the keyboard's signals off for what it starts in the background,
# and every program that a test starts and interrupts would inherit that.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if sys.platform != "win32" and signal.getsignal(signal.SIGQUIT) == signal.SIG_IGN:
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for garbage once behind the collection, of which all else stays: not 6000 times in it.

    Nor do the tests look through it again.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()
