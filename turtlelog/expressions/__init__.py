"""The one expression language: parsed by us, never run as Python."""

from turtlelog.expressions.evaluation import (
    Values,
    check_comparison,
    describe_unknown_name,
    evaluate_expression,
    evaluate_node,
    fail_at,
    require_kind,
)
from turtlelog.expressions.operands import ARGUMENTS, Kind, Operand, compare_operands, make_operand
from turtlelog.expressions.parser import PRECEDENCE, parse_expression
from turtlelog.expressions.printing import format_expression
from turtlelog.expressions.tokens import draw_caret
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
    iterate_nodes,
)

__all__ = [
    "ARGUMENTS",
    "PRECEDENCE",
    "Arithmetic",
    "Call",
    "Comparison",
    "Expression",
    "Kind",
    "Logic",
    "Name",
    "Node",
    "Number",
    "Operand",
    "Prefix",
    "Temporal",
    "Text",
    "Truth",
    "Until",
    "Values",
    "check_comparison",
    "compare_operands",
    "describe_unknown_name",
    "draw_caret",
    "evaluate_expression",
    "evaluate_node",
    "fail_at",
    "format_expression",
    "iterate_nodes",
    "make_operand",
    "parse_expression",
    "require_kind",
]
