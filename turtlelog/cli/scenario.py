"""`turtlelog scenario`: print a scenario file."""

import turtlelog as tl
from turtlelog.cli.options import ScenarioOptions, load_changed_scenario
from turtlelog.cli.output import print_text


def scenario(
    scenario: str = "paper",
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
