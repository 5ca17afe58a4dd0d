from . import (
    tune as tune,
    tune_candidates as tune_candidates,
    tune_search as tune_search,
)
from .find_recordings import (
    FoundRecording as FoundRecording,
    find_recordings as find_recordings,
    hash_recording as hash_recording,
    is_one_recording as is_one_recording,
)
from .recording_table import (
    RecordingTable as RecordingTable,
    TabulatedFiles as TabulatedFiles,
    describe_former as describe_former,
    describe_values as describe_values,
    plan_metric_table as plan_metric_table,
    tabulate_recordings as tabulate_recordings,
)
from .result_table import (
    ResultColumn as ResultColumn,
    ResultTable as ResultTable,
    read_result_facts as read_result_facts,
    read_result_table as read_result_table,
    write_result_table as write_result_table,
)
from .sweep_analysis import (
    Border as Border,
    ColumnLimits as ColumnLimits,
    LoopLimits as LoopLimits,
    Sensitivities as Sensitivities,
    Sensitivity as Sensitivity,
    describe_limits as describe_limits,
    find_borders as find_borders,
    find_loop_limits as find_loop_limits,
    find_sensitivities as find_sensitivities,
    list_gain_keys as list_gain_keys,
    list_varied as list_varied,
    tell_borders as tell_borders,
)
from .sweep_plan import (
    Sampling as Sampling,
    SweepPlan as SweepPlan,
    build_plan as build_plan,
)
from .sweep_rows import (
    RowRecords as RowRecords,
)
from .sweep_scenario import (
    Sweep as Sweep,
    SweepEstimate as SweepEstimate,
    SweepSummary as SweepSummary,
    estimate_sweep as estimate_sweep,
    prepare_sweep as prepare_sweep,
    run_sweep as run_sweep,
    sweep_scenario as sweep_scenario,
)
from .sweep_table import (
    SweepTable as SweepTable,
    SweptAxis as SweptAxis,
    SweptMetric as SweptMetric,
    SweptResults as SweptResults,
    load_row_scenario as load_row_scenario,
    read_sweep_table as read_sweep_table,
    read_swept_results as read_swept_results,
    read_table_results as read_table_results,
)
from .sweep_views import (
    BestRow as BestRow,
    Rivals as Rivals,
    SweptCells as SweptCells,
    SweptView as SweptView,
    choose_view as choose_view,
    count_rivals as count_rivals,
    fill_cells as fill_cells,
    find_best_row as find_best_row,
    find_best_rows as find_best_rows,
    list_shown_values as list_shown_values,
    name_values as name_values,
    require_values as require_values,
)
