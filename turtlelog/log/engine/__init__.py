"""Files as columns: chunks walked, gathered and written by the thousand, not message by message."""

from turtlelog.log.engine.topic_columns import (
    RawContents,
    TopicColumns,
    iter_columns,
    read_columns,
    read_raw,
)

__all__ = ["RawContents", "TopicColumns", "iter_columns", "read_columns", "read_raw"]
