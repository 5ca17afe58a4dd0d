"""Reading of third-party bags as runs, and detection of bag folders.

The modules, in the order in which they read a bag: `bag_metadata` and `bag` find its files and open
them. `pose_types` lists the message types of poses with their fields, `bag_topics` chooses topics,
and `bag_robots` one of several robots. `bag_poses`, `bag_transforms` and `computed_poses` find the
poses. `bag_rows` sorts the rows of messages, and `reported_motion` judges the rates of odometry.
`stamps` and `bag_clock` time the rows. `bag_references` adds goal and path, `bag_commands` adds
commands and samples, and `bag_reader` builds the run.
"""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
