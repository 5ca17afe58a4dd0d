"""Tree -> text that parses to the same tree."""

import math

from turtlelog.expressions.parser import PRECEDENCE
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

_ATOM = 11


def format_expression(expression: Expression | Node) -> str:
    """Return an expression, or part of one, as text with no more parentheses than it needs."""
    return _format(expression.root if isinstance(expression, Expression) else expression)


def _format(node: Node) -> str:
    match node:
        case Name(name=name):
            return name
        case Call(function=function, arguments=arguments):
            return f"{function}({', '.join(_format(argument) for argument in arguments)})"
        case Temporal(operator=operator, operand=operand):
            return f"{operator}{_format_window(node)}({_format(operand)})"
        case Number() | Text() | Truth():
            return _format_constant(node)
    return _format_operator(node)


def _format_constant(node: Number | Text | Truth) -> str:
    match node:
        case Number(value=value):
            return "inf" if math.isinf(value) else f"{value!r}".removesuffix(".0")
        case Text(value=value):
            return f'"{value}"' if '"' not in value else f"'{value}'"
    return "true" if node.value else "false"


def _format_operator(node: Node) -> str:
    binding = _find_binding(node)
    match node:
        case Prefix(operator=operator, operand=operand):
            space = " " if operator == "not" else ""
            return f"{operator}{space}{_wrap(operand, binding)}"
        case Comparison(operators=operators, operands=operands):
            first, *others = (_wrap(operand, binding + 1) for operand in operands)
            pairs = zip(operators, others, strict=True)
            return " ".join([first, *(f"{operator} {right}" for operator, right in pairs)])
        case Logic(operator="and" | "or" as operator, operands=operands):
            return f" {operator} ".join(_wrap(operand, binding + 1) for operand in operands)
    return _format_pair(node, *node.list_children())


def _format_pair(node: Node, left: Node, right: Node) -> str:
    """Format what has two operands; `implies` and `until` associate to the right."""
    binding = _find_binding(node)
    match node:
        case Arithmetic(operator="**"):
            return f"{_wrap(left, binding + 1)}**{_wrap(right, PRECEDENCE['unary -'])}"
        case Arithmetic(operator=operator):
            return f"{_wrap(left, binding)} {operator} {_wrap(right, binding + 1)}"
        case Until():
            word = f"until{_format_window(node)}"
        case _:
            word = "implies"
    return f"{_wrap(left, binding + 1)} {word} {_wrap(right, binding)}"


def _wrap(node: Node, loosest: int) -> str:
    text = _format(node)
    return text if _find_binding(node) >= loosest else f"({text})"


def _format_window(node: Temporal | Until) -> str:
    if (node.start_s, node.end_s) == (0.0, math.inf):
        return ""
    ends = (_format(Number(value=end_s)) for end_s in (node.start_s, node.end_s))
    return f"[{', '.join(ends)}]"


def _find_binding(node: Node) -> int:
    match node:
        case Prefix(operator=operator):
            return PRECEDENCE["unary -" if operator == "-" else "not"]
        case Logic(operator=operator) | Arithmetic(operator=operator):
            return PRECEDENCE[operator]
        case Comparison():
            return PRECEDENCE["<"]
        case Until():
            return PRECEDENCE["until"]
    return _ATOM
