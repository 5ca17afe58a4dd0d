"""What is fixed about turtlesim (ROS 2 Humble): its clock, its world, its spawn pose.

Source: turtlesim's `turtle_frame.cpp` and `turtle.cpp`, and measurements on published logs.
"""

from typing import Final

TICK_NS: Final = 16_000_000
"""One plant step [ns]."""

TICK_S: Final = 0.016
"""One plant step [s]."""

WORLD_SIZE_M: Final = 11.088889122009277
"""Side of the square world [m]: 499 / 45 as a 32-bit float. The origin is its lower left corner."""

SPAWN_XY_M: Final = 5.544444561004639
"""Both coordinates of the spawn pose [m]: the middle of the world as a 32-bit float."""

WATCHDOG_NS: Final = 1_000_000_000
"""A turtle stops when more than this has passed since it last took a command [ns]."""
