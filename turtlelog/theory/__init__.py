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
from turtlelog.theory.declared_loops import (
    LoopTiming,
    find_timing,
    hides_stability,
    list_neglected,
    read_gains,
    read_process,
)
from turtlelog.theory.loop_models import (
    LoopModel,
    MeasuredTiming,
    list_known,
    model_loop,
    model_loops,
)
from turtlelog.theory.pid_gains import PidGains
from turtlelog.theory.pid_loop import (
    PidLoop,
    analyse_pid_loop,
    compute_open_loop,
    compute_pid_poles,
    compute_pid_polynomial,
    expand_transfer_function,
    find_stable_gains,
    is_pid_stable,
)
from turtlelog.theory.pid_margins import Margins
from turtlelog.theory.pid_response import (
    StepMotion,
    compute_pid_step_response,
    compute_steady_error,
    measure_step_motion,
)
from turtlelog.theory.process import INTEGRATOR, Process
from turtlelog.theory.recommended_gains import (
    OVERSHOOT_PERCENT,
    PHASE_MARGIN_RAD,
    Recommendation,
    recommend_gains,
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
    "INTEGRATOR",
    "OVERSHOOT_PERCENT",
    "PHASE_MARGIN_RAD",
    "PLANT",
    "PLANT_INPUTS",
    "BiboVerdict",
    "FinalValue",
    "FinalValueStatus",
    "LoopModel",
    "LoopTiming",
    "Margins",
    "MeasuredTiming",
    "PidGains",
    "PidLoop",
    "Process",
    "Recommendation",
    "SampledLoop",
    "StepMotion",
    "analyse_pid_loop",
    "analyse_sampled_loop",
    "compute_closed_loop_response",
    "compute_exact_settling_time",
    "compute_open_loop",
    "compute_overshoot_gain",
    "compute_pid_poles",
    "compute_pid_polynomial",
    "compute_pid_step_response",
    "compute_plant_response",
    "compute_root_locus",
    "compute_sampled_poles",
    "compute_sampled_step_response",
    "compute_saturated_settling_time",
    "compute_settling_time",
    "compute_stability_gain",
    "compute_steady_error",
    "compute_step_response",
    "compute_time_constant",
    "expand_transfer_function",
    "find_final_value",
    "find_plant_final_value",
    "find_stable_gains",
    "find_timing",
    "hides_stability",
    "is_pid_stable",
    "judge_bibo",
    "list_known",
    "list_neglected",
    "measure_step_motion",
    "model_loop",
    "model_loops",
    "read_gains",
    "read_process",
    "recommend_gains",
]
