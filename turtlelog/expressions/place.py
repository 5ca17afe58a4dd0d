"""Errors that say where in an expression something is wrong."""

from turtlelog.errors import ExpressionError

_WIDTH = 78
_LONGEST_QUOTE = 40


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
