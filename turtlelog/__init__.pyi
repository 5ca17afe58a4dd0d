"""The public names: each stands here once, and loads on first use. The rooms have the rest."""

__all__: list[str]

from . import (
    charts as charts,
    check as check,
    compare as compare,
    draw as draw,
    errors as errors,
    explain as explain,
    expressions as expressions,
    identify as identify,
    laws as laws,
    log as log,
    measure as measure,
    plants as plants,
    replay as replay,
    run as run,
    scenario as scenario,
    simulate as simulate,
    sweep as sweep,
    theory as theory,
)
from .check import (
    Recording as Recording,
    Spec as Spec,
    Tolerances as Tolerances,
    check_formula as check_formula,
    check_runs as check_runs,
    load_spec as load_spec,
    parse_spec as parse_spec,
)
from .compare import (
    Tolerance as Tolerance,
    compare_runs as compare_runs,
    summarise_run as summarise_run,
    tabulate_runs as tabulate_runs,
)
from .draw import (
    draw_figure as draw_figure,
    draw_map as draw_map,
    open_viewer as open_viewer,
    show_run as show_run,
    write_comparison_rrd as write_comparison_rrd,
    write_figures as write_figures,
    write_run_rrd as write_run_rrd,
)
from .errors import (
    TurtlelogError as TurtlelogError,
)
from .explain import (
    attribute_run as attribute_run,
    explain_difference as explain_difference,
    identify_run as identify_run,
)
from .identify import (
    RobotModel as RobotModel,
    identify_robot as identify_robot,
)
from .laws import (
    LAWS as LAWS,
    Goal as Goal,
    Law as Law,
    Pose as Pose,
)
from .libraries import __version__ as __version__
from .log import (
    Recorder as Recorder,
    read_bag as read_bag,
    read_columns as read_columns,
    read_info as read_info,
    read_recording as read_recording,
    read_run as read_run,
    recover_recording as recover_recording,
    write_recording as write_recording,
)
from .measure import (
    METRICS as METRICS,
    SIGNALS as SIGNALS,
    MeasureSettings as MeasureSettings,
    Metric as Metric,
    measure_run as measure_run,
    read_signal as read_signal,
)
from .replay import (
    replay_law as replay_law,
    replay_loop as replay_loop,
    replay_plant as replay_plant,
)
from .run import (
    CommandColumns as CommandColumns,
    PoseColumns as PoseColumns,
    Run as Run,
    SampleColumns as SampleColumns,
)
from .run.loops import (
    ControlLoop as ControlLoop,
    Declaration as Declaration,
)
from .scenario import (
    PRESETS as PRESETS,
    Scenario as Scenario,
    format_scenario as format_scenario,
    load_scenario as load_scenario,
    override_scenario as override_scenario,
    parse_scenario as parse_scenario,
)
from .simulate import (
    simulate_run as simulate_run,
)
from .sweep import (
    sweep_scenario as sweep_scenario,
)
from .sweep.tune import (
    tune_scenario as tune_scenario,
)
