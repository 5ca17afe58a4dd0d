"""Import of third-party logs as runs, one module per layout."""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
