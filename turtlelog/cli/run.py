"""`turtlelog run`: simulate a scenario."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Json, Output, ScenarioOptions, load_changed_scenario
from turtlelog.cli.output import describe_metrics, print_json, print_note, print_text


def run(
    scenario: str = "paper",
    /,
    *,
    options: ScenarioOptions | None = None,
    output: Output = None,
    rrd: Annotated[Path | None, Parameter(name="--rrd")] = None,
    json: Json = False,
) -> None:
    """Simulate a scenario in closed loop, print its metrics, record it.

    Example: turtlelog run paper-kp10 --set loop.queue_policy=newest -o kp10.mcap

    Args:
        scenario: A preset (paper-kp1, paper-kp2, paper-kp4, paper-kp10, paper, textbook) or a
            scenario file.
        output: Write the recording to this .mcap file.
        rrd: Write a Rerun recording to this .rrd file.
        json: Print one JSON object instead of tables.
    """
    chosen = load_changed_scenario(scenario, options)
    result = tl.simulate_run(chosen)
    if output is not None:
        tl.write_recording(result, output)
        print_note(f"wrote {output}")
    if rrd is not None:
        tl.write_run_rrd(result, rrd, documents=tl.describe_run(result))
        print_note(f"wrote {rrd}")
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
        return
    print_text(f"{result.name}: {len(result.samples)} samples. {result.events[-1].text}\n")
    print_text(tl.format_table(tl.tabulate_metrics([result])))
