"""The plant, the ideal loop and the sampled one: responses, poles, margins, limits.

python-control is loaded by the functions that say so, and by nothing else.
"""

from turtlelog.theory.continuous_loop import (
    PLANT,
    PLANT_INPUTS,
    BiboVerdict,
    FinalValue,
    FinalValueStatus,
    compute_closed_loop_response,
    compute_exact_settling_time,
    compute_plant_response,
    compute_root_locus,
    compute_saturated_settling_time,
    compute_settling_time,
    compute_step_response,
    compute_time_constant,
    find_final_value,
    find_plant_final_value,
    judge_bibo,
)
from turtlelog.theory.sampled_loop import (
    SampledLoop,
    analyse_sampled_loop,
    compute_overshoot_gain,
    compute_sampled_poles,
    compute_sampled_step_response,
    compute_stability_gain,
)

__all__ = [
    "PLANT",
    "PLANT_INPUTS",
    "BiboVerdict",
    "FinalValue",
    "FinalValueStatus",
    "SampledLoop",
    "analyse_sampled_loop",
    "compute_closed_loop_response",
    "compute_exact_settling_time",
    "compute_overshoot_gain",
    "compute_plant_response",
    "compute_root_locus",
    "compute_sampled_poles",
    "compute_sampled_step_response",
    "compute_saturated_settling_time",
    "compute_settling_time",
    "compute_stability_gain",
    "compute_step_response",
    "compute_time_constant",
    "find_final_value",
    "find_plant_final_value",
    "judge_bibo",
]
