"""`turtlelog run`: simulation of a scenario; `turtlelog scenario`: printing of it."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.list_names import complete_preset
from turtlelog.cli.metrics_answer import format_run, list_needed
from turtlelog.cli.options import Connect, Json, Output, Place, StepBudgetMs, choose_step_budget
from turtlelog.cli.output import (
    EXIT_FINE,
    EXIT_INTERRUPTED,
    describe_metrics,
    fill_lines,
    flush_stdout,
    print_json,
    print_note,
    print_text,
)
from turtlelog.cli.progress import ProgressLine, show_progress, watch_ticks
from turtlelog.cli.scenario_options import (
    LawOptions,
    RowOptions,
    find_scenario_file,
    list_given_keys,
    load_changed_scenario,
)
from turtlelog.cli.targets import require_new_target
from turtlelog.cli.watch import describe_change, list_watched, watch_runs
from turtlelog.display import describe_count
from turtlelog.errors import SimulationError, UsageError
from turtlelog.files.urls import make_path
from turtlelog.run.ending import find_goal_end

if TYPE_CHECKING:
    from turtlelog import Run, Scenario
    from turtlelog.draw.rerun.viewer import ViewerProcess
    from turtlelog.log.recording.live_run import Sink
    from turtlelog.simulate import Tick


ScenarioWord = Annotated[str | None, Parameter(name="SCENARIO", completer=complete_preset)]

_ADVICE: Final = (
    "leave out --live, record with -o X.mcap, and `turtlelog view X.mcap --snapshot X.png` makes"
    " a picture, `--web` a page for a browser"
)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class LiveOptions:
    """Options while the loop runs and after it.

    Attributes:
        watch: Run again when the file of the law or the scenario file is saved, and show what
            changed. Ctrl-C, or closing the window of --live, ends the command.
        realtime: Run at the speed of the wall clock.
        live: Show the run in a viewer while it runs, and until its window is closed.
        connect: Show the run in a viewer that is already open. Example:
            rerun+http://127.0.0.1:9876/proxy.
        step_budget_ms: End the run if the law computes longer than this in one step (wall-clock
            time). Default: 10000. Unit: ms. Without the option, built-in laws have no limit.
    """

    watch: bool = False
    realtime: bool = False
    live: bool = False
    connect: Connect = None
    step_budget_ms: StepBudgetMs = None


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOptions:
    """Options for written files, and for trusted code.

    Attributes:
        output: Write the recording to this .mcap file.
        rrd: Write a Rerun recording to this .rrd file.
        strip_scenario: Leave the scenario out of the recording, and name the run after its file.
            Then `turtlelog explain` can be tried on a run with unknown settings.
        trust_law: Run the code of the law that a recording or table names, if the law is not built
            in.
    """

    output: Output = None
    rrd: Annotated[Place | None, Parameter(name="--rrd")] = None
    strip_scenario: bool = False
    trust_law: bool = False


def run(
    scenario: ScenarioWord = None,
    /,
    *,
    options: LawOptions | None = None,
    source: RowOptions | None = None,
    record: RecordOptions | None = None,
    live: LiveOptions | None = None,
    json: Json = False,
) -> int:
    """Simulate a scenario in closed loop, print how it ended and its metrics, record it.

    Example: turtlelog run paper-kp10 --set loop.queue_policy=newest -o kp10.mcap

    With --realtime, the recording is written to a new file while the loop runs. That file is
    readable up to the last second, however the run ends. Ctrl-C or a terminal that closes ends the
    run and completes the file (exit code 130). With --live a viewer shows the run; closing the
    viewer does not end the run. If a law fails, the samples before the failure are written (exit
    code 2).

    Notes on stderr report a gain above the stability limit, which theory gives for the dead time of
    these settings. Further notes report a goal, goal heading or path that the law ignores.

    Args:
        scenario: A preset (turtlelog list presets), a scenario file (.toml), or a recording, whose
            scenario is simulated again. Default: paper; with --law: textbook.
        json: Print one JSON object instead of tables.
    """
    record, live, source = record or RecordOptions(), live or LiveOptions(), source or RowOptions()
    _require_sound(scenario, record, live, json=json)
    if live.watch:
        if source.table is not None:
            raise UsageError("--watch: leave out --from, whose table does not change")
        return _watch(scenario, options or LawOptions(), record, live)
    chosen = _resolve(source.load(scenario, options), options, record)
    with _open_viewer(live) as (window, url):
        result = _run(chosen, record, live, url)
        code = _answer(result, record, is_recorded=live.realtime, json=json)
        if window is not None and code == EXIT_FINE:
            flush_stdout()
            with suppress(KeyboardInterrupt):  # all is done: only the window is closed
                window.wait()
    return code


def scenario(
    scenario: ScenarioWord = None,
    /,
    *,
    options: LawOptions | None = None,
) -> None:
    """Print the scenario of a preset, file or recording as a whole file, to edit and run.

    The code of a law of your own is not loaded: only the given keys are printed.

    Example: turtlelog scenario paper-kp10 > mine.toml

    Args:
        scenario: A preset (turtlelog list presets), a scenario file (.toml), or a recording.
            Default: paper; with --law: textbook.
    """
    chosen = load_changed_scenario(scenario, options)
    print_text(tl.format_scenario(chosen))


def _require_sound(
    scenario: str | None, record: RecordOptions, live: LiveOptions, *, json: bool
) -> None:
    """Refuse options that cannot be combined, and outputs that could not be written."""
    inputs = [] if scenario is None else [make_path(scenario)]
    require_new_target(record.output, inputs, suffix=".mcap")
    require_new_target(record.rrd, inputs, suffix=".rrd")
    if record.strip_scenario and live.realtime:
        raise UsageError("--strip-scenario: leave out --realtime, which writes the scenario first")
    if record.strip_scenario and record.output is None and record.rrd is None:
        raise UsageError("--strip-scenario: needs -o or --rrd")
    if live.watch and live.realtime:
        raise UsageError("--watch: leave out --realtime")
    if live.watch and json:
        raise UsageError("--watch: leave out --json, as there are many runs")


def _resolve(chosen: "Scenario", options: LawOptions | None, record: RecordOptions) -> "Scenario":
    """Return a scenario with its law's parameters, and print the notes on it."""
    chosen = tl.scenario.resolve_scenario(chosen, trust_law=record.trust_law)
    for note in tl.simulate.list_scenario_notes(chosen, given=list_given_keys(options)):
        print_note(note)
    return chosen


def _watch(
    scenario: str | None, options: LawOptions, record: RecordOptions, live: LiveOptions
) -> int:
    file, kind = find_scenario_file(scenario), options.find_law_kind()
    if file is None and kind is None:
        kind = load_changed_scenario(scenario, options).law.kind
    files = list_watched(file, kind)

    def load() -> "tuple[Scenario, Sequence[Path]]":
        chosen = load_changed_scenario(scenario, options)
        return chosen, list_watched(file, chosen.law.kind)

    with _open_viewer(live) as (window, url):

        def simulate(chosen: "Scenario") -> "Run":
            return _run(_resolve(chosen, options, record), record, live, url)

        def answer(result: "Run", before: "Run | None") -> int:
            return _answer(result, record, before=before)

        def is_over() -> bool:
            return window is not None and window.has_ended

        return watch_runs(files, load, simulate, answer, is_over=is_over)


def _answer(
    result: "Run",
    record: RecordOptions,
    *,
    is_recorded: bool = False,
    json: bool = False,
    before: "Run | None" = None,
) -> int:
    code = EXIT_INTERRUPTED if result.stop_reason == "interrupted" else EXIT_FINE
    if code:
        print_note(f"interrupted at {result.end_ns / 1e9:.3f} s")
    for name, note in result.notes.items():
        print_note(f"{name.replace('_', ' ')}: {note}")
    _write(result, record, is_recorded=is_recorded)
    if json:
        print_json(build_run_answer(result, output=record.output, rrd=record.rrd))
    else:
        print_text(_describe_ending(result, file=record.output, before=before))
    return code


def _write(run: "Run", record: RecordOptions, *, is_recorded: bool) -> None:
    if record.output is not None:
        with show_progress("writing"):
            if not is_recorded:
                written = _strip(run, record.output) if record.strip_scenario else run
                tl.write_recording(written, record.output)
        print_note(f"wrote {record.output}")
    if record.rrd is not None:
        with show_progress("writing"):
            shown = _strip(run, record.rrd) if record.strip_scenario else run
            tl.write_run_rrd(shown, record.rrd)
        print_note(f"wrote {record.rrd}")


def _strip(run: "Run", path: Path) -> "Run":
    """Return a run with only observable data: rows, goal, end, and loops."""
    known = tl.run.paths.PATH_KEYS  # a path is observable like the goal: errors refer to it
    return replace(
        run,
        name=path.stem,
        parameters={key: value for key, value in run.parameters.items() if key in known},
        scenario_is_complete=False,
        absent=("parameters",),
        notes={"scenario": "left out when the run was recorded"},
    )


def _simulate(scenario: "Scenario", step_budget_s: float) -> "Run":
    from turtlelog.simulate import collect_run, iterate_ticks

    ticks = iterate_ticks(scenario, step_budget_s=step_budget_s)
    return collect_run(scenario, watch_ticks(ticks, scenario.max_duration_s))


@contextmanager
def _open_viewer(live: LiveOptions) -> "Iterator[tuple[ViewerProcess | None, str | None]]":
    """Yield the requested window, if any, and the address at which the viewer receives data."""
    if live.connect is not None or not live.live:
        yield None, live.connect
        return
    with tl.draw.open_window(_ADVICE) as (window, url):
        yield window, url


def _run(scenario: "Scenario", record: RecordOptions, live: LiveOptions, url: str | None) -> "Run":
    """Return the run. If a law fails, write the part before the failure."""
    try:
        return _drive(scenario, record.output, live, url)
    except SimulationError as err:
        if err.run is not None:
            _write(err.run, record, is_recorded=live.realtime)
        raise


def _drive(scenario: "Scenario", output: Path | None, live: LiveOptions, url: str | None) -> "Run":
    if not live.realtime and url is None:
        return _simulate(scenario, choose_step_budget(live.step_budget_ms))
    from turtlelog.log.file_access import hold_stop, interrupt_on_quit

    with ExitStack() as closing:
        closing.enter_context(interrupt_on_quit())
        sinks: list[Sink] = []
        viewer = None if url is None else tl.draw.LiveViewer(scenario, url)
        if viewer is not None:
            closing.callback(viewer.close, {})  # even if no run starts
        if live.realtime and output is not None:
            with hold_stop():  # created files are always finished
                recorder = tl.Recorder(output, scenario)
                closing.callback(recorder.close)
            sinks.append(recorder)
        sinks += [] if viewer is None else [viewer]
        progress = show_progress("simulated", scenario.max_duration_s, "s at most")
        sinks.append(_Watcher(closing.enter_context(progress)))
        result = tl.log.run_live(
            scenario,
            sinks,
            realtime=live.realtime,
            step_budget_s=choose_step_budget(live.step_budget_ms),
        )
    if viewer is not None and viewer.lost:
        print_note(f"viewer: {viewer.lost}; the run went on without it")
    return result


class _Watcher:
    """Display of the progress of a live run."""

    def __init__(self, progress: ProgressLine) -> None:
        self._progress = progress

    def receive(self, tick: "Tick") -> None:
        self._progress.done = tick.time_ns / 1e9

    def close(self, notes: Mapping[str, str]) -> None:  # noqa: ARG002
        self._progress.close()


_LONGEST: Final = 24
"""Longest name in a table [characters]. The changes in a longer name have a separate line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunAnswer:
    """The end of a simulated run.

    Attributes:
        name: Name of the run.
        file: Written recording; None without a recording.
        rrd: Written Rerun recording; None without a Rerun recording.
        samples: Number of samples.
        stop_reason: Reason why the run ended.
        ending: End of the run at its goal, in words; None without a goal.
        metrics: All metrics of the run.
    """

    name: str
    file: str | None
    rrd: str | None
    samples: int
    stop_reason: str | None
    ending: str | None
    metrics: list[dict[str, Any]]


def build_run_answer(run: "Run", *, output: Path | None, rrd: Path | None) -> RunAnswer:
    """Return the answer."""
    end = find_goal_end(run)
    return RunAnswer(
        name=run.name,
        file=None if output is None else str(output),
        rrd=None if rrd is None else str(rrd),
        samples=len(run.samples),
        stop_reason=run.stop_reason,
        ending=None if end is None else end.describe(),
        metrics=describe_metrics(tl.measure_run(run)),
    )


def _describe_ending(run: "Run", *, file: Path | None, before: "Run | None") -> str:
    """Return how a run ended, and its essential metrics; after a change, those that changed."""
    name, changes = _split_name(run)
    facts = [f"Changed: {changes}"] if changes else []
    facts += [f"{describe_count(len(run.samples), 'sample')}. {run.events[-1].text}"]
    needed = list_needed(run, has_path=False)
    summary = tl.compare.summarise_run(
        run, file="" if file is None else str(file), metrics=tl.measure_run(run, only=needed)
    )
    if before is not None:
        head = fill_lines([f"{name}: {tl.compare.describe_end(summary)}.", *facts])
        return f"{head}\n\n{describe_change(run, before)}"
    return format_run(summary, name, facts=facts)


def _split_name(run: "Run") -> tuple[str, str]:
    """Return a name that fits a table, and the changes that a longer name contains."""
    base, _, changes = run.name.partition(" ")
    return (run.name, "") if len(run.name) <= _LONGEST or not changes else (base, changes)
