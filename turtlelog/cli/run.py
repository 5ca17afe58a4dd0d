"""`turtlelog run`: simulate a scenario; `turtlelog scenario`: print it."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.list_names import complete_preset
from turtlelog.cli.options import Connect, Json, Output, ScenarioOptions, load_changed_scenario
from turtlelog.cli.output import (
    EXIT_FINE,
    EXIT_INTERRUPTED,
    describe_metrics,
    format_table,
    outlive_reader,
    print_json,
    print_note,
    print_text,
)
from turtlelog.cli.progress import Progress, show_progress, watch_ticks
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import SimulationError

if TYPE_CHECKING:
    from turtlelog import Run, Scenario, Table
    from turtlelog.runner import Sink
    from turtlelog.show.rerun.viewer import ViewerProcess
    from turtlelog.simulate import Tick

ScenarioWord = Annotated[str, Parameter(name="SCENARIO", completer=complete_preset)]

_ADVICE: Final = (
    "leave out --live, record with -o X.mcap, and `turtlelog view X.mcap --snapshot X.png` makes"
    " a picture, `--web` a page for a browser"
)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class LiveOptions:
    """What happens while the loop runs.

    Attributes:
        realtime: Run at the speed of the wall clock.
        live: Show the run in a viewer while it goes on, and until its window is closed.
        connect: As --live, in a viewer that runs, as in rerun+http://127.0.0.1:9876/proxy.
    """

    realtime: bool = False
    live: bool = False
    connect: Connect = None


def run(
    scenario: ScenarioWord = "paper",
    /,
    *,
    options: ScenarioOptions | None = None,
    output: Output = None,
    rrd: Annotated[Path | None, Parameter(name="--rrd")] = None,
    live: LiveOptions | None = None,
    json: Json = False,
) -> int:
    """Simulate a scenario in closed loop, print its metrics, record it.

    Example: turtlelog run paper-kp10 --set loop.queue_policy=newest -o kp10.mcap

    With --realtime the recording is written while the loop runs, to a new file that can be read up
    to the last second whatever happens. Ctrl-C or a terminal that closes ends the run, and the file
    is finished (exit code 130). With --live a viewer shows it on the way; closing that does the run
    no harm. Of a law that fails, what came before is written (exit code 2).

    Args:
        scenario: A preset (paper-kp1, paper-kp2, paper-kp4, paper-kp10, paper, textbook) or a
            scenario file.
        output: Write the recording to this .mcap file.
        rrd: Write a Rerun recording to this .rrd file.
        json: Print one JSON object instead of tables.
    """
    require_new_target(output, [Path(scenario)], suffix=".mcap")
    require_new_target(rrd, [Path(scenario)], suffix=".rrd")
    chosen = tl.resolve_scenario(load_changed_scenario(scenario, options))
    live = live or LiveOptions()
    with _open_viewer(live) as (window, url):
        try:
            result = _run(chosen, output, live, url)
        except SimulationError as err:
            if err.run is not None:
                _write(err.run, output, rrd, is_recorded=live.realtime)
            raise
        code = _answer(result, output, rrd, is_recorded=live.realtime, json=json)
        if window is not None and code == EXIT_FINE:
            with outlive_reader():
                sys.stdout.flush()
            with suppress(KeyboardInterrupt):  # all is done: only the window is to be closed
                window.wait()
    return code


def scenario(
    scenario: ScenarioWord = "paper",
    /,
    *,
    options: ScenarioOptions | None = None,
) -> None:
    """Print a preset or scenario file as a whole scenario file, to edit and run.

    The code of a law of your own is not loaded: of its keys those that were given are printed.

    Example: turtlelog scenario paper-kp10 > mine.toml

    Args:
        scenario: A preset (paper-kp1, paper-kp2, paper-kp4, paper-kp10, paper, textbook) or a
            scenario file.
    """
    chosen = load_changed_scenario(scenario, options)
    print_text(tl.format_scenario(chosen))


def _answer(
    result: "Run", output: Path | None, rrd: Path | None, *, is_recorded: bool, json: bool
) -> int:
    code = EXIT_INTERRUPTED if result.stop_reason == "interrupted" else EXIT_FINE
    if code:
        print_note(f"interrupted at {result.end_ns / 1e9:.3f} s")
    for name, note in result.notes.items():
        print_note(f"{name.replace('_', ' ')}: {note}")
    _write(result, output, rrd, is_recorded=is_recorded)
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
    print_text(format_table(_tabulate(result)))
    return code


def _tabulate(run: "Run") -> "Table":
    return tl.tabulate_metrics([run], only=tl.list_essential_metrics(run.declaration))


def _write(run: "Run", output: Path | None, rrd: Path | None, *, is_recorded: bool) -> None:
    if output is not None:
        with show_progress("writing"):
            if not is_recorded:
                tl.write_recording(run, output)
        print_note(f"wrote {output}")
    if rrd is not None:
        with show_progress("writing"):
            tl.write_run_rrd(run, rrd)
        print_note(f"wrote {rrd}")


def _simulate(scenario: "Scenario") -> "Run":
    from turtlelog.simulate import collect_run, iterate_ticks

    return collect_run(scenario, watch_ticks(iterate_ticks(scenario), scenario.max_duration_s))


@contextmanager
def _open_viewer(live: LiveOptions) -> "Iterator[tuple[ViewerProcess | None, str | None]]":
    """Yield the window, if one was to be opened, and where the viewer takes data."""
    if live.connect is not None or not live.live:
        yield None, live.connect
        return
    with tl.open_window(_ADVICE) as (window, url):
        yield window, url


def _run(scenario: "Scenario", output: Path | None, live: LiveOptions, url: str | None) -> "Run":
    if not live.realtime and url is None:
        return _simulate(scenario)
    from turtlelog.log.interrupts import hold_stop, interrupt_on_quit

    with ExitStack() as closing:
        closing.enter_context(interrupt_on_quit())
        sinks: list[Sink] = []
        viewer = None if url is None else tl.LiveViewer(scenario, url)
        if viewer is not None:
            closing.callback(viewer.close, {})  # also where nothing comes to run
        if live.realtime and output is not None:
            with hold_stop():  # so that whatever is created is finished as well
                recorder = tl.Recorder(output, scenario)
                closing.callback(recorder.close)
            sinks.append(recorder)
        sinks += [] if viewer is None else [viewer]
        progress = show_progress("simulated", scenario.max_duration_s, "s at most")
        sinks.append(_Watcher(closing.enter_context(progress)))
        result = tl.run_live(scenario, sinks, realtime=live.realtime)
    if viewer is not None and viewer.lost:
        print_note(f"viewer: {viewer.lost}; the run went on without it")
    return result


class _Watcher:
    """Shows how far a live run is."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def receive(self, tick: "Tick") -> None:
        self._progress.done = tick.time_ns / 1e9

    def close(self, notes: Mapping[str, str]) -> None:  # noqa: ARG002
        self._progress.close()
