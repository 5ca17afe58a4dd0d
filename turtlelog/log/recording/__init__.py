"""turtlelog's recordings: contents, writing and reading."""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
