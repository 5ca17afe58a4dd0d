from .topic_columns import (
    RawContents as RawContents,
    TopicColumns as TopicColumns,
    iter_columns as iter_columns,
    read_columns as read_columns,
    read_raw as read_raw,
)
