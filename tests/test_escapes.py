import csv
import io
import re
import tracemalloc
import unicodedata

import pytest
from hypothesis import example, given, strategies as st
from markdown_it import MarkdownIt

import turtlelog as tl
from turtlelog.errors import LogError
from turtlelog.escapes import escape_controls, escape_markdown, fence_markdown, guard_cell

MARKDOWN = MarkdownIt("commonmark").enable(["table", "strikethrough"])

HIDDEN = {
    "C0": [*map(chr, range(0x20))],
    "DEL and C1": [*map(chr, range(0x7F, 0xA0))],
    "bidirectional": [*"\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"],
    "invisible": [*"\u00ad\u180e\u200b\u200c\u200d\u2060\u2064\ufeff\U000e0041"],
    "line ends": [*"\u2028\u2029"],
    "halves": ["\ud800", "\udcff"],
}
SEEN = "a \u00e4\u00df\u03b1\u05d0\u0627\u4e2d\U0001f422\u0301~!\\\"'`|<>&"


@pytest.mark.parametrize("kind", HIDDEN)
def test_what_nobody_sees_is_escaped(kind: str) -> None:
    for letter in HIDDEN[kind]:
        shown = escape_controls(f"a{letter}b")
        assert re.fullmatch(r"a\\(t|n|r|x..|u....|U........)b", shown), repr(letter)
        assert eval(f"'{shown}'") == f"a{letter}b"


@pytest.mark.thorough
@given(st.text())
def test_what_is_seen_stays_and_escaping_twice_is_escaping_once(text: str) -> None:
    assert escape_controls(SEEN) == SEEN
    shown = escape_controls(text)
    assert not {"Cc", "Cf", "Cs", "Zl", "Zp"} & set(map(unicodedata.category, shown))
    assert escape_controls(shown) == shown
    assert escape_controls("a\nb\t", keep="\n") == "a\nb\\t"


def test_millions_of_letters_are_escaped_in_little_memory() -> None:
    text = "\U0001f422" * 10**5 + "\x1b"
    tracemalloc.start()
    try:
        assert escape_controls(text) == text[:-1] + r"\x1b"
        assert tracemalloc.get_traced_memory()[1] < 16 * len(text)
    finally:
        tracemalloc.stop()


def test_errors_are_one_line_that_cannot_steer_a_terminal() -> None:
    assert str(LogError("a\x1b[2J\u202e\nb: expected x")) == r"a\x1b[2J\u202e\nb: expected x"


NASTY = [
    *("=cmd()|' /C calc'!A0", "+1+1", "-1+1", "@SUM(A1)", "\t=1", " =1", "\uff1d1", "\n=1", "'=1"),
    *(
        "|a|b|",
        "<script>alert(1)</script>",
        "<!-- a",
        "a <b> c",
        "&lt;b&gt;",
        "`a`",
        "``` \na",
        "**a**",
    ),
    *("*a*", "_a_", "__a__", "~~a~~", "# a", "## a", "- a", "+ a", "* a", "> a", "1. a", "12) a"),
    *("---", "===", "a\n===", "[a](http://b)", "![a](b)", "[a][b]", "[a]: b", "<http://a>", "a\\"),
    *(
        "\\|",
        "    a",
        "a\n\n# b",
        "a  \nb",
        "| - |",
        "$a$",
        "C:\\a",
        "http://a.b",
        "&#35; a",
        "a&copy;",
    ),
]


def show_markdown(text: str) -> str:
    """Return what a reader of Markdown sees, and fail where it is more than text."""
    html = MARKDOWN.render(text)
    assert not re.search(r"<(?!/?(p|table|thead|tbody|tr|th|td)\b)", html), html
    seen = re.sub(r"</?\w[^>]*>", "", html).strip()
    for entity, letter in (("&lt;", "<"), ("&gt;", ">"), ("&quot;", '"'), ("&amp;", "&")):
        seen = seen.replace(entity, letter)
    return seen


@pytest.mark.parametrize("name", NASTY)
def test_a_name_in_markdown_is_text(name: str) -> None:
    shown = " ".join(escape_controls(" ".join(name.split())).split())
    assert show_markdown(escape_markdown(name, starts_line=True)) == shown
    table = f"| a | b |\n| - | - |\n| {escape_markdown(name)} | c |\n"
    assert [line for line in show_markdown(table).split("\n") if line] == ["a", "b", shown, "c"]


@given(st.text(alphabet="ab1.)-+=># \t`*_~[]()<>!|\\&;:/$", max_size=12))
@example("a_b_")
def test_any_name_in_markdown_is_text(name: str) -> None:
    shown = " ".join(name.split())
    assert show_markdown(escape_markdown(name, starts_line=True)) == shown


@pytest.mark.parametrize("text", ["a", "```\n# b", "a\n``````\nb", "`"])
def test_no_line_of_a_fenced_text_ends_it(text: str) -> None:
    html = MARKDOWN.render(f"{fence_markdown(text)}\n\nafter")
    assert html == f"<pre><code>{text}\n</code></pre>\n<p>after</p>\n"


@pytest.mark.parametrize("name", [*NASTY, "a", "-", "-1.5", "+3", "1e-3", "/turtle1/pose", "ok"])
def test_a_csv_cell_is_no_formula_and_gives_the_text_back(name: str) -> None:
    column = tl.compare.Column(title="n")
    table = tl.compare.Table(title="t", columns=(column,), rows=((name,), (-1.5,)))
    _, (cell,), (number,) = csv.reader(io.StringIO(tl.draw.format_table(table, "csv"), newline=""))
    assert number == "-1.5"
    if cell != name:
        assert cell == f"'{name}"
    else:
        first = name.replace("'", "").strip()[:1]
        assert first not in set("=+-@\uff1d\uff0b\uff0d\uff20") or re.fullmatch(
            "-|[+-][0-9.]+", name
        )


def test_numbers_are_no_text_and_stay() -> None:
    for number in (-1.5, -3, float("-inf"), None, True):
        assert guard_cell(number) is number
