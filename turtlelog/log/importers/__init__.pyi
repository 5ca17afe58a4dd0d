from .exported_tables import (
    holds_tables as holds_tables,
    import_tables as import_tables,
)
from .paper_log import (
    import_log as import_log,
    is_papers as is_papers,
)
from .plain_tables import (
    KITTI_COLUMNS as KITTI_COLUMNS,
    PlainTable as PlainTable,
    import_plain_table as import_plain_table,
    read_plain_table as read_plain_table,
)
from .table_columns import (
    Cells as Cells,
    assign_columns as assign_columns,
    read_time as read_time,
)
