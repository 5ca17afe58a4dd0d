from .class_law import (
    build_law as build_law,
    declare_scenario as declare_scenario,
)
from .collect import (
    RunCollector as RunCollector,
    SampleRows as SampleRows,
    Sink as Sink,
    collect_run as collect_run,
    find_software as find_software,
    run_live as run_live,
    simulate_run as simulate_run,
)
from .loop_parts import (
    needs_time as needs_time,
)
from .many import (
    ManyRuns as ManyRuns,
    simulate_many as simulate_many,
)
from .plain_loop import (
    PlainLoop as PlainLoop,
    Tick as Tick,
    iterate_ticks as iterate_ticks,
)
from .rows import (
    SampleRow as SampleRow,
    TickRow as TickRow,
)
from .scenario_notes import (
    list_scenario_notes as list_scenario_notes,
)
