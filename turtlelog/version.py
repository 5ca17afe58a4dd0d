"""The version of turtlelog, which recordings contain."""

__version__ = "0.1.0"
