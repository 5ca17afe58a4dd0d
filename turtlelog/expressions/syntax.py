"""Tokens and trees of expressions, and errors that show the place of a mistake in a text."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, Literal, cast

from turtlelog.errors import ExpressionError
from turtlelog.escapes import escape_controls

LONGEST_TEXT: Final = 20_000  # characters

KEYWORDS: Final = frozenset(
    {"and", "or", "not", "implies", "until", "always", "eventually", "true", "false", "inf"}
)

FUNCTIONS: Final[Mapping[str, tuple[int, float, str]]] = MappingProxyType(
    {
        "abs": (1, 1, "abs"),
        "min": (2, math.inf, "minimum"),
        "max": (2, math.inf, "maximum"),
        "sqrt": (1, 1, "sqrt"),
        "sin": (1, 1, "sin"),
        "cos": (1, 1, "cos"),
        "atan2": (2, 2, "arctan2"),
        "hypot": (2, 2, "hypot"),
        "deg": (1, 1, "degrees"),
        "rad": (1, 1, "radians"),
        "log": (1, 1, "log"),
    }
)
"""Smallest and largest number of arguments of each function, and its name in numpy. Angles are in
rad; `log` is the natural logarithm."""

TokenKind = Literal["number", "text", "name", "operator", "end"]

_WIDTH: Final = 78  # characters of a line that is shown
_LONGEST_QUOTE: Final = 40

_TOKEN: Final = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)*)"
    r"""|(?P<text>'[^'\n]*'|"[^"\n]*")"""
    r"|(?P<space>[ \t\r\n]+)"
    r"|(?P<operator>->|\*\*|<=|>=|==|!=|[-+*/<>()\[\],])"
)


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
    """Return the tokens of a text; the last token has the kind `end`."""
    if len(text) > LONGEST_TEXT:
        problem = f"expected at most {LONGEST_TEXT:,} characters, found {len(text):,}"
        raise build_error(source, "", 1, problem)
    position, tokens = 0, []
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            problem = _describe_character(text[position])
            raise build_error(source, text, position + 1, problem)
        found, kind = match.group(), cast("TokenKind", match.lastgroup)
        if found == "->" or found in KEYWORDS:
            kind, found = "operator", found.replace("->", "implies")
        if match.lastgroup != "space":
            word = found[1:-1] if kind == "text" else found
            tokens.append(Token(kind=kind, text=word, column=position + 1))
        position = match.end()
    return [*tokens, Token(kind="end", text="", column=len(text.rstrip(" \t\r\n")) + 1)]


def _describe_character(character: str) -> str:
    if character in "'\"":
        return f"expected a closing {character}, found the end of the line"
    hints = {"=": "equality is ==", "^": "powers are **"}
    hints |= {"!": "write not", "&": "write and", "|": "write or"}
    hint = f"; {hints[character]}" if character in hints else ""
    code = "" if character.isascii() else f" (U+{ord(character):04X})"
    return f"expected a number, name or operator, found {character!r}{code}{hint}"


def build_error(source: str, text: str, column: int, problem: str) -> ExpressionError:
    """Return an error, to be raised, whose message begins with the place."""
    before, place = text[: column - 1], f"column {column}"
    if "\n" in text.strip():
        line, last = before.count("\n") + 1, before.rpartition("\n")[2]
        place = f"line {line}, column {len(last) + 1}"
    return ExpressionError(f"{source}: {place}: {problem}", column=column)


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


# The tree of a parsed expression: frozen nodes with their columns in the text.

ArithmeticOperator = Literal["+", "-", "*", "/", "**"]
ComparisonOperator = Literal["<", "<=", ">", ">=", "==", "!="]
LogicOperator = Literal["and", "or", "implies"]
TemporalOperator = Literal["always", "eventually"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """Part of an expression.

    Attributes:
        column: Column of the node or its operator, counted from 1; excluded from comparisons.
    """

    column: int = field(default=1, compare=False)

    def list_children(self) -> tuple["Node", ...]:
        """Return the parts of this part, in order of the text."""
        match self:
            case Call(arguments=parts) | Comparison(operands=parts) | Logic(operands=parts):
                return parts
            case Prefix(operand=part) | Temporal(operand=part):
                return (part,)
            case Arithmetic(left=left, right=right) | Until(left=left, right=right):
                return left, right
        return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Number(Node):
    """A number as written, not negative; may be `inf`."""

    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Text(Node):
    """A text in quotes."""

    value: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth(Node):
    """`true` or `false`."""

    value: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Name(Node):
    """A signal, metric or parameter by its dotted name."""

    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Call(Node):
    """A function of numbers."""

    function: str
    arguments: tuple[Node, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Prefix(Node):
    """`-` before a number, or `not` before a truth."""

    operator: Literal["-", "not"]
    operand: Node


@dataclass(frozen=True, slots=True, kw_only=True)
class Arithmetic(Node):
    """Two numbers and an operator; `column` is the column of the operator."""

    operator: ArithmeticOperator
    left: Node
    right: Node


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison(Node):
    """A chain as in mathematics: `a < b <= c` is `a < b and b <= c`.

    Attributes:
        operators: Operators, at least one.
        operands: Operands, one more than operators.
        columns: Columns of the operators; excluded from comparisons.
    """

    operators: tuple[ComparisonOperator, ...]
    operands: tuple[Node, ...]
    columns: tuple[int, ...] = field(default=(), compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Logic(Node):
    """Truth values joined by one operator: two or more by `and` or `or`, two by `implies`."""

    operator: LogicOperator
    operands: tuple[Node, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Temporal(Node):
    """A truth value at all times, or at some time, of a window after each instant.

    Attributes:
        operator: `always` or `eventually`.
        start_s: Start of the window after the instant [s], finite, not negative.
        end_s: End of the window after the instant [s]; may be inf.
        operand: Formula to evaluate.
    """

    operator: TemporalOperator
    start_s: float = 0.0
    end_s: float = math.inf
    operand: Node


@dataclass(frozen=True, slots=True, kw_only=True)
class Until(Node):
    """`right` becomes true within the window, and `left` is true until that instant."""

    start_s: float = 0.0
    end_s: float = math.inf
    left: Node
    right: Node


@dataclass(frozen=True, slots=True, kw_only=True)
class Expression:
    """A parsed expression.

    Attributes:
        text: Text of the expression.
        source: Origin of the text for messages: an option, or a file and key.
        root: Root node of the tree.
        names: Signals, metrics and parameters in order of first use.
    """

    text: str
    source: str
    root: Node
    names: tuple[str, ...] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        # Once: each check asks for its names ten times.
        found = (node.name for node in iterate_nodes(self.root) if isinstance(node, Name))
        object.__setattr__(self, "names", tuple(dict.fromkeys(found)))

    @property
    def is_temporal(self) -> bool:
        """Whether the expression contains `always`, `eventually` or `until` and needs signals."""
        return any(isinstance(node, Temporal | Until) for node in iterate_nodes(self.root))

    def __repr__(self) -> str:
        return f"<Expression {escape_controls(self.text)}>"


def iterate_nodes(node: Node) -> Iterator[Node]:
    """Yield a node and all nodes below it, in order of the text."""
    left = [node]
    while left:
        node = left.pop()
        yield node
        left.extend(reversed(node.list_children()))
