from . import angles as angles, loops as loops, paths as paths
from .angles import (
    Trajectory as Trajectory,
    build_planar_trajectory as build_planar_trajectory,
    build_trajectory as build_trajectory,
    find_quaternions as find_quaternions,
    turn_headings as turn_headings,
)
from .columns import (
    Clock as Clock,
    CommandColumns as CommandColumns,
    Event as Event,
    Lost as Lost,
    Origin as Origin,
    PoseColumns as PoseColumns,
    SampleColumns as SampleColumns,
    SourceKind as SourceKind,
    SourceTopic as SourceTopic,
    find_greatest_loss as find_greatest_loss,
    find_source_kind as find_source_kind,
    take_rows as take_rows,
)
from .run import (
    LAW as LAW,
    Parameter as Parameter,
    Run as Run,
    SoftwareChange as SoftwareChange,
    describe_changes as describe_changes,
    describe_software as describe_software,
    list_runs as list_runs,
    list_software_changes as list_software_changes,
    require_run as require_run,
)
from .stop_reasons import CUT_SHORT as CUT_SHORT, GoalLine as GoalLine
from .tables import (
    TABLES as TABLES,
    PhaseSpan as PhaseSpan,
    slice_run as slice_run,
    tabulate_run as tabulate_run,
)
