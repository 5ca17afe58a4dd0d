"""turtlelog: what did my loop really do?

Names load on first use: importing the package costs neither numpy nor rerun.
"""

__version__ = "0.1.0"
