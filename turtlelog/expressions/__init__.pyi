from .evaluation import (
    Kind as Kind,
    Operand as Operand,
    Values as Values,
    check_comparison as check_comparison,
    compare_operands as compare_operands,
    describe_unknown_name as describe_unknown_name,
    evaluate_expression as evaluate_expression,
    evaluate_node as evaluate_node,
    fail_at as fail_at,
    require_kind as require_kind,
)
from .parser import (
    format_expression as format_expression,
    parse_expression as parse_expression,
)
from .syntax import (
    Arithmetic as Arithmetic,
    Call as Call,
    Comparison as Comparison,
    Expression as Expression,
    Logic as Logic,
    Name as Name,
    Node as Node,
    Number as Number,
    Prefix as Prefix,
    Temporal as Temporal,
    Text as Text,
    Truth as Truth,
    Until as Until,
    draw_caret as draw_caret,
    iterate_nodes as iterate_nodes,
)
