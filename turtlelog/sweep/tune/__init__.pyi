from .candidates import (
    Candidate as Candidate,
    Candidates as Candidates,
    ConstraintFinding as ConstraintFinding,
    TuningGoal as TuningGoal,
    parse_goal as parse_goal,
)
from .robust_values import (
    NEIGHBOURS as NEIGHBOURS,
    KeyRange as KeyRange,
    Neighbourhood as Neighbourhood,
    Spread as Spread,
    Variation as Variation,
    choose_variations as choose_variations,
    explore_best as explore_best,
    read_intervals as read_intervals,
    simulate_variants as simulate_variants,
)
from .search import (
    SearchedKey as SearchedKey,
    Tuned as Tuned,
    find_best as find_best,
    parse_searched_keys as parse_searched_keys,
    search_best as search_best,
    sum_up as sum_up,
)
from .tune_scenario import (
    FEWEST as FEWEST,
    FOR_EACH_KEY as FOR_EACH_KEY,
    TunedScenario as TunedScenario,
    complete_searched as complete_searched,
    tune_candidates as tune_candidates,
    tune_scenario as tune_scenario,
)
