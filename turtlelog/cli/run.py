"""`turtlelog run`: simulate a scenario."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.exit_codes import EXIT_FINE, EXIT_INTERRUPTED
from turtlelog.cli.options import Json, Output, ScenarioOptions, load_changed_scenario
from turtlelog.cli.output import (
    describe_metrics,
    format_table,
    print_json,
    print_note,
    print_text,
)
from turtlelog.cli.progress import Progress, show_progress, watch_ticks
from turtlelog.cli.targets import require_new_target

if TYPE_CHECKING:
    from turtlelog import Run, Scenario
    from turtlelog.simulate import Tick


def run(
    scenario: str = "paper",
    /,
    *,
    options: ScenarioOptions | None = None,
    output: Output = None,
    rrd: Annotated[Path | None, Parameter(name="--rrd")] = None,
    realtime: Annotated[bool, Parameter(negative="")] = False,
    json: Json = False,
) -> int:
    """Simulate a scenario in closed loop, print its metrics, record it.

    Example: turtlelog run paper-kp10 --set loop.queue_policy=newest -o kp10.mcap

    With --realtime the recording is written while the loop runs, to a new file that can be read up
    to the last second whatever happens. Ctrl-C ends the run, and the file is finished (exit code
    130).

    Args:
        scenario: A preset (paper-kp1, paper-kp2, paper-kp4, paper-kp10, paper, textbook) or a
            scenario file.
        output: Write the recording to this .mcap file.
        realtime: Run at the speed of the wall clock.
        rrd: Write a Rerun recording to this .rrd file.
        json: Print one JSON object instead of tables.
    """
    require_new_target(output, [Path(scenario)], suffix=".mcap")
    require_new_target(rrd, [Path(scenario)], suffix=".rrd")
    chosen = load_changed_scenario(scenario, options)
    result = _run_realtime(chosen, output) if realtime else _simulate(chosen)
    code = EXIT_INTERRUPTED if result.stop_reason == "interrupted" else EXIT_FINE
    if code:
        print_note(f"interrupted at {result.end_ns / 1e9:.3f} s")
    for name, note in result.notes.items():
        print_note(f"{name.replace('_', ' ')}: {note}")
    _write(result, None if realtime else output, rrd)
    for path in filter(None, (output, rrd)):
        print_note(f"wrote {path}")
    if json:
        print_json(
            {
                "name": result.name,
                "file": None if output is None else str(output),
                "rrd": None if rrd is None else str(rrd),
                "samples": len(result.samples),
                "stop_reason": result.stop_reason,
                "metrics": describe_metrics(tl.measure_run(result)),
            }
        )
        return code
    print_text(f"{result.name}: {len(result.samples)} samples. {result.events[-1].text}\n")
    print_text(format_table(tl.tabulate_metrics([result], only=tl.ESSENTIAL_METRICS)))
    return code


def _write(run: "Run", output: Path | None, rrd: Path | None) -> None:
    with show_progress("writing"):
        if output is not None:
            tl.write_recording(run, output)
        if rrd is not None:
            tl.write_run_rrd(run, rrd)


def _simulate(scenario: "Scenario") -> "Run":
    from turtlelog.simulate import collect_run, iterate_ticks

    return collect_run(scenario, watch_ticks(iterate_ticks(scenario), scenario.max_duration_s))


def _run_realtime(scenario: "Scenario", output: Path | None) -> "Run":
    with ExitStack() as closing:
        progress = show_progress("simulated", scenario.max_duration_s, "s at most")
        watcher = _Watcher(closing.enter_context(progress))
        if output is None:
            return tl.run_live(scenario, [watcher], realtime=True)
        recorder = closing.enter_context(tl.Recorder(output, scenario))
        return tl.run_live(scenario, [recorder, watcher], realtime=True)


class _Watcher:
    """Shows how far a live run is."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def receive(self, tick: "Tick") -> None:
        self._progress.done = tick.time_ns / 1e9

    def close(self, notes: Mapping[str, str]) -> None:  # noqa: ARG002
        self._progress.close()
