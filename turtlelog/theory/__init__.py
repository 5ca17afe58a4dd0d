"""The plant, the ideal loop and the sampled one: responses, poles, margins, limits.

python-control is loaded by the functions that say so, and by nothing else.

The names stand in `__init__.pyi` and load on first use.
"""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
