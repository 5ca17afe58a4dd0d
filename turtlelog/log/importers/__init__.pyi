from .exported_tables import (
    holds_tables as holds_tables,
    import_tables as import_tables,
)
from .paper_log import (
    import_log as import_log,
    is_papers as is_papers,
)
from .plain_tables import import_plain_table as import_plain_table
from .table_columns import read_time as read_time
