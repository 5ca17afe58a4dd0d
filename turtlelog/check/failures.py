"""What makes a test fail where there is nothing to compare: children of AssertionError."""

from turtlelog.errors import CheckError


class MissingValueError(CheckError, AssertionError):
    """A metric that has no value was compared."""


class PartialLogError(CheckError, AssertionError):
    """Of a recording something is lost, and nobody said that this is fine."""
