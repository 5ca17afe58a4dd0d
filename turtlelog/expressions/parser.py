"""Parsing of expressions into trees, by precedence climbing. No text is run as Python."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NoReturn, cast

from turtlelog.display import describe_count
from turtlelog.errors import ExpressionError, suggest_names
from turtlelog.escapes import escape_controls

LONGEST_TEXT: Final = 20_000  # characters

KEYWORDS: Final = frozenset(
    {"and", "or", "not", "implies", "until", "always", "eventually", "true", "false", "inf"}
)

FUNCTIONS: Final[Mapping[str, tuple[int, float, str]]] = {
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
    "log": (1, 1, "log"),  # natural
}
"""Fewest and most arguments of each function, and its name in numpy; angles are in rad."""

_DEEPEST: Final = 100  # levels of nesting, so that no caller meets Python's recursion limit

PRECEDENCE: Final = {
    "implies": 1,
    "or": 2,
    "and": 3,
    "until": 4,
    "not": 5,
    **dict.fromkeys(("<", "<=", ">", ">=", "==", "!="), 6),
    **dict.fromkeys("+-", 7),
    **dict.fromkeys("*/", 8),
    "unary -": 9,
    "**": 10,
}
"""Precedence of operators; a higher number binds tighter. `unary -` is the minus of -x."""

_INFIX: Final = frozenset(PRECEDENCE) - {"not", "unary -"}
_TEMPORAL: Final = ("always", "eventually")


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """Part of an expression, with its column or that of its operator, counted from 1."""

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

    operator: Literal["+", "-", "*", "/", "**"]
    left: Node
    right: Node


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison(Node):
    """A chain as in mathematics: `a < b <= c` is `a < b and b <= c`; `columns` of its operators."""

    operators: tuple[Literal["<", "<=", ">", ">=", "==", "!="], ...]
    operands: tuple[Node, ...]
    columns: tuple[int, ...] = field(default=(), compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Logic(Node):
    """Truth values joined by one operator: two or more by `and` or `or`, two by `implies`."""

    operator: Literal["and", "or", "implies"]
    operands: tuple[Node, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Temporal(Node):
    """A truth value at all times, or at some time, of a window after each instant [s]."""

    operator: Literal["always", "eventually"]
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


def parse_expression(text: str, *, source: str = "expression") -> Expression:
    """Return the tree of an expression.

    Args:
        text: Expression in the language of docs/expressions.md.
        source: Origin of the text for messages: an option, or a file and key.

    Raises:
        ExpressionError: If the text cannot be parsed; the message gives the column.
    """
    return Expression(text=text, source=source, root=_Parser(text, source).parse())


_LONGEST_QUOTE: Final = 40  # characters of a token in a message

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

    kind: Literal["number", "text", "name", "operator", "end"]
    text: str
    column: int

    def __str__(self) -> str:
        cut = f"{self.text[:_LONGEST_QUOTE]}{'...' if len(self.text) > _LONGEST_QUOTE else ''}"
        return "the end" if self.kind == "end" else repr(cut)


def split_tokens(text: str, *, source: str) -> list[Token]:
    """Return the tokens of a text; the last token has the kind `end`."""
    if len(text) > LONGEST_TEXT:
        problem = f"expected at most {LONGEST_TEXT:,} characters, found {len(text):,}"
        raise build_error(source, "", 1, problem)
    position, tokens = 0, []
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise build_error(source, text, position + 1, _describe_character(text[position]))
        found, kind = match.group(), cast("Any", match.lastgroup)
        if found == "->" or found in KEYWORDS:
            kind, found = "operator", found.replace("->", "implies")
        if match.lastgroup != "space":
            found = found[1:-1] if kind == "text" else found
            tokens.append(Token(kind=kind, text=found, column=position + 1))
        position = match.end()
    return [*tokens, Token(kind="end", text="", column=len(text.rstrip(" \t\r\n")) + 1)]


def _describe_character(character: str) -> str:
    if character in "'\"":
        return f"expected a closing {character}, found the end of the line"
    hints = {"=": "; equality is ==", "^": "; powers are **"}
    hints |= {"!": "; write not", "&": "; write and", "|": "; write or"}
    code = "" if character.isascii() else f" (U+{ord(character):04X})"
    return (
        f"expected a number, name or operator, found {character!r}{code}{hints.get(character, '')}"
    )


def build_error(source: str, text: str, column: int, problem: str) -> ExpressionError:
    """Return an error, to be raised, whose message begins with the place."""
    before, place = text[: column - 1], f"column {column}"
    if "\n" in text.strip():
        line, last = before.count("\n") + 1, before.rpartition("\n")[2]
        place = f"line {line}, column {len(last) + 1}"
    return ExpressionError(f"{source}: {place}: {problem}", column=column)


class _Parser:
    def __init__(self, text: str, source: str) -> None:
        self._text, self._source = text, source
        self._tokens = split_tokens(text, source=source)
        self._place = self._open = 0
        self._heights: dict[int, int] = {}

    def parse(self) -> Node:
        root = self._parse_level(1)
        if self._next.kind != "end":
            self._fail(self._next, "expected an operator or the end")
        return root

    @property
    def _next(self) -> Token:
        return self._tokens[self._place]

    def _take(self) -> Token:
        token = self._next
        self._place += token.kind != "end"
        return token

    def _takes(self, operator: str) -> bool:
        """Consume the next token if it is this operator."""
        found = self._next.kind == "operator" and self._next.text == operator
        self._place += found
        return found

    def _expect(self, operator: str) -> None:
        if not self._takes(operator):
            self._fail(self._next, f"expected {operator!r}")

    def _fail(self, token: Token, expected: str) -> NoReturn:
        raise build_error(self._source, self._text, token.column, f"{expected}, found {token}")

    def _parse_level(self, loosest: int) -> Node:
        """Parse operands and the operators between them that have at least this precedence."""
        self._open += 1
        self._check_depth(self._open, self._next.column)
        node = self._grow(self._parse_prefix())
        while (binding := self._find_binding()) >= loosest:
            node = self._grow(self._parse_infix(node, self._take(), binding))
        self._open -= 1
        return node

    def _find_binding(self) -> int:
        token = self._next
        return PRECEDENCE[token.text] if token.kind == "operator" and token.text in _INFIX else 0

    def _parse_infix(self, left: Node, token: Token, binding: int) -> Node:
        operator = cast("Any", token.text)
        if operator in {"and", "or"} or binding == PRECEDENCE["<"]:
            return self._parse_chain(left, token, binding)
        window = self._parse_window() if operator == "until" else {}
        # `implies` and `until` are right-associative; an exponent may be negative: 10**-3.
        loosest = {"**": PRECEDENCE["unary -"], "implies": binding, "until": binding}
        right = self._parse_level(loosest.get(operator, binding + 1))
        if operator == "until":
            return Until(left=left, right=right, column=token.column, **window)
        if operator == "implies":
            return Logic(operator=operator, operands=(left, right), column=token.column)
        return Arithmetic(operator=operator, left=left, right=right, column=token.column)

    def _parse_chain(self, left: Node, first: Token, binding: int) -> Node:
        """Parse comparisons, or truth values that one operator joins, into one node."""
        tokens, operands = [first], [left, self._parse_level(binding + 1)]
        while self._find_binding() == binding:
            tokens.append(self._take())
            operands.append(self._parse_level(binding + 1))
        operators = tuple(cast("Any", token.text) for token in tokens)
        parts: dict[str, Any] = {"operands": tuple(operands), "column": first.column}
        if first.text in {"and", "or"}:
            return Logic(operator=operators[0], **parts)
        return Comparison(operators=operators, columns=tuple(one.column for one in tokens), **parts)

    def _parse_prefix(self) -> Node:
        token = self._take()
        if token.kind == "operator":
            return self._parse_operator(token)
        if token.kind == "number":
            return self._make_number(token)
        if token.kind == "text":
            return Text(value=token.text, column=token.column)
        if token.kind == "end":
            self._fail(token, "expected a number or name")
        if self._takes("("):
            return self._parse_call(token)
        return Name(name=token.text, column=token.column)

    def _parse_operator(self, token: Token) -> Node:
        if token.text == "(":
            inside = self._parse_level(1)
            self._expect(")")
            return inside
        if token.text in {"-", "not"}:
            binding = PRECEDENCE["not" if token.text == "not" else "unary -"]
            operator, operand = cast("Any", token.text), self._parse_level(binding)
            return Prefix(operator=operator, operand=operand, column=token.column)
        if token.text in _TEMPORAL:
            window = self._parse_window()
            self._expect("(")
            operator, operand = cast("Any", token.text), self._parse_level(1)
            self._expect(")")
            return Temporal(operator=operator, operand=operand, column=token.column, **window)
        if token.text in {"true", "false"}:
            return Truth(value=token.text == "true", column=token.column)
        if token.text == "inf":
            return Number(value=math.inf, column=token.column)
        return self._fail(token, "expected a number or name")

    def _parse_window(self) -> dict[str, Any]:
        """Parse the bounds of a window `[a, b]` in seconds; without one, return none."""
        if not self._takes("["):
            return {}
        start_s = self._parse_bound()
        if math.isinf(start_s):
            self._fail(self._tokens[self._place - 1], "expected a finite first bound [s]")
        self._expect(",")
        end = self._next
        end_s = self._parse_bound()
        if end_s < start_s:
            self._fail(end, f"expected a second bound of at least {start_s:g} s")
        self._expect("]")
        return {"start_s": start_s, "end_s": end_s}

    def _parse_bound(self) -> float:
        token = self._take()
        if token.text == "inf" and token.kind == "operator":
            return math.inf
        if token.kind != "number":
            self._fail(token, "expected a bound in seconds, 0 or more")
        return self._make_number(token).value

    def _parse_call(self, token: Token) -> Node:
        if token.text not in FUNCTIONS:
            near = suggest_names(token.text, [*FUNCTIONS, *_TEMPORAL])
            self._fail(token, f"expected a function like {near}")
        arguments = []
        if not self._takes(")"):
            arguments.append(self._parse_level(1))
            while self._takes(","):
                arguments.append(self._parse_level(1))
            self._expect(")")
        few, most, _ = FUNCTIONS[token.text]
        if not few <= len(arguments) <= most:
            count = describe_count(few, "argument") if few == most else f"{few} or more arguments"
            problem = f"expected {token.text} to have {count}, found {len(arguments)}"
            raise build_error(self._source, self._text, token.column, problem)
        return Call(function=token.text, arguments=tuple(arguments), column=token.column)

    def _make_number(self, token: Token) -> Number:
        value = float(token.text)
        if math.isinf(value):
            self._fail(token, "expected a number below 1.8e308, or inf")
        return Number(value=value, column=token.column)

    def _grow(self, node: Node) -> Node:
        """Update the depth of the tree at a node; refuse a tree that is too deep."""
        below = (self._heights[id(child)] for child in node.list_children())
        self._heights[id(node)] = 1 + max(below, default=0)
        self._check_depth(self._heights[id(node)], node.column)
        return node

    def _check_depth(self, depth: int, column: int) -> None:
        if depth > _DEEPEST:
            problem = f"expected at most {_DEEPEST} levels of nesting, found more"
            raise build_error(self._source, self._text, column, problem)
