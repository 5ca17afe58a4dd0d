"""Reading and writing of runs: formats, columns of any file, tables, recovery, recording."""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
