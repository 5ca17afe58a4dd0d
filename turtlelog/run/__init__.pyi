from . import (
    angles as angles,
    loops as loops,
    paths as paths,
)
from .columns import (
    Clock as Clock,
    CommandColumns as CommandColumns,
    PoseColumns as PoseColumns,
    SampleColumns as SampleColumns,
    slice_run as slice_run,
    take_rows as take_rows,
)
from .run import (
    Event as Event,
    GoalLine as GoalLine,
    Parameter as Parameter,
    PhaseSpan as PhaseSpan,
    Run as Run,
    list_runs as list_runs,
    require_run as require_run,
)
from .software import (
    LAW as LAW,
    SoftwareChange as SoftwareChange,
    describe_changes as describe_changes,
    describe_software as describe_software,
    list_software_changes as list_software_changes,
)
from .stop_reasons import (
    CUT_SHORT as CUT_SHORT,
)
from .tables import (
    TABLES as TABLES,
    tabulate_run as tabulate_run,
)
from .trajectory import (
    Trajectory as Trajectory,
    build_planar_trajectory as build_planar_trajectory,
    build_trajectory as build_trajectory,
    find_quaternions as find_quaternions,
    turn_headings as turn_headings,
)
