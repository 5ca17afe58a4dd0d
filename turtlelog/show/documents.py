"""What stands beside the pictures as text: tables and the scenario, in Markdown."""

from collections.abc import Mapping, Sequence

from turtlelog.compare import tabulate_metrics, tabulate_table1, tabulate_whole_runs
from turtlelog.run import Run
from turtlelog.show.tables import format_markdown


def describe_run(run: Run) -> Mapping[str, str]:
    """Return the documents of one run by title: metrics, and what is known of its scenario."""
    rows = [f"| {key} | {value} |" for key, value in run.parameters.items()]
    scenario = "\n".join(["| key | value |", "| --- | --- |", *rows]) + "\n"
    return {"Metrics": format_markdown(tabulate_metrics([run])), "Scenario": scenario}


def describe_runs(runs: Sequence[Run]) -> Mapping[str, str]:
    """Return the documents of a comparison by title: Table 1, with and without its window."""
    table1 = format_markdown(tabulate_table1(runs))
    return {
        "Table 1": f"{table1}\n{format_markdown(tabulate_whole_runs(runs))}",
        "Metrics": format_markdown(tabulate_metrics(runs)),
    }
