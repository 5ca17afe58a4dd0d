from .failure_report import (
    ArtifactWriter as ArtifactWriter,
)
from .formula_trace import (
    Signals as Signals,
    Steps as Steps,
)
from .judge_formula import (
    FormulaResult as FormulaResult,
    check_formula as check_formula,
    check_run as check_run,
)
from .judge_run import (
    check_runs as check_runs,
)
from .recording_fixture import (
    Recording as Recording,
)
from .reference import (
    judge_replay as judge_replay,
    match_run as match_run,
)
from .result import (
    CheckResult as CheckResult,
    Verdict as Verdict,
    join_verdicts as join_verdicts,
)
from .robustness import (
    compute_robustness as compute_robustness,
)
from .spec import (
    Check as Check,
    Spec as Spec,
    Tolerances as Tolerances,
)
from .spec_file import (
    load_spec as load_spec,
    load_tolerances as load_tolerances,
    parse_spec as parse_spec,
)
