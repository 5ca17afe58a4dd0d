"""Evaluation of expression trees on whole columns, where unknown values stay unknown; formatting.

Numbers and truth values are float64 arrays of any shape; truth values are 0 or 1, NaN means
unknown.
"""

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import find_near, join_names, quote_name
from turtlelog.expressions import parser

_OPERATORS: Final = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "**": np.power,
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "==": np.equal,
    "!=": np.not_equal,
}

Value = Any
"""float, int, bool, str, None, or an array of them."""

Values = Mapping[str, Value]


class Kind(enum.Enum):
    """Kind of an operand; UNKNOWN is compatible with every kind."""

    NUMBER = "a number"
    TEXT = "a text"
    TRUTH = "true or false"
    UNKNOWN = "unknown"


def evaluate_expression(expression: parser.Expression, values: Values) -> Any:
    """Return the value of an expression.

    None means a missing value. A result that needs a missing value is missing too. The results of a
    division by zero, an overflow, or an argument outside a function's domain are also missing.
    Truth values follow Kleene's logic: `false and unknown` is false, `true or unknown` true, and
    otherwise unknown stays unknown.

    Args:
        expression: Expression without `always`, `eventually` and `until`.
        values: Values by name: numbers, truth values, texts, None, or arrays of one shape, with nan
            for a missing value.

    Returns:
        A float, bool, str or None. If values are arrays, an array: float with nan, bool, or object
        with None if a truth value or text is unknown.

    Raises:
        ExpressionError: If a name is unknown or the kinds do not match; the message gives the
            column.
    """
    return evaluate_node(expression, expression.root, values).unpack()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Operand:
    """A value within an expression.

    Attributes:
        kind: Kind of the value.
        data: float64 with nan for unknown values; strings for texts; nan for UNKNOWN.
    """

    kind: Kind
    data: NDArray[Any]

    def unpack(self) -> Value:
        """Convert the operand to a user's value: a float, bool, str, None or an array."""
        if self.kind in {Kind.TRUTH, Kind.UNKNOWN}:
            unknown = np.isnan(self.data)
            if not self.data.shape:
                return None if unknown else bool(self.data)
            truths = self.data.astype(np.bool_)
            if unknown.any():
                truths = truths.astype(np.object_)
                truths[unknown] = None
            return truths
        if self.data.shape:
            return self.data
        value = self.data.item()
        return None if isinstance(value, float) and math.isnan(value) else value


def evaluate_node(expression: parser.Expression, node: parser.Node, values: Values) -> Operand:
    """Return the value of a part of an expression.

    Raises:
        ExpressionError: As for `evaluate_expression`.
    """
    return _Evaluation(expression, values).evaluate(node)


def require_kind(
    expression: parser.Expression, node: parser.Node, operand: Operand, kind: Kind
) -> None:
    """Refuse an operand of another kind than the given one; UNKNOWN is accepted.

    Raises:
        ExpressionError: If the kind differs; the message gives the column of the node.
    """
    if operand.kind not in {kind, Kind.UNKNOWN}:
        name = f"{node.name}, " if isinstance(node, parser.Name) else ""
        problem = f"expected {kind.value}, found {name}{operand.kind.value}"
        if kind is Kind.TRUTH and operand.kind is Kind.NUMBER and isinstance(node, parser.Name):
            problem += f"; compare it, for example {node.name} <= 2"
        fail_at(expression, node, problem)


def fail_at(expression: parser.Expression, node: parser.Node, problem: str) -> NoReturn:
    """Raise an ExpressionError at a node."""
    raise parser.build_error(expression.source, expression.text, node.column, problem)


class _Evaluation:
    def __init__(self, expression: parser.Expression, values: Values) -> None:
        self._expression = expression
        self._values = values

    def evaluate(self, node: parser.Node) -> Operand:
        match node:
            case parser.Number(value=value) | parser.Text(value=value) | parser.Truth(value=value):
                return _make_operand(value)
            case parser.Name():
                return self._look_up(node)
            case parser.Comparison():
                return self._compare(node)
            case parser.Logic() | parser.Prefix(operator="not"):
                return self._join(node)
        return self._compute(node)

    def _compute(self, node: parser.Node) -> Operand:
        if isinstance(node, parser.Temporal | parser.Until):
            word = node.operator if isinstance(node, parser.Temporal) else "until"
            fail_at(self._expression, node, f"expected no {word} here: it needs signals over time")
        operands = self._evaluate_all(node.list_children(), Kind.NUMBER)
        if isinstance(node, parser.Call):
            return _compute_function(node.function, operands)
        if isinstance(node, parser.Arithmetic):
            return _compute_operator(node.operator, *operands)
        return _compute_operator("-", _make_operand(-0.0), *operands)

    def _join(self, node: parser.Node) -> Operand:
        operands = self._evaluate_all(node.list_children(), Kind.TRUTH)
        if isinstance(node, parser.Logic):
            return _join_truths(node.operator, operands)
        return _negate_truth(*operands)

    def _evaluate_all(self, nodes: Sequence[parser.Node], kind: Kind) -> list[Operand]:
        operands = [self.evaluate(node) for node in nodes]
        for node, operand in zip(nodes, operands, strict=True):
            require_kind(self._expression, node, operand, kind)
        return operands

    def _compare(self, node: parser.Comparison) -> Operand:
        operands = [self.evaluate(operand) for operand in node.operands]
        check_comparison(self._expression, node, operands)
        pairs = zip(operands, node.operators, operands[1:], strict=False)
        return _join_truths("and", [compare_operands(*pair) for pair in pairs])

    def _look_up(self, node: parser.Name) -> Operand:
        if node.name not in self._values:
            fail_at(self._expression, node, describe_unknown_name(node.name, self._values))
        try:
            return _make_operand(self._values[node.name])
        except TypeError as err:
            return fail_at(self._expression, node, f"{node.name}: {err}")


def check_comparison(
    expression: parser.Expression, node: parser.Comparison, operands: Sequence[Operand]
) -> None:
    """Refuse to compare operands of different kinds, or to order texts or truth values.

    Raises:
        ExpressionError: If the operands cannot be compared; the message gives the column of the
            operator.
    """
    for index, operator in enumerate(node.operators):
        left, right = operands[index], operands[index + 1]
        kinds = {left.kind, right.kind} - {Kind.UNKNOWN}
        if len(kinds) > 1:
            sides = [left.kind.value, right.kind.value]
            problem = f"expected two of a kind around {operator}, found {' and '.join(sides)}"
        elif operator not in {"==", "!="} and kinds - {Kind.NUMBER}:
            problem = f"expected numbers around {operator}, found {kinds.pop().value}"
        else:
            continue
        column = node.columns[index] if node.columns else node.column
        raise parser.build_error(expression.source, expression.text, column, problem)


def describe_unknown_name(name: str, known: Mapping[str, object]) -> str:
    """Return the message about an unknown name, with the most similar known names."""
    near = find_near(name, known)
    if near:
        return f"unknown name {quote_name(name)}; did you mean {join_names(near)}?"
    listed = ", ".join(list(known)[:8]) + (", ..." if len(known) > 8 else "")
    return f"unknown name {quote_name(name)}; there are {listed or 'none'}"


def _make_operand(value: Value) -> Operand:
    """Return a user's value as an operand; raise a TypeError for a value of no kind."""
    if value is None:
        return Operand(kind=Kind.UNKNOWN, data=np.array(np.nan))
    data = np.asarray(value)
    if data.dtype.kind == "U":
        return Operand(kind=Kind.TEXT, data=data)
    if data.dtype.kind == "b":
        return Operand(kind=Kind.TRUTH, data=data.astype(np.float64))
    if data.dtype.kind not in "iuf":
        raise TypeError(f"expected a number, text or truth, found {type(value).__name__}")
    return Operand(kind=Kind.NUMBER, data=data.astype(np.float64, copy=False))


def _compute_operator(operator: str, left: Operand, right: Operand) -> Operand:
    """Return the result of + - * / or ** on two numbers; NaN if the result is undefined."""
    with np.errstate(all="ignore"):
        data = _OPERATORS[operator](left.data, right.data)
        if operator == "/":
            data = np.where(right.data == 0, np.nan, data)
        if operator == "**":  # IEEE has nan**0 = 1 and 1**nan = 1
            data = np.where(np.isnan(left.data) | np.isnan(right.data), np.nan, data)
    return _make_number(data, [left, right])


def _compute_function(function: str, arguments: Sequence[Operand]) -> Operand:
    ufunc = getattr(np, parser.FUNCTIONS[function][2])
    data = [argument.data for argument in arguments]
    with np.errstate(all="ignore"):
        if len(data) <= 2:
            return _make_number(ufunc(*data), arguments)
        return _make_number(ufunc.reduce(np.broadcast_arrays(*data)), arguments)


def compare_operands(left: Operand, operator: str, right: Operand) -> Operand:
    """Return the truth value of a comparison of two operands of the same kind."""
    if Kind.UNKNOWN in {left.kind, right.kind}:
        shape = np.broadcast_shapes(left.data.shape, right.data.shape)
        return Operand(kind=Kind.TRUTH, data=np.full(shape, np.nan))
    truth = np.asarray(_OPERATORS[operator](left.data, right.data), np.float64)
    if left.kind is not Kind.TEXT:
        truth = np.where(np.isnan(left.data) | np.isnan(right.data), np.nan, truth)
    return Operand(kind=Kind.TRUTH, data=truth)


def _negate_truth(operand: Operand) -> Operand:
    return Operand(kind=Kind.TRUTH, data=1.0 - operand.data)


def _join_truths(operator: str, operands: Sequence[Operand]) -> Operand:
    """Return truth values joined by `and`, `or` or, for two, `implies` (Kleene's logic)."""
    if operator == "implies":
        return _join_truths("or", [_negate_truth(operands[0]), operands[1]])
    if operator == "or":
        return _negate_truth(_join_truths("and", [_negate_truth(one) for one in operands]))
    data = operands[0].data
    for operand in operands[1:]:
        is_false = (data == 0) | (operand.data == 0)
        data = np.where(is_false, 0.0, data * operand.data)
    return Operand(kind=Kind.TRUTH, data=data)


def _make_number(data: NDArray[Any], sources: Sequence[Operand]) -> Operand:
    """Return a number operand. Infinite results of finite operands become NaN (overflow, pole)."""
    data = np.asarray(data)
    if np.isinf(data).any():
        had_infinity = np.logical_or.reduce(
            np.broadcast_arrays(*(np.isinf(source.data) for source in sources))
        )
        data = np.where(np.isinf(data) & ~had_infinity, np.nan, data)
    return Operand(kind=Kind.NUMBER, data=data)


_TIGHTEST: Final = 11  # names, numbers and calls bind tighter than every operator


def format_expression(expression: parser.Expression | parser.Node) -> str:
    """Return an expression or a part of it as text with the fewest parentheses."""
    return _format(expression.root if isinstance(expression, parser.Expression) else expression)


def _format(node: parser.Node) -> str:
    match node:
        case parser.Name(name=name):
            text = name
        case parser.Call(function=function, arguments=arguments):
            text = f"{function}({', '.join(map(_format, arguments))})"
        case parser.Temporal(operator=operator, operand=operand):
            text = f"{operator}{_format_window(node)}({_format(operand)})"
        case parser.Number(value=value):
            text = "inf" if math.isinf(value) else f"{value!r}".removesuffix(".0")
        case parser.Text(value=value):
            text = f'"{value}"' if '"' not in value else f"'{value}'"
        case parser.Truth(value=value):
            text = "true" if value else "false"
        case _:
            text = _format_operator(node)
    return text


def _format_operator(node: parser.Node) -> str:
    binding = _find_binding(node)
    match node:
        case parser.Prefix(operator=operator, operand=operand):
            space = " " if operator == "not" else ""
            return f"{operator}{space}{_wrap(operand, binding)}"
        case parser.Comparison(operators=operators, operands=operands):
            first, *others = (_wrap(operand, binding + 1) for operand in operands)
            pairs = zip(operators, others, strict=True)
            return " ".join([first, *(f"{operator} {right}" for operator, right in pairs)])
        case parser.Logic(operator="and" | "or" as operator, operands=operands):
            return f" {operator} ".join(_wrap(operand, binding + 1) for operand in operands)
    return _format_pair(node, *node.list_children())


def _format_pair(node: parser.Node, left: parser.Node, right: parser.Node) -> str:
    """Format a node with two operands; `implies` and `until` are right-associative."""
    binding = _find_binding(node)
    match node:
        case parser.Arithmetic(operator="**"):
            return f"{_wrap(left, binding + 1)}**{_wrap(right, parser.PRECEDENCE['unary -'])}"
        case parser.Arithmetic(operator=operator):
            return f"{_wrap(left, binding)} {operator} {_wrap(right, binding + 1)}"
        case parser.Until():
            word = f"until{_format_window(node)}"
        case _:
            word = "implies"
    return f"{_wrap(left, binding + 1)} {word} {_wrap(right, binding)}"


def _wrap(node: parser.Node, loosest: int) -> str:
    text = _format(node)
    return text if _find_binding(node) >= loosest else f"({text})"


def _format_window(node: parser.Temporal | parser.Until) -> str:
    if (node.start_s, node.end_s) == (0.0, math.inf):
        return ""
    ends = (_format(parser.Number(value=end_s)) for end_s in (node.start_s, node.end_s))
    return f"[{', '.join(ends)}]"


def _find_binding(node: parser.Node) -> int:
    match node:
        case parser.Prefix(operator=operator):
            return parser.PRECEDENCE["unary -" if operator == "-" else "not"]
        case parser.Logic(operator=operator) | parser.Arithmetic(operator=operator):
            return parser.PRECEDENCE[operator]
        case parser.Comparison():
            return parser.PRECEDENCE["<"]
        case parser.Until():
            return parser.PRECEDENCE["until"]
    return _TIGHTEST


_WIDTH: Final = 78  # characters of a line that is shown


def draw_caret(text: str, column: int) -> str:
    """Return the line of a text that contains a column, with a caret below the column.

    Long lines are cut around the column. Control characters are shown as spaces.

    Args:
        text: Text of an expression.
        column: Column, counted from 1 over the whole text, as in `ExpressionError.column`.
    """
    head = text[: column - 1].rpartition("\n")[2]
    line = head + text[column - 1 :].partition("\n")[0]
    start = max(0, min(len(head) - _WIDTH // 2, len(line) - _WIDTH))
    shown = line[start : start + _WIDTH]
    printable = "".join(character if character.isprintable() else " " for character in shown)
    return f"{printable}\n{' ' * (len(head) - start)}^"
