"""turtlelog: what did my loop really do?

Simulate the ROS 2 turtlesim robot under feedback, record, replay, measure and compare. The public
names are in `__init__.pyi` and load on first use: importing the package loads neither numpy nor
rerun.
"""

from turtlelog.libraries import __version__ as __version__, attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
