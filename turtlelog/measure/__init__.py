"""Run -> metrics."""

from turtlelog.measure.signals import SIGNALS, Signal, SignalKind, read_signal

__all__ = ["SIGNALS", "Signal", "SignalKind", "read_signal"]
