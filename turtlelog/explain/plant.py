"""What poses and commands tell where no sample says which pose a command answers."""

import numpy as np

from turtlelog.errors import ReplayError
from turtlelog.explain.finding import Finding, find_exactly, miss
from turtlelog.explain.identification import LAW_KEYS, Identification, give_up
from turtlelog.replay import replay_plant
from turtlelog.run import Run

_REASON = "the recording holds no samples: which pose a command answers is not known"


def identify_plant(run: Run) -> Identification:
    """Return the largest commands, and how many of them were lost."""
    findings = dict.fromkeys((*LAW_KEYS, "dead_time.rotate", "dead_time.translate"), miss(_REASON))
    largest = {
        "limits.speed_m_s": run.commands.speed_m_s,
        "limits.turn_rate_rad_s": run.commands.turn_rate_rad_s,
    }
    for key, command in largest.items():
        if len(command):
            seen = f"the largest of {len(command)} commands is {np.abs(command).max():.4g}"
            findings[key] = miss(f"{seen}; without the error nobody knows if it was clipped")
    return give_up(run.name, {**findings, "lost_commands": _count_lost(run)}, _REASON)


def _count_lost(run: Run) -> Finding:
    try:
        use = replay_plant(run).commands
    except ReplayError as err:
        return miss(str(err))
    return find_exactly(use.unseen, f"no pose shows them; {use.taken} others are shown")
