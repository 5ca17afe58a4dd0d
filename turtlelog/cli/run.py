"""`turtlelog run`: simulation of a scenario."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.metrics_answer import format_run, list_summary_metrics
from turtlelog.cli.scenario import (
    LawOptions,
    RowOptions,
    ScenarioWord,
    find_scenario_file,
    list_given_keys,
    load_changed_scenario,
)
from turtlelog.cli.work import (
    ProgressLine,
    read_texts,
    show_progress,
    wait_for_save,
    watch_ticks,
)
from turtlelog.display import describe_count
from turtlelog.errors import SimulationError, TurtlelogError, UsageError
from turtlelog.files.urls import make_path
from turtlelog.run.stop_reasons import INTERRUPTED, find_goal_end

if TYPE_CHECKING:
    from turtlelog import Run, Scenario
    from turtlelog.draw.rerun.viewer import ViewerProcess


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
    connect: options.Connect = None
    step_budget_ms: options.StepBudgetMs = None


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

    output: options.Output = None
    rrd: Annotated[options.Place | None, Parameter(name="--rrd")] = None
    strip_scenario: bool = False
    trust_law: bool = False


def run(
    scenario: ScenarioWord = None,
    /,
    *,
    changes: LawOptions = LawOptions(),
    source: RowOptions = RowOptions(),
    record: RecordOptions = RecordOptions(),
    live: LiveOptions = LiveOptions(),
    json: options.Json = False,
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
    _require_sound(scenario, record, live, json=json)
    if live.watch:
        if source.table is not None:
            raise UsageError("--watch: leave out --from, whose table does not change")
        return _watch(scenario, changes, record, live)
    chosen = _resolve(source.load(scenario, changes), changes, record)
    with _open_viewer(live) as (window, url):
        result = _run(chosen, record, live, url)
        code = _answer(result, record, is_recorded=live.realtime, json=json)
        if window is not None and code == console.EXIT_FINE:
            console.flush_stdout()
            with suppress(KeyboardInterrupt):  # all is done: only the window is closed
                window.wait()
    return code


def _require_sound(
    scenario: str | None, record: RecordOptions, live: LiveOptions, *, json: bool
) -> None:
    inputs = [] if scenario is None else [make_path(scenario)]
    options.require_new_target(record.output, inputs, suffix=".mcap")
    options.require_new_target(record.rrd, inputs, suffix=".rrd")
    if record.strip_scenario and live.realtime:
        raise UsageError("--strip-scenario: leave out --realtime, which writes the scenario first")
    if record.strip_scenario and record.output is None and record.rrd is None:
        raise UsageError("--strip-scenario: needs -o or --rrd")
    if live.watch and live.realtime:
        raise UsageError("--watch: leave out --realtime")
    if live.watch and json:
        raise UsageError("--watch: leave out --json, as there are many runs")


def _resolve(chosen: "Scenario", changes: LawOptions, record: RecordOptions) -> "Scenario":
    """Return a scenario with its law's parameters, and print the notes on it."""
    chosen = tl.scenario.resolve_scenario(chosen, trust_law=record.trust_law)
    for note in tl.simulate.list_scenario_notes(chosen, given=list_given_keys(changes)):
        console.print_note(note)
    return chosen


def _watch(
    scenario: str | None, changes: LawOptions, record: RecordOptions, live: LiveOptions
) -> int:
    """Run, and run again after each save of a file until Ctrl-C; return the exit code.

    An error of the law or the scenario is printed in one line; the next save runs again.
    """
    file, kind = find_scenario_file(scenario), changes.find_law_kind()
    if file is None and kind is None:
        kind = load_changed_scenario(scenario, changes).law.kind
    files = _list_watched(file, kind)
    before: Run | None = None
    told: Sequence[Path] = ()
    with _open_viewer(live) as (window, url), suppress(KeyboardInterrupt):
        while True:
            seen = read_texts(files)
            try:
                chosen = load_changed_scenario(scenario, changes)
                files = _list_watched(file, chosen.law.kind)
                seen = {**read_texts(files), **seen}
                result = _run(_resolve(chosen, changes, record), record, live, url)
                code = _answer(result, record, before=before)
                if code != console.EXIT_FINE:
                    return code
                before = result
            except (TurtlelogError, OSError) as err:
                console.print_error(str(err))
            console.flush_stdout()
            if told != files:
                names = ", ".join(map(str, files))
                console.print_note(f"watching {names}: every save runs again, Ctrl-C ends")
                told = files
            saved = wait_for_save(files, seen, lambda: window is not None and window.has_ended)
            if saved is None:
                return console.EXIT_FINE
            console.print_note(f"saved: {saved}")
    console.print_note("watch ended")
    return console.EXIT_INTERRUPTED


def _answer(
    result: "Run",
    record: RecordOptions,
    *,
    is_recorded: bool = False,
    json: bool = False,
    before: "Run | None" = None,
) -> int:
    code = console.EXIT_INTERRUPTED if result.stop_reason == INTERRUPTED else console.EXIT_FINE
    if code:
        console.print_note(f"interrupted at {result.end_ns / 1e9:.3f} s")
    for name, note in result.notes.items():
        console.print_note(f"{tl.log.label_note(name)}: {note}")
    _write(result, record, is_recorded=is_recorded)
    if json:
        end = find_goal_end(result)
        console.print_json(
            RunAnswer(
                name=result.name,
                file=None if record.output is None else str(record.output),
                rrd=None if record.rrd is None else str(record.rrd),
                samples=len(result.samples),
                stop_reason=result.stop_reason,
                ending=None if end is None else end.describe(),
                metrics=[one.to_dict() for one in tl.measure_run(result).values()],
            )
        )
    else:
        console.print_text(_describe_ending(result, file=record.output, before=before))
    return code


def _write(run: "Run", record: RecordOptions, *, is_recorded: bool) -> None:
    for path, is_rrd in ((record.output, False), (record.rrd, True)):
        if path is None:
            continue
        with show_progress("writing"):
            if is_rrd or not is_recorded:
                written = _strip(run, path) if record.strip_scenario else run
                (tl.write_run_rrd if is_rrd else tl.write_recording)(written, path)
        console.print_note(f"wrote {path}")


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
    step_budget_s = options.choose_step_budget(live.step_budget_ms)
    if not live.realtime and url is None:
        from turtlelog.simulate import collect_run, iterate_ticks

        ticks = iterate_ticks(scenario, step_budget_s=step_budget_s)
        return collect_run(scenario, watch_ticks(ticks, scenario.max_duration_s))
    from turtlelog.stop_signals import hold_stop, interrupt_on_quit

    with ExitStack() as closing:
        closing.enter_context(interrupt_on_quit())
        sinks: list[tl.simulate.Sink] = []
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
        result = tl.simulate.run_live(
            scenario, sinks, realtime=live.realtime, step_budget_s=step_budget_s
        )
    if viewer is not None and viewer.lost:
        console.print_note(f"viewer: {viewer.lost}; the run went on without it")
    return result


class _Watcher:
    """Display of the progress of a live run."""

    def __init__(self, progress: ProgressLine) -> None:
        self._progress = progress

    def receive(self, tick: "tl.simulate.Tick") -> None:
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
        file: Written recording.
        rrd: Written Rerun recording.
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


def _describe_ending(run: "Run", *, file: Path | None, before: "Run | None") -> str:
    """Return how a run ended, and its essential metrics; after a change, those that changed."""
    # A name that fits a table, and the changes that a longer name contains.
    base, _, changes = run.name.partition(" ")
    name = base if changes and len(run.name) > _LONGEST else run.name
    facts = [f"Changed: {changes}"] if name != run.name else []
    facts += [f"{describe_count(len(run.samples), 'sample')}. {run.events[-1].text}"]
    needed = list_summary_metrics(run, has_path=False)
    summary = tl.compare.summarise_run(
        run, file="" if file is None else str(file), metrics=tl.measure_run(run, only=needed)
    )
    if before is not None:
        head = console.fill_lines([f"{name}: {tl.compare.describe_end(summary)}.", *facts])
        return f"{head}\n\n{_describe_change(run, before)}"
    return format_run(summary, name, facts=facts)


def _list_watched(scenario_file: Path | None, kind: str | None) -> tuple[Path, ...]:
    """Return the files that determine a run: of the scenario and of the law, at least one."""
    place = (kind or "").rpartition(":")[0]
    law_file = Path(place) if place.endswith(".py") else None
    files = tuple(file for file in (scenario_file, law_file) if file is not None)
    if not files:
        raise UsageError(
            f"--watch: the law {kind} has no file to watch; name a scenario file, or a law as"
            " path.py:Class"
        )
    for file in files:
        if not file.is_file():
            raise UsageError(f"{file}: no such file to watch")
    return files


def _describe_change(run: "Run", before: "Run") -> str:
    """Return a table of the essential metrics that changed, with their former values."""
    declarations = run.declaration, before.declaration
    essential = tl.measure.list_essential_metrics(*declarations)
    now, was = tl.measure_run(run), tl.measure_run(before)
    changed = [name for name in essential if now.get(name) != was.get(name)]
    if not changed:
        return "No metric changed."
    kept = [{name: one[name] for name in changed if name in one} for one in (now, was)]
    text = console.fit_table(tl.compare.tabulate_measured(("now", "before"), kept))
    same = len(essential) - len(changed)
    return f"{text}\n{describe_count(same, 'essential metric')} did not change." if same else text
