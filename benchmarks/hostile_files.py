"""Files below 10 MB that ask for far more than they hold, each made in a folder that is given."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from benchmarks import (
    hostile_databases,
    hostile_folders,
    hostile_mcap,
    hostile_records,
    hostile_ros1,
    hostile_tables,
)
from benchmarks.put_files import Make

FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        **hostile_databases.FILES,
        **hostile_mcap.FILES,
        **hostile_records.FILES,
        **hostile_tables.FILES,
        **hostile_ros1.FILES,
        **hostile_folders.FILES,
    }
)
"""By name, of which the first word is the kind."""
