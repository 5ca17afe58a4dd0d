"""`turtlelog demo`: the paper's experiment, recorded and compared."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.usage import find_command_name
from turtlelog.display import format_short
from turtlelog.errors import UsageError
from turtlelog.libraries import load_library


def demo(
    *, output: Annotated[options.Place, Parameter(name=("--output", "-o"))] = Path("demo-out")
) -> None:
    """Simulate and record the paper's four runs (Kp = 1, 2, 4, 10) and compare them.

    Example: turtlelog demo -o demo-out

    Args:
        output: Folder of the recordings (.mcap), Rerun recordings (.rrd) and Table 1.
    """
    load_library("rerun")
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise UsageError(f"{output}: cannot be a folder: {err.strerror}") from err
    runs = [_record_preset(name, output) for name in tl.scenario.PAPER_RUNS]
    tl.write_comparison_rrd(runs, output / "comparison.rrd")
    console.print_note(f"wrote {output / 'comparison.rrd'}")
    table1 = tl.compare.tabulate_table1(runs, beside_paper=True)
    for kind in tl.draw.TABLE_FORMATS:
        console.write_text(output / f"table1.{kind}", tl.draw.format_table(table1, kind))
    console.print_note(f"wrote {output / 'table1'}.{{{','.join(tl.draw.TABLE_FORMATS)}}}")
    console.print_note("")
    tables = [
        tl.draw.format_table(replace(table, notes=()), width=console.find_width())
        + console.fill_lines([*table.notes, ""])
        for table in (table1, tl.compare.tabulate_whole_runs(runs))
    ]
    name = "final.position_error"
    errors = {run.name: tl.measure_run(run, only=[name])[name].value or 0.0 for run in runs}
    near, far = (choose(errors, key=errors.__getitem__) for choose in (min, max))
    answer = (
        f"{output}: {len(runs)} runs. {near} ends {format_short(errors[near], 'm')} from the goal,"
        f" {far} {format_short(errors[far], 'm')}."
    )
    command = find_command_name()
    following = (
        f"See the four runs:   {command} view {output / 'comparison.rrd'}\n"
        f"See one of them:     {command} view {output / 'kp10.rrd'}\n"
        f"Why does it miss?    {command} explain {output / 'kp10.mcap'}\n"
        f"Change one thing:    {command} run paper-kp10 --set loop.queue_policy=newest"
    )
    console.print_text("\n".join([f"{console.fill_lines([answer])}\n", *tables, following]))


def _record_preset(name: str, folder: Path) -> "tl.Run":
    """Simulate, record, read back and show a preset. Only the file's contents are measured."""
    stem = name.removeprefix("paper-")
    recording, rrd = folder / f"{stem}.mcap", folder / f"{stem}.rrd"
    tl.write_recording(tl.simulate_run(tl.load_scenario(name)), recording)
    run = tl.read_recording(recording)
    tl.write_run_rrd(run, rrd)
    console.print_note(f"wrote {recording} and {rrd}: {len(run.samples)} samples")
    return run
