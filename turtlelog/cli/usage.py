"""Layout of help, and errors of command lines."""

import os
import re
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence, Set as Collection
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar, get_args, get_origin

from cyclopts import CycloptsError, Parameter, Token
from cyclopts.exceptions import (
    CoercionError,
    ConsumeMultipleError,
    MissingArgumentError,
    RepeatArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from turtlelog.errors import LogError, UsageError, find_near, join_names, quote_name

if TYPE_CHECKING:
    from cyclopts.argument import Argument
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions


Parsed = TypeVar("Parsed")

_WIDEST: Final = 100
"""Longest line of help [characters]; longer lines are hard to read."""


class HelpFormatter:
    """Cyclopts' panels for texts with the line breaks of source code.

    Summaries describe commands that are not loaded. The code that draws panels is loaded only for
    help.
    """

    shows_all: bool = False
    """Whether to show every option and paragraph, as for --help-all, or only the usual ones."""

    def __init__(self, summaries: Mapping[str, str], usual: Mapping[str, Collection[str]]) -> None:
        """Store the summaries of commands, one sentence each, and their usual options."""
        self._summaries, self._usual = summaries, usual
        self._command = ""

    def __call__(self, console: "Console", options: "ConsoleOptions", panel: "HelpPanel") -> None:
        """Print a panel."""
        from cyclopts.help import DefaultFormatter

        console.width = min(console.width, _WIDEST)
        entries = [*filter(self._is_shown, panel.entries)]
        described = panel.copy(entries=[*map(self._describe, entries)])
        if entries:
            DefaultFormatter()(console, options, described)

    def _is_shown(self, entry: "HelpEntry") -> bool:
        """Return whether help shows an option: a usual option, or any option with --help-all."""
        usual = self._usual.get(self._command)
        if self.shows_all or usual is None or entry.positional_label or entry.required:
            return True
        return not usual.isdisjoint(entry.positive_names)

    def render_usage(self, console: "Console", options: "ConsoleOptions", usage: Any) -> None:
        """Print the usage line of a command."""
        from cyclopts.help import DefaultFormatter

        words = (usage if isinstance(usage, str) else _find_text(usage)).split()
        # The word after `Usage: turtlelog`.
        self._command = next((word for word in words[2:3] if word in self._usual), "")
        DefaultFormatter().render_usage(console, options, usage)

    def _describe(self, entry: "HelpEntry") -> "HelpEntry":
        from cyclopts.help import InlineText

        text = " ".join(_find_text(entry.description).split())
        if not text and entry.positive_names:
            text = self._summaries.get(entry.positive_names[0], "")
        label = entry.positional_label
        if label and get_origin(entry.type) is list:
            label = f"{label}..."
        description = InlineText.from_format(text, "plaintext")
        return entry.copy(description=description, positional_label=label)

    def _choose(self, paragraphs: list[str]) -> list[str]:
        """Return the paragraphs to show: the purpose of a command, and an example."""
        if self.shows_all or self._command not in self._usual:
            return paragraphs
        examples = [text for text in paragraphs if text.startswith("Example: ")]
        more = f"All options and examples: turtlelog {self._command} --help-all"
        return [*paragraphs[:1], *examples[:2], more]

    def render_description(
        self,
        console: "Console",
        options: "ConsoleOptions",  # noqa: ARG002
        description: Any,
    ) -> None:
        """Print the purpose of a command, then its examples."""
        width = min(console.width, _WIDEST)
        found = [" ".join(text.split()) for text in _find_text(description).split("\n\n")]
        text = "\n\n".join(
            textwrap.fill(paragraph, width, break_long_words=False, break_on_hyphens=False)
            for paragraph in self._choose([*filter(None, found)])
        )
        console.print(f"{text}\n", highlight=False, markup=False, soft_wrap=True)


def show_default(value: object) -> str | None:
    """Return the text of a default in help; None for an option that is off by default."""
    return None if value is False or value is None else str(value)


def parse_option(option: str, text: str, parse: Callable[[str], Parsed], expected: str) -> Parsed:
    """Return the value of an option, or refuse a text that is not as expected."""
    try:
        return parse(text)
    except (ValueError, LogError) as err:
        raise UsageError(f"{option} {text[:60]}: must be {expected}") from err


def read_whole(_: Any, tokens: Sequence[Token]) -> int:
    """Return a whole number; a plain int would truncate 1.5 to 1."""
    option = tokens[0].keyword or ""
    unit = " of ticks" if option == "--dead-time" else ""
    return parse_option(option, tokens[0].value, int, f"a whole number{unit}")


Whole = Annotated[int, Parameter(converter=read_whole)]


def _find_text(description: Any) -> str:
    return getattr(getattr(description, "primary_renderable", description), "plain", "")


_WORDS: Final[dict[Any, str]] = {float: "a number", int: "a whole number"}

_SHORT: Final = 40
"""Longest value that an error line repeats [letters]."""

_OPTIONS: Final = MappingProxyType(
    {
        "--metrics": "--metric", "--only": "--metric", "--figures": "--only", "--figure": "--only",
        "--columns": "--metric", "--mechanisms": "--causes", "--effects": "--causes",
        "--vary": "--grid", "--out": "--output", "--recover": "--partial",
        "--delay": "--dead-time-s", "--signals": "--details", "--verbose": "--details",
        "--format": "--json", "--force": "--yes", "--gain": "--kp", "--minimize": "--minimise",
        "--maximize": "--maximise", "--constraint": "--subject-to", "--filter": "--where",
    }
)  # fmt: skip
"""Options of other commands and programs, with their names here."""


def describe_usage_error(err: CycloptsError) -> str:
    """Return an error of the command line's parser as one line, with what to type."""
    for kind, describe in _DESCRIPTIONS.items():
        if isinstance(err, kind):
            return describe(err)
    err.verbose = False
    # Cyclopts writes errors in several lines.
    text = " ".join(str(err).split())
    return f"{_name_command(err)}: {text}"


def find_split_pair(tokens: Sequence[str]) -> str | None:
    """Return the error for a goal in two words, as in `--goal 8 3`; None without such a goal."""
    found = re.search(r"(?:^|\n)--goal\n([-+.\de]+)\n([-+.\de]+)(?:\n|$)", "\n".join(tokens))
    if found is None:
        return None
    return f"--goal {found[1]} {found[2]}: did you mean --goal {found[1]},{found[2]}?"


def _name_command(err: CycloptsError) -> str:
    return " ".join(("turtlelog", *(err.command_chain or ())))


def _describe_unknown_command(err: Any) -> str:
    known = [name for name, app in err.app.resolved_commands().items() if app.show]
    known = [name for name in known if not name.startswith("-")]
    word = err.unused_tokens[0]
    near = find_near(word, known)
    text = f"turtlelog has no command {quote_name(word)}"
    text += f"; did you mean {join_names(near)}?" if near else ";"
    return f"{text} {'All' if near else 'all'} commands: turtlelog --help"


def _describe_unknown_option(err: Any) -> str:
    word = (err.token.keyword or err.token.value).split("=")[0]
    known = [name for found in err.argument_collection if found.parse for name in found.names]
    options = [name for name in known if name.startswith("--")]
    command = _name_command(err)
    text = f"{command} has no option {word}"
    near = _suggest_key(word, options, err.root_input_tokens or ())
    near = near or [one for one in options if one in {f"{word}s", word.removesuffix("s")}]
    near = near or [one for one in options if one == _OPTIONS.get(word)]
    near = near or find_near(word, options)
    if not options:
        return f"{text}; all commands: turtlelog --help"
    if near:
        return f"{text}; did you mean {join_names(near)}? All options: {command} --help-all"
    return f"{text}; all options: {command} --help-all"


_UNITS: Final = re.compile(r"^max_|(_m|_rad|_s|_s2|_ticks)+$")
"""Suffixes of scenario keys that users may omit: `--duration` means max_duration_s."""


def _suggest_key(word: str, options: Sequence[str], tokens: Sequence[str]) -> list[str]:
    """Return how to set a scenario key that was typed as an option, as in `--kp-linear 2`."""
    if "--set" not in options:
        return []
    from turtlelog.scenario import Scenario, flatten_scenario  # needed only for mistakes

    name = word.removeprefix("--").replace("-", "_")
    known = [*flatten_scenario(Scenario())]
    keys = [key for key in known if (key.partition(".")[2] or key) == name]
    keys = keys or [
        key for key in known if _UNITS.sub("", key.rpartition(".")[2]) == _UNITS.sub("", name)
    ]
    joined = "\n".join(tokens)
    value = re.search(rf"^{re.escape(word)}[=\n]([^\n]+)", joined, re.MULTILINE)
    return [f"--set {key}={'VALUE' if value is None else value[1]}" for key in keys]


def _describe_unused(err: Any) -> str:
    words = err.unused_tokens
    more = f" and {len(words) - 1} more" if len(words) > 1 else ""
    usage = _show_usage(err)
    if "FILE..." in usage:
        apart = "stand apart" if more else "stands apart"
        which = f"{quote_name(words[0])}{more} {apart}"
        apart = "name all files together, and join the values of an option by commas"
        return f"{_name_command(err)}: {which}: {apart}"
    return f"{_name_command(err)} takes no word {quote_name(words[0])}{more}. {usage}"


def _show_usage(err: Any) -> str:
    app = err.app
    for name in err.command_chain or ():
        if name in {command for command in app if not command.startswith("-")}:
            app = app[name]
    return str(app.usage or f"Usage: {_name_command(err)}")


def _describe_missing(err: Any) -> str:
    argument = err.argument
    if err.keyword:
        return f"{_name_command(err)}: {err.keyword} needs {_describe_value(argument)}"
    name = argument.name if argument.index is None else _name_place(argument)
    choices = f": {_describe_value(argument)}" if argument.get_choices(force=True) else ""
    return f"{_name_command(err)} needs {name}{choices}. {_show_usage(err)}"


def _describe_count(err: Any) -> str:
    place, most = err.keyword or _name_place(err.argument), err.max_allowed
    return f"{place}: takes at most {most} words, not {err.actual_count}"


def _describe_value_error(err: Any) -> str:
    place = err.token.keyword if err.token and err.token.keyword else _name_place(err.argument)
    value = err.token.value if err.token else ""
    choices = err.argument.get_choices(force=True)
    expected = _describe_value(err.argument)
    near = find_near(value, choices) if choices else []
    hint = f"; did you mean {join_names(near)}?" if near else ""
    if err.argument.hint is bool or bool in get_args(err.argument.hint):
        return f"{place}: takes no value, not {quote_name(value)}"
    shown = value if value.isprintable() and 0 < len(value) <= _SHORT else quote_name(value)
    return f"{place} {shown}: must be {expected}{hint}"


def _describe_repeated(err: Any) -> str:
    word = err.token.keyword
    counts = Counter(token.split("=")[0] for token in err.root_input_tokens or ())
    times = max(counts[word], 2)
    return f"{_name_command(err)}: {word} is given {times} times, but takes one value"


def _name_place(argument: "Argument") -> str:
    name = argument.name
    return name if name.startswith("-") else name.upper()


def _describe_value(argument: "Argument") -> str:
    """Return the expected value of an argument: its choices, its metavar, or its type."""
    choices = argument.get_choices(force=True)
    if choices:
        return join_names(choices)
    hint = argument.hint
    kinds = [kind for kind in get_args(hint) if kind is not type(None)] or [hint]
    return (
        _WORDS.get(kinds[0])
        or argument.parameter.metavar
        or ("a path" if kinds[0] is Path else "a text")
    )


_DESCRIPTIONS: Final = {
    UnknownCommandError: _describe_unknown_command,
    UnknownOptionError: _describe_unknown_option,
    UnusedCliTokensError: _describe_unused,
    ConsumeMultipleError: _describe_count,
    MissingArgumentError: _describe_missing,
    CoercionError: _describe_value_error,
    RepeatArgumentError: _describe_repeated,
}
"""Functions that describe errors by class; subclasses come before their bases."""


def find_command_name() -> str:
    """Return the command name by which a user can call turtlelog again."""
    if "UV_RUN_RECURSION_DEPTH" in os.environ:
        return "uv run turtlelog"
    from shutil import which

    if which("turtlelog"):
        return "turtlelog"
    python = Path(sys.executable)
    if python.is_relative_to(Path.cwd()):
        python = python.relative_to(Path.cwd())
    return f"{python} -m turtlelog"
