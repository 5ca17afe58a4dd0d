"""`turtlelog compare`: distances of recorded robots from the simulated robot of a scenario."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import turtlelog as tl
from turtlelog.cli.compare_answer import format_robots
from turtlelog.cli.options import ReadingOptions, read_runs
from turtlelog.cli.output import (
    EXIT_BAD_INPUT,
    EXIT_FINE,
    copy_fields,
    print_error,
    print_json,
    print_note,
    print_tables,
    print_text,
)
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_pictures
from turtlelog.errors import TurtlelogError, UsageError

if TYPE_CHECKING:
    from turtlelog import Scenario
    from turtlelog.compare import NoiseLevel, RobotComparison
    from turtlelog.run import Clock


def list_scenario_files(files: Sequence[Path]) -> list[Path]:
    """Return the files that are scenarios, judging by their suffix."""
    return [file for file in files if file.suffix.lower() == ".toml"]


def compare_with_robot(
    files: Sequence[Path],
    *,
    plot: Path | None,
    rrd: Path | None,
    topics: ReadingOptions | None,
    kind: str,
) -> int:
    """Print the distances of recorded robots from the robot of a scenario among the files."""
    bags, scenario_file = _part(files)
    require_pictures(plot, rrd, files, drawn=bags, of="bag")
    scenario = _load(scenario_file)
    found: list[tuple[Path, RobotComparison]] = []
    is_fine = True
    for bag in bags:
        try:
            (run,) = read_runs([bag], topics)
            with show_progress(f"simulating {run.name}"):
                found.append((bag, tl.compare.compare_robot(run, scenario)))
        except TurtlelogError as err:
            print_error(str(err))
            is_fine = False
    if found:
        _print(found, scenario_file, kind)
        _draw(found[0][1], plot, rrd)
    return EXIT_FINE if is_fine else EXIT_BAD_INPUT


def _part(files: Sequence[Path]) -> tuple[list[Path], Path]:
    scenarios = list_scenario_files(files)
    if len(scenarios) > 1:
        named = ", ".join(map(str, scenarios))
        raise UsageError(f"name one scenario to compare bags with, not {named}")
    bags = [file for file in files if file not in scenarios]
    if not bags:
        raise UsageError(
            f"compare {scenarios[0]} needs a bag or a recording beside the scenario; two"
            " scenarios are compared by their runs, which turtlelog run records"
        )
    return bags, scenarios[0]


def _load(file: Path) -> "Scenario":
    scenario = tl.scenario.read_scenario(file)
    if scenario.plant.kind != "lagged":
        raise UsageError(
            f'{file}: must be the scenario of a robot, plant.kind = "lagged", not'
            f" {scenario.plant.kind}; turtlelog replay drives turtlesim with recorded commands"
        )
    return scenario


def _print(found: "Sequence[tuple[Path, RobotComparison]]", scenario: Path, kind: str) -> None:
    if kind == "json":
        seeds = found[0][1].seeds
        runs = [_build_robot(file, one) for file, one in found]
        print_json(_RobotAnswer(reference=str(scenario), seeds=seeds, runs=runs))
        return
    robots = [one for _, one in found]
    if kind == "txt":
        print_text(format_robots(robots, [str(file) for file, _ in found], str(scenario)))
    else:
        print_tables([tl.compare.tabulate_robots(robots)], kind)


@dataclass(frozen=True, slots=True, kw_only=True)
class _BandAnswer:
    """Errors of a quantity after a time, in `unit`; fields as in `ErrorBand`."""

    quantity: str
    unit: str
    horizon_s: float
    pieces: int
    median: float
    largest: float
    largest_at_s: float
    simulated_median: float | None
    within_share: float | None
    above: int | None
    below: int | None
    verdict: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _RobotRun:
    """A recorded robot compared with the simulated one."""

    file: str
    name: str
    overlap_s: float
    signals: tuple[()] = ()
    metrics: tuple[()] = ()
    errors: list[_BandAnswer]
    noise: "tuple[NoiseLevel, ...]"
    clock: "Clock | None"
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _RobotAnswer:
    """Recorded robots compared with the robot of a scenario file."""

    reference: str
    alignment: str = "anchored"
    seeds: int
    runs: list[_RobotRun]


def _build_robot(file: Path, found: "RobotComparison") -> _RobotRun:
    time_ns = found.recorded.time_ns
    return _RobotRun(
        file=str(file),
        name=found.name,
        overlap_s=int(time_ns[-1] - time_ns[0]) / 1e9,
        errors=[
            copy_fields(
                _BandAnswer,
                band,
                unit="m" if band.quantity == "position" else "rad",
                pieces=len(band.recorded),
            )
            for band in found.bands
        ],
        noise=found.noise,
        clock=found.clock,
        notes=found.notes,
    )


def _draw(found: "RobotComparison", plot: Path | None, rrd: Path | None) -> None:
    if plot is not None:
        tl.draw.write_prediction_figure(found, plot)
        print_note(f"wrote {plot}")
    if rrd is not None:
        tl.draw.write_prediction_rrd(found, rrd)
        print_note(f"wrote {rrd}")
