from .candidates import (
    Candidate as Candidate,
    Candidates as Candidates,
    ConstraintFinding as ConstraintFinding,
    TuningGoal as TuningGoal,
    parse_goal as parse_goal,
)
from .search import (
    NEIGHBOURS as NEIGHBOURS,
    KeyRange as KeyRange,
    Neighbourhood as Neighbourhood,
    SearchedKey as SearchedKey,
    Tuned as Tuned,
    explore_best as explore_best,
    find_best as find_best,
    parse_searched_keys as parse_searched_keys,
    search_best as search_best,
    sum_up as sum_up,
)
from .tune_scenario import (
    FEWEST as FEWEST,
    FOR_EACH_KEY as FOR_EACH_KEY,
    Spread as Spread,
    TunedScenario as TunedScenario,
    Variation as Variation,
    choose_variations as choose_variations,
    complete_searched as complete_searched,
    read_intervals as read_intervals,
    simulate_variants as simulate_variants,
    tune_candidates as tune_candidates,
    tune_scenario as tune_scenario,
)
