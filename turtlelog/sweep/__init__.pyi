from .assemble import (
    load_row_scenario as load_row_scenario,
)
from .find_recordings import (
    FoundRecording as FoundRecording,
    find_recordings as find_recordings,
)
from .metric_rows import (
    describe_values as describe_values,
    plan_metric_table as plan_metric_table,
)
from .plan import (
    Sampling as Sampling,
    SweepPlan as SweepPlan,
    build_plan as build_plan,
)
from .recordings import (
    RecordingTable as RecordingTable,
    TabulatedFiles as TabulatedFiles,
    describe_former as describe_former,
    hash_recording as hash_recording,
    tabulate_recordings as tabulate_recordings,
)
from .result_table import (
    ResultColumn as ResultColumn,
    ResultTable as ResultTable,
    choose_type as choose_type,
    read_result_facts as read_result_facts,
    read_result_table as read_result_table,
    write_result_table as write_result_table,
)
from .simulate_rows import (
    RowRecords as RowRecords,
)
from .sweep_rows import (
    Sweep as Sweep,
    SweepEstimate as SweepEstimate,
    SweepSummary as SweepSummary,
    estimate_sweep as estimate_sweep,
    prepare_sweep as prepare_sweep,
    run_sweep as run_sweep,
)
