"""What the exit codes of commands mean."""

from typing import Final

EXIT_FINE: Final = 0
EXIT_FAILED: Final = 1
"""A check, or a comparison with tolerances, failed."""
EXIT_BAD_INPUT: Final = 2
"""Bad usage, or an input that cannot be read."""
EXIT_DEFECT: Final = 70
EXIT_INTERRUPTED: Final = 130
