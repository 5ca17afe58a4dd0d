"""The metrics of the registry. Importing this package registers them in display order."""

# ruff: noqa: F401
# isort: skip_file

from turtlelog.measure.metrics import loop_metrics, commands_and_theory
from turtlelog.measure.metrics import goal_and_path, travel, following, sampling_times
