from .result_table import (
    ResultColumn as ResultColumn,
    ResultTable as ResultTable,
    choose_type as choose_type,
    read_result_facts as read_result_facts,
    read_result_table as read_result_table,
    write_result_table as write_result_table,
)
