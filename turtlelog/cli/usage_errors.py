"""What is wrong with the words of a command, said as every error: expected this, found that."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args, get_origin

from cyclopts import CycloptsError
from cyclopts.exceptions import (
    CoercionError,
    ConsumeMultipleError,
    MissingArgumentError,
    RepeatArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from turtlelog.errors import suggest_names

if TYPE_CHECKING:
    from cyclopts.argument import Argument

_WORDS: Final[dict[Any, str]] = {
    float: "a number",
    int: "a whole number",
    bool: "no value",
}
_LONGEST: Final = 60
"""Letters of a word that an error line repeats."""


def describe_usage_error(err: CycloptsError) -> str:
    """Return an error of the command line's parser as one line, with what was expected and found.

    Args:
        err: What cyclopts raised.
    """
    for kind, describe in _DESCRIPTIONS.items():
        if isinstance(err, kind):
            return describe(err)
    err.verbose = False
    # Cyclopts writes in several lines.
    text = " ".join(str(err).split())
    return f"{_name_command(err)}: expected words as --help shows them, found: {text}"


def _name_command(err: CycloptsError) -> str:
    return " ".join(("turtlelog", *(err.command_chain or ())))


def _show(word: object) -> str:
    text = str(word)
    return repr(text if len(text) <= _LONGEST else f"{text[:_LONGEST]}...")


def _describe_unknown_command(err: Any) -> str:
    known = [name for name, app in err.app.resolved_commands().items() if app.show]
    known = [name for name in known if not name.startswith("-")]
    word = err.unused_tokens[0]
    return f"turtlelog: expected a command ({suggest_names(word, known)}), found {_show(word)}"


def _describe_unknown_option(err: Any) -> str:
    word = err.token.keyword or err.token.value
    known = [name for found in err.argument_collection if found.parse for name in found.names]
    options = [name for name in known if name.startswith("--")]
    expected = f"an option ({suggest_names(word, options)})" if options else "a command"
    return f"{_name_command(err)}: expected {expected}, found {_show(word)}"


def _describe_unused(err: Any) -> str:
    words = err.unused_tokens
    more = f" and {len(words) - 1} more" if len(words) > 1 else ""
    return f"{_name_command(err)}: expected no further word, found {_show(words[0])}{more}"


def _describe_missing(err: Any) -> str:
    argument = err.argument
    place = "" if argument.index is not None else f"{err.keyword or argument.name}: "
    return f"{_name_command(err)}: {place}expected {_describe_value(argument)}, found none"


def _describe_count(err: Any) -> str:
    place, most = err.keyword or _name_place(err.argument), err.max_allowed
    found = f"found {err.actual_count}"
    return f"{_name_command(err)}: {place}: expected at most {most} words, {found}"


def _describe_value_error(err: Any) -> str:
    place = err.token.keyword if err.token and err.token.keyword else _name_place(err.argument)
    expected = _describe_value(err.argument)
    return f"{place}: expected {expected}, found {_show(err.token.value if err.token else 'none')}"


def _describe_repeated(err: Any) -> str:
    word = err.token.keyword
    counts = Counter(token.split("=")[0] for token in err.root_input_tokens or ())
    times = max(counts[word], 2)
    return f"{_name_command(err)}: {word}: expected it once, found it {times} times"


_DESCRIPTIONS: Final = {
    UnknownCommandError: _describe_unknown_command,
    UnknownOptionError: _describe_unknown_option,
    UnusedCliTokensError: _describe_unused,
    ConsumeMultipleError: _describe_count,
    MissingArgumentError: _describe_missing,
    CoercionError: _describe_value_error,
    RepeatArgumentError: _describe_repeated,
}
"""By the kind of error; a kind stands before those that it is one of."""


def _name_place(argument: "Argument") -> str:
    name = argument.name
    return name if name.startswith("-") else name.upper()


def _describe_value(argument: "Argument") -> str:
    """Return what a place takes: its choices, its metavar, or a word for its type."""
    choices = argument.get_choices(force=True)
    if choices:
        return suggest_names("", choices, most=len(choices))
    hint = argument.hint
    kinds = [kind for kind in get_args(hint) if kind is not type(None)] or [hint]
    is_list = get_origin(hint) is list
    if argument.index is not None:
        return f"at least one {_name_place(argument)}" if is_list else _name_place(argument)
    return (
        _WORDS.get(kinds[0])
        or argument.parameter.metavar
        or ("a path" if kinds[0] is Path else "a text")
    )
