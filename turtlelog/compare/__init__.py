"""Comparison of runs: differences on a common clock, and tables across runs.

The public names are in `__init__.pyi` and load on first use.
"""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
