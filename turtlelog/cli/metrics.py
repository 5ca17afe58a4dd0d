"""`turtlelog metrics`: measure recordings."""

import turtlelog as tl
from turtlelog.cli.options import Files, Json, TopicOptions, iterate_runs
from turtlelog.cli.output import describe_metrics, print_json, print_text


def metrics(files: Files, /, *, topics: TopicOptions | None = None, json: Json = False) -> None:
    """Measure recordings: a table with a row per metric, a status where there is no value.

    Example: turtlelog metrics kp1.mcap kp4.mcap

    Args:
        files: Recordings (.mcap), ROS 2 bags, or the paper's logs (.json, .csv).
        json: Print one JSON list instead of a table.
    """
    runs = iterate_runs(files, topics)
    if json:
        print_json(
            [
                {
                    "file": str(path),
                    "name": run.name,
                    "metrics": describe_metrics(tl.measure_run(run)),
                }
                for path, run in zip(files, runs, strict=True)
            ]
        )
        return
    print_text(tl.format_table(tl.tabulate_metrics(list(runs))))
