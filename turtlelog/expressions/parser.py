"""Parsing of expressions by precedence climbing, and formatting. No text is run as Python."""

import math
from typing import Any, Final, NoReturn, TypeVar, cast

from turtlelog.display import describe_count
from turtlelog.errors import suggest_names
from turtlelog.expressions import syntax

_DEEPEST: Final = 100  # levels of nesting, so that no caller meets Python's recursion limit

AnyNode = TypeVar("AnyNode", bound=syntax.Node)

_COMPARISONS: Final = ("<", "<=", ">", ">=", "==", "!=")

_PRECEDENCE: Final = {
    "implies": 1,
    "or": 2,
    "and": 3,
    "until": 4,
    "not": 5,
    **dict.fromkeys(_COMPARISONS, 6),
    "+": 7,
    "-": 7,
    "*": 8,
    "/": 8,
    "unary -": 9,
    "**": 10,
}
"""Precedence of operators; a higher number binds tighter. `unary -` is the minus of -x."""

_INFIX: Final = frozenset(_PRECEDENCE) - {"not", "unary -"}


def parse_expression(text: str, *, source: str = "expression") -> syntax.Expression:
    """Return the tree of an expression.

    Args:
        text: Expression in the language of docs/expressions.md.
        source: Origin of the text for messages: an option, or a file and key.

    Raises:
        ExpressionError: If the text cannot be parsed; the message gives the column.
    """
    return syntax.Expression(text=text, source=source, root=_Parser(text, source).parse())


_TEMPORAL = ("always", "eventually")


class _Parser:
    def __init__(self, text: str, source: str) -> None:
        self._text = text
        self._source = source
        self._tokens = syntax.split_tokens(text, source=source)
        self._place = 0
        self._open = 0
        self._heights: dict[int, int] = {}

    def parse(self) -> syntax.Node:
        root = self._parse_level(1)
        if self._next.kind != "end":
            self._fail(self._next, "expected an operator or the end")
        return root

    @property
    def _next(self) -> syntax.Token:
        return self._tokens[self._place]

    def _take(self) -> syntax.Token:
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

    def _fail(self, token: syntax.Token, expected: str) -> NoReturn:
        raise syntax.build_error(
            self._source, self._text, token.column, f"{expected}, found {token}"
        )

    def _parse_level(self, loosest: int) -> syntax.Node:
        """Parse operands and the operators between them that have at least this precedence."""
        self._open += 1
        self._check_depth(self._open, self._next.column)
        node = self._parse_prefix()
        while (binding := self._find_binding()) >= loosest:
            node = self._parse_infix(node, self._take(), binding)
        self._open -= 1
        return node

    def _find_binding(self) -> int:
        token = self._next
        is_infix = token.kind == "operator" and token.text in _INFIX
        return _PRECEDENCE[token.text] if is_infix else 0

    def _parse_infix(self, left: syntax.Node, token: syntax.Token, binding: int) -> syntax.Node:
        if binding == _PRECEDENCE["<"]:
            return self._parse_comparison(left, token)
        if token.text in {"and", "or"}:
            return self._parse_joined(left, token, binding)
        window = self._parse_window() if token.text == "until" else (0.0, math.inf)
        to_the_right = token.text in {"implies", "until", "**"}
        if token.text == "**":  # its exponent may be negative: 10**-3
            right = self._parse_level(_PRECEDENCE["unary -"])
        else:
            right = self._parse_level(binding if to_the_right else binding + 1)
        sides: dict[str, Any] = {"left": left, "right": right, "column": token.column}
        if token.text == "until":
            return self._grow(syntax.Until(start_s=window[0], end_s=window[1], **sides))
        operator = cast("Any", token.text)
        if operator == "implies":
            return self._grow(
                syntax.Logic(operator=operator, operands=(left, right), column=token.column)
            )
        return self._grow(syntax.Arithmetic(operator=operator, **sides))

    def _parse_comparison(self, left: syntax.Node, first: syntax.Token) -> syntax.Node:
        operators, operands = [first], [left, self._parse_level(_PRECEDENCE["<"] + 1)]
        while self._find_binding() == _PRECEDENCE["<"]:
            operators.append(self._take())
            operands.append(self._parse_level(_PRECEDENCE["<"] + 1))
        node = syntax.Comparison(
            operators=tuple(cast("Any", token.text) for token in operators),
            operands=tuple(operands),
            columns=tuple(token.column for token in operators),
            column=first.column,
        )
        return self._grow(node)

    def _parse_joined(self, left: syntax.Node, first: syntax.Token, binding: int) -> syntax.Node:
        operands = [left, self._parse_level(binding + 1)]
        while self._takes(first.text):
            operands.append(self._parse_level(binding + 1))
        operator = cast("Any", first.text)
        return self._grow(
            syntax.Logic(operator=operator, operands=tuple(operands), column=first.column)
        )

    def _parse_prefix(self) -> syntax.Node:
        token = self._take()
        if token.kind == "operator":
            return self._parse_operator(token)
        if token.kind == "number":
            return self._make_number(token)
        if token.kind == "text":
            return self._grow(syntax.Text(value=token.text, column=token.column))
        if token.kind == "end":
            self._fail(token, "expected a number or name")
        if self._takes("("):
            return self._parse_call(token)
        return self._grow(syntax.Name(name=token.text, column=token.column))

    def _parse_operator(self, token: syntax.Token) -> syntax.Node:
        if token.text == "(":
            inside = self._parse_level(1)
            self._expect(")")
            return inside
        if token.text in {"-", "not"}:
            binding = _PRECEDENCE["not" if token.text == "not" else "unary -"]
            operator, operand = cast("Any", token.text), self._parse_level(binding)
            return self._grow(
                syntax.Prefix(operator=operator, operand=operand, column=token.column)
            )
        if token.text in _TEMPORAL:
            return self._parse_temporal(token)
        if token.text in {"true", "false"}:
            return self._grow(syntax.Truth(value=token.text == "true", column=token.column))
        if token.text == "inf":
            return self._grow(syntax.Number(value=math.inf, column=token.column))
        return self._fail(token, "expected a number or name")

    def _parse_temporal(self, token: syntax.Token) -> syntax.Node:
        start_s, end_s = self._parse_window()
        self._expect("(")
        operand = self._parse_level(1)
        self._expect(")")
        operator = cast("Any", token.text)
        node = syntax.Temporal(
            operator=operator, start_s=start_s, end_s=end_s, operand=operand, column=token.column
        )
        return self._grow(node)

    def _parse_window(self) -> tuple[float, float]:
        """Parse a window `[a, b]` in seconds; without one, return 0 to infinity."""
        if not self._takes("["):
            return 0.0, math.inf
        start_s = self._parse_bound()
        if math.isinf(start_s):
            self._fail(self._tokens[self._place - 1], "expected a finite first bound [s]")
        self._expect(",")
        end = self._next
        end_s = self._parse_bound()
        if end_s < start_s:
            self._fail(end, f"expected a second bound of at least {start_s:g} s")
        self._expect("]")
        return start_s, end_s

    def _parse_bound(self) -> float:
        token = self._take()
        if token.text == "inf" and token.kind == "operator":
            return math.inf
        if token.kind != "number":
            self._fail(token, "expected a bound in seconds, 0 or more")
        return self._make_number(token).value

    def _parse_call(self, token: syntax.Token) -> syntax.Node:
        if token.text not in syntax.FUNCTIONS:
            near = suggest_names(token.text, [*syntax.FUNCTIONS, *_TEMPORAL])
            self._fail(token, f"expected a function like {near}")
        arguments = []
        if not self._takes(")"):
            arguments.append(self._parse_level(1))
            while self._takes(","):
                arguments.append(self._parse_level(1))
            self._expect(")")
        least, most, _ = syntax.FUNCTIONS[token.text]
        if not least <= len(arguments) <= most:
            count = (
                f"{least} or more arguments" if least != most else describe_count(least, "argument")
            )
            problem = f"expected {token.text} to have {count}, found {len(arguments)}"
            raise syntax.build_error(self._source, self._text, token.column, problem)
        call = syntax.Call(function=token.text, arguments=tuple(arguments), column=token.column)
        return self._grow(call)

    def _make_number(self, token: syntax.Token) -> syntax.Number:
        value = float(token.text)
        if math.isinf(value):
            self._fail(token, "expected a number below 1.8e308, or inf")
        return self._grow(syntax.Number(value=value, column=token.column))

    def _grow(self, node: AnyNode) -> AnyNode:
        """Update the depth of the tree at a node; refuse a tree that is too deep."""
        below = (self._heights[id(child)] for child in node.list_children())
        self._heights[id(node)] = 1 + max(below, default=0)
        self._check_depth(self._heights[id(node)], node.column)
        return node

    def _check_depth(self, depth: int, column: int) -> None:
        if depth > _DEEPEST:
            problem = f"expected at most {_DEEPEST} levels of nesting, found more"
            raise syntax.build_error(self._source, self._text, column, problem)


_ATOM = 11


def format_expression(expression: syntax.Expression | syntax.Node) -> str:
    """Return an expression or a part of it as text with the fewest parentheses."""
    return _format(expression.root if isinstance(expression, syntax.Expression) else expression)


def _format(node: syntax.Node) -> str:
    match node:
        case syntax.Name(name=name):
            text = name
        case syntax.Call(function=function, arguments=arguments):
            text = f"{function}({', '.join(map(_format, arguments))})"
        case syntax.Temporal(operator=operator, operand=operand):
            text = f"{operator}{_format_window(node)}({_format(operand)})"
        case syntax.Number(value=value):
            text = "inf" if math.isinf(value) else f"{value!r}".removesuffix(".0")
        case syntax.Text(value=value):
            text = f'"{value}"' if '"' not in value else f"'{value}'"
        case syntax.Truth(value=value):
            text = "true" if value else "false"
        case _:
            text = _format_operator(node)
    return text


def _format_operator(node: syntax.Node) -> str:
    binding = _find_binding(node)
    match node:
        case syntax.Prefix(operator=operator, operand=operand):
            space = " " if operator == "not" else ""
            return f"{operator}{space}{_wrap(operand, binding)}"
        case syntax.Comparison(operators=operators, operands=operands):
            first, *others = (_wrap(operand, binding + 1) for operand in operands)
            pairs = zip(operators, others, strict=True)
            return " ".join([first, *(f"{operator} {right}" for operator, right in pairs)])
        case syntax.Logic(operator="and" | "or" as operator, operands=operands):
            return f" {operator} ".join(_wrap(operand, binding + 1) for operand in operands)
    return _format_pair(node, *node.list_children())


def _format_pair(node: syntax.Node, left: syntax.Node, right: syntax.Node) -> str:
    """Format a node with two operands; `implies` and `until` are right-associative."""
    binding = _find_binding(node)
    match node:
        case syntax.Arithmetic(operator="**"):
            return f"{_wrap(left, binding + 1)}**{_wrap(right, _PRECEDENCE['unary -'])}"
        case syntax.Arithmetic(operator=operator):
            return f"{_wrap(left, binding)} {operator} {_wrap(right, binding + 1)}"
        case syntax.Until():
            word = f"until{_format_window(node)}"
        case _:
            word = "implies"
    return f"{_wrap(left, binding + 1)} {word} {_wrap(right, binding)}"


def _wrap(node: syntax.Node, loosest: int) -> str:
    text = _format(node)
    return text if _find_binding(node) >= loosest else f"({text})"


def _format_window(node: syntax.Temporal | syntax.Until) -> str:
    if (node.start_s, node.end_s) == (0.0, math.inf):
        return ""
    ends = (_format(syntax.Number(value=end_s)) for end_s in (node.start_s, node.end_s))
    return f"[{', '.join(ends)}]"


def _find_binding(node: syntax.Node) -> int:
    match node:
        case syntax.Prefix(operator=operator):
            return _PRECEDENCE["unary -" if operator == "-" else "not"]
        case syntax.Logic(operator=operator) | syntax.Arithmetic(operator=operator):
            return _PRECEDENCE[operator]
        case syntax.Comparison():
            return _PRECEDENCE["<"]
        case syntax.Until():
            return _PRECEDENCE["until"]
    return _ATOM
