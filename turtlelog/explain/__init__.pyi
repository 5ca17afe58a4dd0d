from .answer_words import (
    Attribution as Attribution,
    format_contribution as format_contribution,
    write_cause_head as write_cause_head,
    write_headline as write_headline,
    write_leading as write_leading,
    write_reasons as write_reasons,
    write_sentences as write_sentences,
)
from .answers import (
    CausePart as CausePart,
    Change as Change,
    Contribution as Contribution,
    Departure as Departure,
    DifferenceRange as DifferenceRange,
    EffectShift as EffectShift,
    Resolution as Resolution,
    ResolutionReason as ResolutionReason,
    SeedRange as SeedRange,
    Side as Side,
    StartRange as StartRange,
    Together as Together,
    ValueSet as ValueSet,
)
from .attribute import (
    Luck as Luck,
    LuckCurve as LuckCurve,
    attribute_run as attribute_run,
    attribute_scenario as attribute_scenario,
    measure_luck as measure_luck,
)
from .causes import (
    choose_metric as choose_metric,
    find_causes as find_causes,
    require_causes as require_causes,
    simulate_without as simulate_without,
)
from .contributions import choose_leading as choose_leading, choose_named as choose_named
from .difference_report import (
    ExplainedDifference as ExplainedDifference,
    format_change as format_change,
    format_magnitude as format_magnitude,
    name_change as name_change,
)
from .game import Work as Work, simulate_what_ifs as simulate_what_ifs
from .robot_log import (
    Delays as Delays,
    Largest as Largest,
    MotionFacts as MotionFacts,
    Periods as Periods,
    read_motion_facts as read_motion_facts,
)
from .run_difference import (
    Depth as Depth,
    choose_common_metric as choose_common_metric,
    explain_difference as explain_difference,
    find_departure as find_departure,
)
from .scenario_from_log import (
    Certainty as Certainty,
    Finding as Finding,
    Identification as Identification,
)
from .scenario_from_log.identify_scenario import identify_run as identify_run
from .scenario_from_log.law_identification import describe_loop_name as describe_loop_name
from .scenario_from_log.resimulation import (
    Resimulation as Resimulation,
    require_trust as require_trust,
)
