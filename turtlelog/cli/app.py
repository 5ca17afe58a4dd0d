"""The command line: its commands, and the one boundary that turns known errors into one line."""

import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final

from cyclopts import App, CycloptsError, Group, Parameter

from turtlelog.cli.check import check
from turtlelog.cli.compare import compare
from turtlelog.cli.convert import convert
from turtlelog.cli.demo import demo
from turtlelog.cli.explain import explain
from turtlelog.cli.help import HelpFormatter, show_default
from turtlelog.cli.identify import identify
from turtlelog.cli.info import info
from turtlelog.cli.list_names import list_
from turtlelog.cli.metrics import metrics
from turtlelog.cli.output import (
    EXIT_BAD_INPUT,
    EXIT_DEFECT,
    EXIT_FINE,
    EXIT_INTERRUPTED,
    drop_stdout,
    outlive_reader,
    print_error,
)
from turtlelog.cli.plot import plot
from turtlelog.cli.progress import end_progress
from turtlelog.cli.recover import recover
from turtlelog.cli.replay import replay
from turtlelog.cli.report import report
from turtlelog.cli.run import run, scenario
from turtlelog.cli.theory import theory
from turtlelog.cli.usage_errors import describe_usage_error
from turtlelog.cli.view import view
from turtlelog.errors import TurtlelogError, UsageError, suggest_names
from turtlelog.version import __version__

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
    help_formatter=HelpFormatter(),
    default_parameter=Parameter(negative="", show_default=show_default),
    group_parameters=Group("Options", sort_key=1),
    suppress_keyboard_interrupt=False,
)

_COMMANDS: Final[Mapping[str, Mapping[Callable[..., Any], str]]] = {
    "Simulate": {run: "[SCENARIO]", scenario: "[SCENARIO]", theory: ""},
    "Ask": {
        info: "FILE...",
        metrics: "FILE...",
        compare: "FILE...",
        explain: "FILE",
        identify: "FILE...",
        replay: "FILE",
        list_: "KIND",
    },
    "Check": {check: "SPEC FILE..."},
    "Show": {view: "FILE...", plot: "[FILE...] -o OUT", report: "FILE... -o OUT"},
    "Files": {convert: "FILE -o OUT", recover: "FILE -o OUT", demo: ""},
}
"""The commands as help groups them, and the words that each takes."""


def _register() -> None:
    for place, (title, commands) in enumerate(_COMMANDS.items()):
        group = Group(title, sort_key=place)
        for order, (command, words) in enumerate(commands.items()):
            name = command.__name__.strip("_")
            usage = f"Usage: turtlelog {name} [OPTIONS] {words}".rstrip()
            app.command(command, name=name, group=group, sort_key=order, usage=usage)
    others = Group("Help and completion", sort_key=len(_COMMANDS))
    app.command(_help, name="help", group=others, usage="Usage: turtlelog help [COMMAND]")
    app.register_install_completion_command(
        add_to_startup=False,
        group=others,
        help="Write the completion script of your shell and say where.",
    )
    for flag in ("--help", "--version"):
        app[flag].group = (others,)


def _help(command: str | None = None, /) -> None:
    """Show the help of a command.

    Example: turtlelog help explain

    Args:
        command: Its name; without one, all commands are listed.
    """
    names = [name for name in app.resolved_commands() if not name.startswith("-")]
    if command is not None and command not in names:
        near = suggest_names(command, names)
        raise UsageError(f"turtlelog help: expected {near}, found {command!r}")
    app.help_print([] if command is None else [command])


_register()

_FORMER: Final = {"import": "convert LOG -o OUT.mcap", "export": "convert FILE -o OUT"}
"""Commands that have another name now."""


def main(tokens: Sequence[str] | None = None) -> None:
    """Run a command and exit: 0 fine, 1 a check failed, 2 bad usage or unreadable input."""
    _prepare_streams()
    try:
        code = _call(tokens)
    except (TurtlelogError, CycloptsError) as err:
        text = describe_usage_error(err) if isinstance(err, CycloptsError) else str(err)
        code = _fail(text, EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        code = _fail("interrupted", EXIT_INTERRUPTED)
    except OSError as err:
        code = _fail(_describe_os_error(err), EXIT_BAD_INPUT)
    except Exception:
        traceback.print_exc()
        code = _fail("this is a defect of turtlelog; please report it", EXIT_DEFECT)
    sys.exit(code if isinstance(code, int) else EXIT_FINE)


def _call(tokens: Sequence[str] | None) -> Any:
    tokens = sys.argv[1:] if tokens is None else tokens
    if tokens and tokens[0] in _FORMER:
        raise UsageError(f"{tokens[0]}: expected turtlelog {_FORMER[tokens[0]]}, found an old name")
    with _stop_on_request():
        try:
            code = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
        finally:
            end_progress()
        with outlive_reader():
            sys.stdout.flush()
    return code


@contextmanager
def _stop_on_request() -> Iterator[None]:
    """Let a request to end, or a terminal that closes, act as Ctrl-C: nothing half done is left."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    numbers = [getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")]
    is_main = threading.current_thread() is threading.main_thread()
    # What somebody has set already stays, as nohup's wish to ignore the terminal's end.
    known = [number for number in numbers if number and signal.getsignal(number) == signal.SIG_DFL]
    for number in known if is_main else ():
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in known if is_main else ():
            signal.signal(number, signal.SIG_DFL)


def _prepare_streams() -> None:
    """Make both streams take any text, also where they are closed or know ASCII only."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _describe_os_error(err: OSError) -> str:
    if err.filename is not None:
        return f"{err.filename}: expected a file that can be used, found: {err.strerror}"
    drop_stdout()
    return f"standard output: expected room to write, found: {err}"


def _fail(text: str, code: int) -> int:
    print_error(text)
    return code
