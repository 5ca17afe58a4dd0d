from .closed_loop import (
    Tick as Tick,
    iterate_ticks as iterate_ticks,
)
from .collect import (
    RunCollector as RunCollector,
    SampleRows as SampleRows,
    collect_run as collect_run,
    simulate_run as simulate_run,
)
from .controller import (
    Controller as Controller,
)
from .law_driver import (
    LawDriver as LawDriver,
    Sample as Sample,
    build_law as build_law,
    declare_scenario as declare_scenario,
)
from .many import (
    ManyRuns as ManyRuns,
    simulate_many as simulate_many,
)
from .scenario_notes import (
    list_scenario_notes as list_scenario_notes,
)
from .shaping import (
    build_driver as build_driver,
)
from .transport import (
    CommandQueue as CommandQueue,
    needs_time as needs_time,
)
