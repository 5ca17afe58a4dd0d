"""The plant, the ideal loop and the sampled loop: responses, poles, margins, limits.

python-control is loaded only by functions whose docstrings name it.

The public names are in `__init__.pyi` and load on first use.
"""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
