"""What holds for all tests."""

import signal
import sys

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
