"""Text -> tokens, and errors that say where in a text something is wrong."""

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
        kind: Keywords are operators.
        text: As written, `implies` for `->`; of a text without its quotes.
        column: Counted from 1.
    """

    kind: TokenKind
    text: str
    column: int

    def __str__(self) -> str:
        return "the end" if self.kind == "end" else quote_text(self.text)


def split_tokens(text: str, *, source: str) -> list[Token]:
    """Return the tokens of a text, the last of kind `end`.

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
    """Return a character in quotes, beyond ASCII with its number: look-alikes are common."""
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
    """Return an error with the place in front, ready to raise."""
    return ExpressionError(f"{source}: {_describe_place(text, column)}: {problem}", column=column)


def quote_text(text: str) -> str:
    """Return a text in quotes, its control characters escaped, cut where it is long."""
    return repr(text if len(text) <= _LONGEST_QUOTE else f"{text[:_LONGEST_QUOTE]}...")


def draw_caret(text: str, column: int) -> str:
    """Return the line of a text in which a column stands, with a caret below it.

    Long lines are cut around the column. Control characters are shown as spaces.

    Args:
        text: An expression.
        column: Counted from 1 over the whole text, as in `ExpressionError.column`.
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
