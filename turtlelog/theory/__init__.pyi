from .continuous_loop import (
    PLANT as PLANT,
    PLANT_INPUTS as PLANT_INPUTS,
    BiboVerdict as BiboVerdict,
    FinalValue as FinalValue,
    FinalValueStatus as FinalValueStatus,
    compute_closed_loop_response as compute_closed_loop_response,
    compute_exact_settling_time as compute_exact_settling_time,
    compute_plant_response as compute_plant_response,
    compute_root_locus as compute_root_locus,
    compute_saturated_settling_time as compute_saturated_settling_time,
    compute_settling_time as compute_settling_time,
    compute_step_response as compute_step_response,
    compute_time_constant as compute_time_constant,
    find_final_value as find_final_value,
    find_plant_final_value as find_plant_final_value,
    judge_bibo as judge_bibo,
)
from .loop_design import find_lasting_gains as find_lasting_gains
from .loop_models import (
    LoopModel as LoopModel,
    LoopTiming as LoopTiming,
    MeasuredTiming as MeasuredTiming,
    NeglectedSetting as NeglectedSetting,
    find_timing as find_timing,
    hides_stability as hides_stability,
    list_known as list_known,
    model_loop as model_loop,
    model_loops as model_loops,
    read_gains as read_gains,
    read_process as read_process,
)
from .pid_loop import (
    PidLoop as PidLoop,
    analyse_pid_loop as analyse_pid_loop,
    compute_open_loop as compute_open_loop,
    compute_pid_locus as compute_pid_locus,
    compute_pid_poles as compute_pid_poles,
    compute_pid_step_response as compute_pid_step_response,
    compute_steady_error as compute_steady_error,
    find_stable_gains as find_stable_gains,
    is_pid_stable as is_pid_stable,
)
from .pid_stability import Margins as Margins, PidGains as PidGains
from .process import INTEGRATOR as INTEGRATOR, Process as Process
from .recommended_gains import (
    EQUAL_PERCENT as EQUAL_PERCENT,
    OVERSHOOT_PERCENT as OVERSHOOT_PERCENT,
    PHASE_MARGIN_RAD as PHASE_MARGIN_RAD,
    Recommendation as Recommendation,
    is_no_worse as is_no_worse,
    measure_gains as measure_gains,
    recommend_gains as recommend_gains,
)
from .sampled_loop import (
    SampledLoop as SampledLoop,
    analyse_sampled_loop as analyse_sampled_loop,
    compute_overshoot_gain as compute_overshoot_gain,
    compute_sampled_poles as compute_sampled_poles,
    compute_sampled_step_response as compute_sampled_step_response,
    compute_stability_gain as compute_stability_gain,
)
from .step_motion import (
    StepLimits as StepLimits,
    StepMotion as StepMotion,
    measure_step_motion as measure_step_motion,
)
