"""Splitting of text into tokens, and errors that show the place of a mistake in a text."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

from turtlelog.errors import ExpressionError

LONGEST_TEXT: Final = 20_000  # characters

KEYWORDS: Final = frozenset(
    {"and", "or", "not", "implies", "until", "always", "eventually", "true", "false", "inf"}
)

TokenKind = Literal["number", "text", "name", "operator", "end"]

_WIDTH: Final = 78  # characters of a line that is shown
_LONGEST_QUOTE: Final = 40

_TOKEN: Final = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)*)"
    r"""|(?P<text>'[^'\n]*'|"[^"\n]*")"""
    r"|(?P<operator>->|\*\*|<=|>=|==|!=|[-+*/<>()\[\],])"
)
_SPACE: Final = re.compile(r"[ \t\r\n]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Token:
    """One word of an expression.

    Attributes:
        kind: Kind of the token; keywords are operators.
        text: Token as written; `implies` for `->`; texts without their quotes.
        column: Column, counted from 1.
    """

    kind: TokenKind
    text: str
    column: int

    def __str__(self) -> str:
        return "the end" if self.kind == "end" else quote_text(self.text)


def split_tokens(text: str, *, source: str) -> list[Token]:
    """Return the tokens of a text; the last token has the kind `end`.

    Raises:
        ExpressionError: If a character has no meaning.
    """
    if len(text) > LONGEST_TEXT:
        problem = f"expected at most {LONGEST_TEXT:,} characters, found {len(text):,}"
        raise build_error(source, "", 1, problem)
    return list(_iterate_tokens(text, source))


def _iterate_tokens(text: str, source: str) -> Iterator[Token]:
    position = _skip_space(text, 0)
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            problem = _describe_character(text[position])
            raise build_error(source, text, position + 1, problem)
        yield _make_token(match)
        position = _skip_space(text, match.end())
    yield Token(kind="end", text="", column=len(text.rstrip(" \t\r\n")) + 1)


def _make_token(match: re.Match[str]) -> Token:
    found, column = match.group(), match.start() + 1
    if match.lastgroup == "number":
        return Token(kind="number", text=found, column=column)
    if match.lastgroup == "text":
        return Token(kind="text", text=found[1:-1], column=column)
    if match.lastgroup == "name" and found not in KEYWORDS:
        return Token(kind="name", text=found, column=column)
    return Token(kind="operator", text="implies" if found == "->" else found, column=column)


def _skip_space(text: str, position: int) -> int:
    match = _SPACE.match(text, position)
    return match.end() if match else position


def _name_character(character: str) -> str:
    """Return a character in quotes; non-ASCII characters with their code point."""
    return repr(character) + ("" if character.isascii() else f" (U+{ord(character):04X})")


def _describe_character(character: str) -> str:
    if character in "'\"":
        return f"expected a closing {character}, found the end of the line"
    hints = {
        "=": "; equality is ==",
        "^": "; powers are **",
        "!": "; write not",
        "&": "; write and",
    }
    hints["|"] = "; write or"
    hint = hints.get(character, "")
    return f"expected a number, name or operator, found {_name_character(character)}{hint}"


def build_error(source: str, text: str, column: int, problem: str) -> ExpressionError:
    """Return an error, to be raised, whose message begins with the place."""
    return ExpressionError(f"{source}: {_describe_place(text, column)}: {problem}", column=column)


def quote_text(text: str) -> str:
    """Return a text in quotes, control characters escaped, long texts shortened."""
    return repr(text if len(text) <= _LONGEST_QUOTE else f"{text[:_LONGEST_QUOTE]}...")


def draw_caret(text: str, column: int) -> str:
    """Return the line of a text that contains a column, with a caret below the column.

    Long lines are cut around the column. Control characters are shown as spaces.

    Args:
        text: Text of an expression.
        column: Column, counted from 1 over the whole text, as in `ExpressionError.column`.
    """
    before, after = text[: column - 1], text[column - 1 :]
    head = before.rpartition("\n")[2]
    line = head + after.partition("\n")[0]
    start = max(0, min(len(head) - _WIDTH // 2, len(line) - _WIDTH))
    shown = line[start : start + _WIDTH]
    printable = "".join(character if character.isprintable() else " " for character in shown)
    return f"{printable}\n{' ' * (len(head) - start)}^"


def _describe_place(text: str, column: int) -> str:
    before = text[: column - 1]
    if "\n" not in text.strip():
        return f"column {column}"
    return f"line {before.count(chr(10)) + 1}, column {len(before.rpartition(chr(10))[2]) + 1}"
