"""What makes a test fail where nobody can tell: children of AssertionError."""

from turtlelog.errors import CheckError


class UndecidedError(CheckError, AssertionError):
    """A truth was asked for where it is unknown: neither it nor its negation passes."""


class MissingValueError(UndecidedError):
    """A metric that has no value was compared."""


class PartialLogError(CheckError, AssertionError):
    """Of a recording something is lost, and nobody said that this is fine."""
