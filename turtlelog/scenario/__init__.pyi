from .model import (
    Disturbance as Disturbance,
    LawChoice as LawChoice,
    LawTable as LawTable,
    Limits as Limits,
    LoopSettings as LoopSettings,
    PlantChoice as PlantChoice,
    Scenario as Scenario,
    Sensing as Sensing,
    Shaping as Shaping,
    Start as Start,
    Target as Target,
)
from .overrides import (
    choose_scenario as choose_scenario,
    complete_scenario as complete_scenario,
    override_gains as override_gains,
    override_scenario as override_scenario,
    parse_assignments as parse_assignments,
    replay_commands as replay_commands,
    unwrap_number as unwrap_number,
)
from .presets import (
    DEFAULT_LAW as DEFAULT_LAW,
    PAPER_RUNS as PAPER_RUNS,
    PRESETS as PRESETS,
    flatten_tables as flatten_tables,
    nest_parameters as nest_parameters,
)
from .scenario_file import (
    format_scenario as format_scenario,
    get_preset as get_preset,
    iterate_paper_runs as iterate_paper_runs,
    load_scenario as load_scenario,
    parse_scenario as parse_scenario,
    read_scenario as read_scenario,
)
from .table_conversion import (
    build_scenario as build_scenario,
    describe_unknown_key as describe_unknown_key,
    flatten_scenario as flatten_scenario,
    nest_scenario as nest_scenario,
    resolve_law as resolve_law,
    resolve_scenario as resolve_scenario,
    restore_scenario as restore_scenario,
)
