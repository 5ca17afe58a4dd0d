"""The tree of a parsed expression: frozen nodes with their columns in the text."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

from turtlelog.escapes import escape_controls

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

    def list_children(self) -> tuple[Node, ...]:
        """Return the arguments."""
        return self.arguments


@dataclass(frozen=True, slots=True, kw_only=True)
class Prefix(Node):
    """`-` before a number, or `not` before a truth."""

    operator: Literal["-", "not"]
    operand: Node

    def list_children(self) -> tuple[Node, ...]:
        """Return the operand."""
        return (self.operand,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Arithmetic(Node):
    """Two numbers and an operator; `column` is the column of the operator."""

    operator: ArithmeticOperator
    left: Node
    right: Node

    def list_children(self) -> tuple[Node, ...]:
        """Return left and right."""
        return self.left, self.right


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

    def list_children(self) -> tuple[Node, ...]:
        """Return the operands."""
        return self.operands


@dataclass(frozen=True, slots=True, kw_only=True)
class Logic(Node):
    """Truth values joined by one operator: two or more by `and` or `or`, two by `implies`."""

    operator: LogicOperator
    operands: tuple[Node, ...]

    def list_children(self) -> tuple[Node, ...]:
        """Return the operands."""
        return self.operands


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

    def list_children(self) -> tuple[Node, ...]:
        """Return the operand."""
        return (self.operand,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Until(Node):
    """`right` becomes true within the window, and `left` is true until that instant."""

    start_s: float = 0.0
    end_s: float = math.inf
    left: Node
    right: Node

    def list_children(self) -> tuple[Node, ...]:
        """Return left and right."""
        return self.left, self.right


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
