"""Tree and values -> value, whole columns at a time; what is not known stays unknown."""

from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

from turtlelog.errors import find_near, join_names, quote_name
from turtlelog.expressions.operands import (
    Kind,
    Operand,
    Value,
    compare_operands,
    compute_function,
    compute_operator,
    join_truths,
    make_operand,
    negate_truth,
)
from turtlelog.expressions.tokens import build_error
from turtlelog.expressions.tree import (
    Arithmetic,
    Call,
    Comparison,
    Expression,
    Logic,
    Name,
    Node,
    Number,
    Prefix,
    Temporal,
    Text,
    Truth,
    Until,
)

Values = Mapping[str, Value]

_WORDS = {Kind.NUMBER: "a number", Kind.TEXT: "a text", Kind.TRUTH: "true or false"}


def evaluate_expression(expression: Expression, values: Values) -> Any:
    """Return the value of an expression.

    None among the values means that there is none; what needs it has none either, as has a number
    divided by zero, out of a function's domain, or too large. Truths follow Kleene's logic:
    `false and unknown` is false, `true or unknown` true, and otherwise unknown stays unknown.

    Args:
        expression: Without `always`, `eventually` and `until`.
        values: Values by name: numbers, truths, texts, None, or arrays of one shape, nan standing
            for no value.

    Returns:
        A float, bool, str or None. With arrays, an array: of float with nan, of bool, or of object
        with None, where a truth or text is unknown.

    Raises:
        ExpressionError: If a name is not there or the kinds do not go together, with the column.
    """
    return evaluate_node(expression, expression.root, values).unpack()


def evaluate_node(expression: Expression, node: Node, values: Values) -> Operand:
    """Return the value of a part of an expression.

    Raises:
        ExpressionError: As `evaluate_expression`.
    """
    return _Evaluation(expression, values).evaluate(node)


def require_kind(expression: Expression, node: Node, operand: Operand, kind: Kind) -> None:
    """Refuse an operand of another kind; one without a value fits everywhere.

    Raises:
        ExpressionError: With the column of the node.
    """
    if operand.kind not in {kind, Kind.UNKNOWN}:
        problem = f"expected {_WORDS[kind]}, found {_describe_node(node, operand)}"
        fail_at(expression, node, problem)


def fail_at(expression: Expression, node: Node, problem: str) -> NoReturn:
    """Raise an ExpressionError at a node."""
    raise build_error(expression.source, expression.text, node.column, problem)


class _Evaluation:
    def __init__(self, expression: Expression, values: Values) -> None:
        self._expression = expression
        self._values = values

    def evaluate(self, node: Node) -> Operand:
        match node:
            case Number(value=value) | Text(value=value) | Truth(value=value):
                return make_operand(value)
            case Name():
                return self._look_up(node)
            case Comparison():
                return self._compare(node)
            case Logic() | Prefix(operator="not"):
                return self._join(node)
        return self._compute(node)

    def _compute(self, node: Node) -> Operand:
        if isinstance(node, Temporal | Until):
            word = node.operator if isinstance(node, Temporal) else "until"
            fail_at(self._expression, node, f"expected no {word} here: it needs signals over time")
        operands = self._evaluate_all(node.list_children(), Kind.NUMBER)
        if isinstance(node, Call):
            return compute_function(node.function, operands)
        if isinstance(node, Arithmetic):
            return compute_operator(node.operator, *operands)
        return compute_operator("-", make_operand(-0.0), *operands)

    def _join(self, node: Node) -> Operand:
        operands = self._evaluate_all(node.list_children(), Kind.TRUTH)
        if isinstance(node, Logic):
            return join_truths(node.operator, operands)
        return negate_truth(*operands)

    def _evaluate_all(self, nodes: Sequence[Node], kind: Kind) -> list[Operand]:
        operands = [self.evaluate(node) for node in nodes]
        for node, operand in zip(nodes, operands, strict=True):
            require_kind(self._expression, node, operand, kind)
        return operands

    def _compare(self, node: Comparison) -> Operand:
        operands = [self.evaluate(operand) for operand in node.operands]
        check_comparison(self._expression, node, operands)
        pairs = zip(operands, node.operators, operands[1:], strict=False)
        return join_truths("and", [compare_operands(*pair) for pair in pairs])

    def _look_up(self, node: Name) -> Operand:
        if node.name not in self._values:
            fail_at(self._expression, node, describe_unknown_name(node.name, self._values))
        try:
            return make_operand(self._values[node.name])
        except TypeError as err:
            return fail_at(self._expression, node, f"{node.name}: {err}")


def check_comparison(expression: Expression, node: Comparison, operands: Sequence[Operand]) -> None:
    """Refuse operands of different kinds, and an order of texts or truths.

    Raises:
        ExpressionError: With the column of the operator.
    """
    for index, operator in enumerate(node.operators):
        left, right = operands[index], operands[index + 1]
        kinds = {left.kind, right.kind} - {Kind.UNKNOWN}
        if len(kinds) > 1:
            sides = [_WORDS[left.kind], _WORDS[right.kind]]
            problem = f"expected two of a kind around {operator}, found {' and '.join(sides)}"
        elif operator not in {"==", "!="} and kinds - {Kind.NUMBER}:
            problem = f"expected numbers around {operator}, found {_WORDS[kinds.pop()]}"
        else:
            continue
        column = node.columns[index] if node.columns else node.column
        raise build_error(expression.source, expression.text, column, problem)


def describe_unknown_name(name: str, known: Mapping[str, object]) -> str:
    """Return what to say of a name that is not there: the nearest ones that are."""
    near = find_near(name, known)
    if near:
        return f"unknown name {quote_name(name)}; did you mean {join_names(near)}?"
    listed = ", ".join(list(known)[:8]) + (", ..." if len(known) > 8 else "")
    return f"unknown name {quote_name(name)}; there are {listed or 'none'}"


def _describe_node(node: Node, operand: Operand) -> str:
    word = _WORDS[operand.kind]
    return f"{node.name}, {word}" if isinstance(node, Name) else word
