"""Simulations as recordings: run, recorded, read back."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from turtlelog.check.recording import Recording, Watch
from turtlelog.log import write_recording
from turtlelog.scenario import Scenario, load_scenario, override_scenario
from turtlelog.simulate import declare_scenario, simulate_run


class FreshRuns:
    """Records simulations into a folder.

    Args:
        folder: Where the recordings go.
        watch: Is told of every check on them.
    """

    def __init__(self, folder: Path, watch: Watch | None = None) -> None:
        self._folder, self._watch, self._count = folder, watch, 0

    def simulate(
        self,
        scenario: str | Path | Scenario = "paper",
        *,
        kp: float | None = None,
        changes: Mapping[str, Any] | None = None,
    ) -> Recording:
        """Return the recording of a simulation.

        Args:
            scenario: A preset, a file, or the scenario itself.
            kp: All gains that the law declares.
            changes: Other values by dotted key, as in `{"law.pause_ticks": 0}`.

        Raises:
            ScenarioError: Where there is no such scenario, or a change is wrong.
            SimulationError: Where the law fails.
        """
        if not isinstance(scenario, Scenario):
            scenario = load_scenario(str(scenario))
        scenario = override_scenario(scenario, changes or {}, source="simulate")
        if kp is not None:
            keys = declare_scenario(scenario).list_gains()
            gains = {key: kp for key in keys if key not in (changes or {})}
            scenario = override_scenario(scenario, gains, source="simulate")
        self._count += 1
        path = self._folder / f"simulated-{self._count}.mcap"
        write_recording(simulate_run(scenario), path)
        return Recording(path, name=f"{scenario.name} ({path.name})", watch=self._watch)
