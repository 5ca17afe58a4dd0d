from .captions import (
    describe_end as describe_end,
    describe_runs as describe_runs,
)
