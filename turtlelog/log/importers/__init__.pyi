from .any_log import (
    import_log as import_log,
    import_other as import_other,
    is_papers as is_papers,
)
from .exported_tables import (
    holds_tables as holds_tables,
    import_tables as import_tables,
)
from .plain_tables import import_plain_table as import_plain_table
from .table_cells import read_time as read_time
