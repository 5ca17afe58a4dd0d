from .topic_columns import (
    TopicColumns as TopicColumns,
    iter_columns as iter_columns,
    read_columns as read_columns,
)
