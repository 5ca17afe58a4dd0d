"""The command line: its commands, and the conversion of known errors to one line."""

import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final

from cyclopts import App, CycloptsError, Group, Parameter

from turtlelog.cli import console
from turtlelog.cli.usage import HelpFormatter, describe_usage_error, find_split_pair, show_default
from turtlelog.cli.work import end_progress
from turtlelog.errors import TurtlelogError, UsageError, describe_unknown
from turtlelog.files.urls import RemoteNote, limit_downloads
from turtlelog.libraries import __version__

_COMMANDS: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "Simulate": {
        "run": (
            "[SCENARIO]",
            "Simulate a scenario in closed loop, print how it ended and its metrics, record it.",
        ),
        "scenario": (
            "[SCENARIO]",
            "Print the scenario of a preset, file or recording as a whole file, to edit and run.",
        ),
        "sweep": (
            "[SCENARIO] -o OUT",
            "Vary a scenario, simulate and measure every variant, and write one table.",
        ),
        "tune": (
            "[SCENARIO]",
            "Search the best values of a scenario's keys, and show how far each value can move.",
        ),
        "theory": (
            "",
            "Recommend gains, and give the limits of P, PI, PD or PID control of an integrator.",
        ),
    },
    "Ask": {
        "info": (
            "FILE...",
            "Describe files: a recording, a robot's bag or a table, its data, and what is missing.",
        ),
        "metrics": (
            "FILE...",
            "Measure recordings: where each run ends, and how its loops respond.",
        ),
        "compare": (
            "FILE...",
            "Compare runs: which is best at what. With --reference: how much each differs.",
        ),
        "explain": (
            "FILE",
            "Explain a metric of a run: which effect of the implementation contributes how much.",
        ),
        "identify": (
            "FILE...",
            "Identify how a robot follows its commands: gain, dead time, time constant of each"
            " axis.",
        ),
        "replay": ("FILE", "Replay a recording and show where the result departs from it."),
        "list": (
            "KIND",
            "List the names of metrics, signals, presets, laws, plants, causes or figures.",
        ),
    },
    "Check": {
        "check": (
            "SPEC FILE...",
            "Check recordings against a specification: bounds, temporal-logic formulas,"
            " tolerances.",
        )
    },
    "Show": {
        "view": (
            "FILE...",
            "Open recordings in the Rerun viewer; several recordings are overlaid for comparison.",
        ),
        "plot": (
            "[FILE...] -o OUT",
            "Plot recordings as the paper's figures and tables, and the table of a sweep as maps.",
        ),
        "report": (
            "FILE... -o OUT",
            "Write a report on runs as one file of HTML, which opens without a network.",
        ),
    },
    "Files": {
        "convert": (
            "FILE -o OUT",
            "Convert a recording, bag, log or table: to .mcap, .csv, .parquet, .tum, or a ROS 2"
            " folder.",
        ),
        "demo": (
            "",
            "Simulate and record the paper's four runs (Kp = 1, 2, 4, 10) and compare them.",
        ),
    },
}
"""Commands by help group, with their arguments and the first sentence of each docstring."""


_SUMMARIES: Final = {
    name: summary for group in _COMMANDS.values() for name, (_, summary) in group.items()
}

_USUAL: Final[Mapping[str, frozenset[str]]] = {
    command: frozenset(f"--{name}" for name in names.split())
    for command, names in {
        "run": "set kp goal law output live watch json",
        "sweep": "grid sample metrics set record jobs json",
        "tune": "grid minimise maximise subject-to set monte-carlo output json",
        "theory": "kp ki kd lag dead-time dead-time-s period overshoot details json",
        "info": "topics parameters partial jobs json",
        "metrics": "only all goal output csv json",
        "compare": "reference ate why first only sort where rrd json",
        "explain": "metric causes details scenario rrd trust-law json",
        "identify": "scenario plot rrd details json",
        "replay": "set law plant expect-equal details output json",
        "check": "expect init output reference all junit json",
        "view": "save snapshot web movie partial goal",
        "plot": "output only metric format kind movie json",
        "report": "output spec explain json",
        "convert": "to table recover partial json",
    }.items()
}
"""Options that --help shows; --help-all shows all options."""

_help_formatter = HelpFormatter(_SUMMARIES, _USUAL)

app = App(
    name="turtlelog",
    help=(
        "What did my loop really do? Simulate the ROS 2 turtlesim robot under feedback, record it"
        " to MCAP, measure, compare, and show it in Rerun.\n\n"
        "Begin with: turtlelog demo\n\n"
        "Help on a command: turtlelog help run"
    ),
    version=f"turtlelog {__version__}",
    help_format="plaintext",
    help_formatter=_help_formatter,
    default_parameter=Parameter(negative="", show_default=show_default),
    group_parameters=Group("Options", sort_key=1),
    suppress_keyboard_interrupt=False,
)


_PLACES: Final = {"list": "list_names:list_"}
"""Module and function of commands that have no module of their name."""


def _register() -> None:
    for rank, (title, commands) in enumerate(_COMMANDS.items()):
        group = Group(title, sort_key=rank)
        for order, (name, (words, _)) in enumerate(commands.items()):
            usage = f"Usage: turtlelog {name} [OPTIONS] {words}".rstrip()
            # As text, so that a command loads only its own module, and help none.
            place = _PLACES.get(name, f"{name}:{name}")
            app.command(
                f"turtlelog.cli.{place}", name=name, group=group, sort_key=order, usage=usage
            )
    others = Group("Help and completion", sort_key=len(_COMMANDS))
    app.command(_help, name="help", group=others, usage="Usage: turtlelog help [COMMAND]")
    app.command(
        "turtlelog.cli.list_names:install_completion",
        name="--install-completion",
        group=others,
        help="Write the completion script of your shell and say where.",
    )
    for flag in ("--help", "--version"):
        app[flag].group = (others,)


def _help(command: str | None = None, /) -> None:
    """Show the help of a command.

    Example: turtlelog help explain

    Args:
        command: Name of the command; without a name, all commands are listed.
    """
    names = [name for name in app if not name.startswith("-")]
    if command is not None and command not in names:
        raise UsageError(describe_unknown("command", command, names, place="turtlelog --help"))
    app.help_print([] if command is None else [command])


_register()


def main(tokens: Sequence[str] | None = None) -> None:
    """Run a command and exit: 0 success, 1 failed check, 2 bad usage or unreadable input."""
    _prepare_streams()
    try:
        code = _call(tokens)
    except (TurtlelogError, CycloptsError) as err:
        text = describe_usage_error(err) if isinstance(err, CycloptsError) else str(err)
        text = find_split_pair(sys.argv[1:] if tokens is None else tokens) or text
        code = _fail(text, console.EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        code = _fail("interrupted", console.EXIT_INTERRUPTED)
    except OSError as err:
        text = f"{err.filename}: cannot be used: {err.strerror}"
        if err.filename is None:
            console.drop_stdout()
            text = f"standard output: cannot be written: {err}"
        code = _fail(text, console.EXIT_BAD_INPUT)
    except Exception:
        import traceback

        traceback.print_exc()
        code = _fail("this is a defect of turtlelog; please report it", console.EXIT_DEFECT)
    console.print_held_notes()
    sys.exit(code if isinstance(code, int) else console.EXIT_FINE)


_ALL: Final = "--help-all"

_NO_DOCSTRINGS: Final = (
    "help and the meanings of metrics are incomplete, because Python runs without docstrings: leave"
    " out -OO or PYTHONOPTIMIZE=2"
)


def _call(tokens: Sequence[str] | None) -> Any:
    tokens = sys.argv[1:] if tokens is None else tokens
    _help_formatter.shows_all = _ALL in tokens
    tokens = ["--help" if token == _ALL else token for token in tokens]
    if sys.flags.optimize > 1 and not {"list", "help", "--help"}.isdisjoint(tokens):
        console.print_note(_NO_DOCSTRINGS)
    with _stop_on_request(), _print_remote_notes(), limit_downloads():
        try:
            code = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
        finally:
            end_progress()
        console.flush_stdout()
    return code


@contextmanager
def _print_remote_notes() -> Iterator[None]:
    """Print messages about the reading of a URL as notes."""

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, RemoteNote):
            console.print_note(str(message))
        else:
            usual(message, category, *place, **more)

    with warnings.catch_warnings():
        usual, warnings.showwarning = warnings.showwarning, show
        warnings.simplefilter("always", RemoteNote)
        yield


@contextmanager
def _stop_on_request() -> Iterator[None]:
    """Treat requests to end and a closed terminal like Ctrl-C: nothing is left half done."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    numbers = [getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")]
    is_main = threading.current_thread() is threading.main_thread()
    # Existing settings are kept, such as nohup's to ignore the end of the terminal.
    known = [number for number in numbers if number and signal.getsignal(number) == signal.SIG_DFL]
    for number in known if is_main else ():
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in known if is_main else ():
            signal.signal(number, signal.SIG_DFL)


def _prepare_streams() -> None:
    """Make both streams accept any text, even if they are closed or support only ASCII."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _fail(text: str, code: int) -> int:
    console.print_held_notes()
    console.print_error(text)
    return code
