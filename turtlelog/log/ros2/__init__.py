"""Reading of third-party bags as runs, and detection of bag folders.

The modules, in the order in which they read a bag: `bag_files` finds its files, and `bag_topics`
chooses topics and one of several robots. `bag_poses`, `bag_transforms` and `computed_poses` find
the poses. `bag_rows` opens bags, sorts the rows of messages and times them by `stamps`, and
`reported_motion` judges poses and rates. `bag_commands` adds commands, goal and path, and
`bag_reader` builds the run. `bag_surroundings` reads scans and maps.
"""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
