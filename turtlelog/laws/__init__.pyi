from .base import (
    ABSENT_BY_DEFAULT as ABSENT_BY_DEFAULT,
    MAY_BE_INFINITE as MAY_BE_INFINITE,
    AnyLaw as AnyLaw,
    Decision as Decision,
    Goal as Goal,
    Law as Law,
    LawPart as LawPart,
    Pose as Pose,
    find_part as find_part,
)
from .given_laws import (
    WorkWithLaws as WorkWithLaws,
    is_given as is_given,
    name_given_law as name_given_law,
    read_law_source as read_law_source,
)
from .loading import (
    LAWS as LAWS,
    declare_law as declare_law,
    describe_law_error as describe_law_error,
    find_law as find_law,
    find_module as find_module,
    list_causes as list_causes,
    list_sample_counters as list_sample_counters,
    list_unused_keys as list_unused_keys,
    name_law as name_law,
    print_to_stderr as print_to_stderr,
    require_law_name as require_law_name,
)
from .sequential import GainSchedule as GainSchedule, PIDGainSchedule as PIDGainSchedule
from .sequential_p import SequentialP as SequentialP, SequentialPParameters as SequentialPParameters
from .sequential_pid import (
    SequentialPID as SequentialPID,
    SequentialPIDParameters as SequentialPIDParameters,
)
