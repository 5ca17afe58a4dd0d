"""The version of turtlelog, which recordings name."""

__version__ = "0.1.0"
