"""Text -> tokens."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

from turtlelog.expressions.place import build_error, quote_text

LONGEST_TEXT: Final = 20_000  # characters

KEYWORDS: Final = frozenset(
    {"and", "or", "not", "implies", "until", "always", "eventually", "true", "false", "inf"}
)

TokenKind = Literal["number", "text", "name", "operator", "end"]

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
        ExpressionError: Where a character has no meaning.
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
