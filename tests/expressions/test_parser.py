import subprocess
import sys

import pytest
from hypothesis import given, settings, strategies as st

from tests.expressions.trees import numbers, temporal
from turtlelog.errors import ExpressionError
from turtlelog.expressions import Logic, Node, draw_caret, format_expression, parse_expression


def catch_error(text: str) -> ExpressionError:
    with pytest.raises(ExpressionError) as caught:
        parse_expression(text, source="--where")
    return caught.value


@settings(deadline=None)
@given(temporal | numbers)
def test_printed_expressions_parse_to_the_same_tree(tree: Node) -> None:
    text = format_expression(tree)
    parsed = parse_expression(text)
    assert parsed.root == tree
    assert format_expression(parsed) == text


@settings(deadline=None)
@given(st.text(max_size=40) | st.text("0123456789.xe+-*/<>=!()[], 'andotrimplsuwy\n", max_size=60))
def test_any_text_parses_or_says_in_one_line_where_it_does_not(text: str) -> None:
    """Hypothesis makes hundreds of texts."""
    try:
        parsed = parse_expression(text)
    except ExpressionError as caught:
        err = caught
    else:
        assert parse_expression(format_expression(parsed)).root == parsed.root
        return
    assert len(str(err).splitlines()) == 1
    assert 1 <= (err.column or 0) <= len(text) + 1


@pytest.mark.parametrize(
    ("text", "grouped"),
    [
        ("a or b and c", "a or (b and c)"),
        ("a and b or c", "(a and b) or c"),
        ("a implies b implies c", "a implies (b implies c)"),
        ("a or b implies c", "(a or b) implies c"),
        ("not a and b", "(not a) and b"),
        ("not x < 1", "not (x < 1)"),
        ("a and b until c", "a and (b until c)"),
        ("not a until b until c", "(not a) until (b until c)"),
        ("x + y < z * 2", "(x + y) < (z * 2)"),
        ("x - y - z", "(x - y) - z"),
        ("x / y * z", "(x / y) * z"),
        ("x + y * z", "x + (y * z)"),
        ("-x**2", "-(x**2)"),
        ("-x * y", "(-x) * y"),
        ("2**-x**2", "2**(-(x**2))"),
        ("2**x**y", "2**(x**y)"),
        ("a -> b", "a implies b"),
        ("always(x > 1) and y < 2", "(always(x > 1)) and (y < 2)"),
        ("always[0, inf](x > 1)", "always(x > 1)"),
        ("((x)) < .5e0", "x < 0.5"),
        ('phase == "rotate"', "phase == 'rotate'"),
    ],
)
def test_operators_bind_as_the_page_says(text: str, grouped: str) -> None:
    assert parse_expression(text).root == parse_expression(grouped).root


@pytest.mark.parametrize(
    ("text", "other"),
    [
        ("(a and b) and c", "a and b and c"),
        ("0 < x < 1", "(0 < x) < 1"),
        ("x - (y - z)", "x - y - z"),
    ],
)
def test_parentheses_make_another_tree_where_they_matter(text: str, other: str) -> None:
    assert parse_expression(text).root != parse_expression(other).root


def test_joined_truths_are_one_node() -> None:
    root = parse_expression("a and b and c").root
    assert isinstance(root, Logic)
    assert len(root.operands) == 3


def test_names_stand_in_order_of_first_use() -> None:
    expression = parse_expression("law.kp_linear > 2 and x < rotate.settling_time + x")
    assert expression.names == ("law.kp_linear", "x", "rotate.settling_time")


@pytest.mark.parametrize("text", ["always(x > 1)", "eventually[0, 2](x > 1)", "a and b until c"])
def test_temporal_expressions_say_so(text: str) -> None:
    assert parse_expression(text).is_temporal
    assert not parse_expression("x > 1 and untiled").is_temporal


@pytest.mark.parametrize(
    ("text", "column", "problem"),
    [
        ("", 1, "expected a number or name, found the end"),
        ("  ", 1, "expected a number or name, found the end"),
        ("x <  ", 4, "expected a number or name, found the end"),
        ("(x > 1", 7, r"expected '\)', found the end"),
        ("x > 1)", 6, r"expected an operator or the end, found '\)'"),
        ("law.kp_linear > ()", 18, r"expected a number or name, found '\)'"),
        ("x y", 3, "expected an operator or the end, found 'y'"),
        ("2x", 2, "expected an operator or the end, found 'x'"),
        ("x = 1", 3, "found '='; equality is =="),
        ("x ^ 2", 3, r"found '\^'; powers are \*\*"),
        ("!a", 1, "found '!'; write not"),
        ("a & b", 3, "found '&'; write and"),
        ("a || b", 3, r"found '\|'; write or"),
        ("x > 'rotate", 5, "expected a closing ', found the end of the line"),
        ('x == "a\nb"', 6, 'expected a closing ", found the end of the line'),
        ("x > 1e999", 5, "expected a number below 1.8e308, or inf, found '1e999'"),
        ("x \N{MINUS SIGN} 1", 3, r"found '\N{MINUS SIGN}' \(U\+2212\)"),
        ("x\x00", 2, r"found '\\x00'"),
        ("x\x1b[31m", 2, r"found '\\x1b'"),
        ("x.", 2, r"found '\.'"),
        ("x.1", 2, "expected an operator or the end, found '.1'"),
        ("min(1)", 1, "expected min to have 2 or more arguments, found 1"),
        ("abs()", 1, "expected abs to have 1 argument, found 0"),
        ("atan2(1, 2, 3)", 1, "expected atan2 to have 2 arguments, found 3"),
        ("1 + sqr(2)", 5, "expected a function like sqrt, found 'sqr'"),
        ("__import__('os')", 1, "expected a function like .*, found '__import__'"),
        ("x.__class__", None, ""),
        ("f(1", 1, "expected a function like"),
        ("alway(x < 1)", 1, "expected a function like always, found 'alway'"),
        ("abs(1", 6, r"expected '\)', found the end"),
        ("always x > 1", 8, r"expected '\(', found 'x'"),
        ("always[2, 1](x > 1)", 11, "expected a second bound of at least 2 s, found '1'"),
        ("always[-1, 1](x > 1)", 8, "expected a bound in seconds, 0 or more, found '-'"),
        ("always[inf, inf](x > 1)", 8, r"expected a finite first bound \[s\], found 'inf'"),
        ("always[0](x > 1)", 9, r"expected ',', found '\]'"),
        ("always[0, 1, 2](x)", 12, r"expected '\]', found ','"),
        ("a until[0, x] b", 12, "expected a bound in seconds, 0 or more, found 'x'"),
        ("not", 4, "expected a number or name, found the end"),
        ("and b", 1, "expected a number or name, found 'and'"),
    ],
)
def test_errors_name_the_column_what_was_expected_and_what_was_found(
    text: str, column: int | None, problem: str
) -> None:
    if column is None:
        assert parse_expression(text).names == (text,)
        return
    err = catch_error(text)
    assert err.column == column
    with pytest.raises(ExpressionError, match=rf"^--where: .*column \d+: .*{problem}"):
        raise err


def test_an_error_in_several_lines_names_the_line() -> None:
    err = catch_error("x > 1\nand y z")
    assert str(err).startswith("--where: line 2, column 7: ")
    assert draw_caret("x > 1\nand y z", err.column or 0) == "and y z\n      ^"


@pytest.mark.parametrize(
    "text",
    [
        "(" * 10_000,
        "-" * 10_000 + "1",
        "not " * 4_000 + "a",
        "abs(" * 4_000,
        "1" + "**1" * 5_000,
        "1" + "+1" * 5_000,
        "a" + " until a" * 2_000,
        "always(" * 2_000,
        "a" + "->a" * 5_000,
    ],
    ids=lambda text: text[:12],
)
def test_deep_nesting_is_one_clear_line(text: str) -> None:
    err = catch_error(text)
    assert str(err).endswith("expected at most 100 levels of nesting, found more")


def test_a_hundred_levels_are_allowed() -> None:
    nested = "(" * 99 + "x" + ")" * 99
    assert parse_expression(nested).root == parse_expression("x").root
    assert len(parse_expression(" and ".join(["x"] * 1_000)).root.list_children()) == 1_000


def test_long_texts_are_refused() -> None:
    err = catch_error("x" * 20_001)
    assert str(err) == "--where: column 1: expected at most 20,000 characters, found 20,001"


def test_long_words_are_cut_in_messages() -> None:
    assert len(str(catch_error("1 " + "x" * 10_000))) < 120


def test_the_caret_stands_below_the_column_of_long_lines() -> None:
    text = " and ".join(f"x{number} > 1" for number in range(50)) + " = 3"
    err = catch_error(text)
    line, caret = draw_caret(text, err.column or 0).splitlines()
    assert len(line) <= 78
    assert line[len(caret) - 1] == "="


def test_the_caret_survives_control_characters() -> None:
    assert draw_caret("x\x1b[31m", 2) == "x [31m\n ^"


def test_parsing_loads_no_numpy() -> None:
    code = "import sys, turtlelog.expressions as e; e.parse_expression('abs(x) > 1')\n"
    code += "sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
