import csv
import io

import pytest

import turtlelog as tl
from turtlelog.errors import ShowError

TABLE = tl.Table(
    title="100 % of_it",
    columns=(
        tl.Column(title="run"),
        tl.Column(title="error", unit="m", digits=3),
        tl.Column(title="status"),
    ),
    rows=(("a|b", 0.12345, "ok"), ("longer", None, "not_reached")),
    notes=("A note.",),
)


def test_text_aligns_figures_to_the_right_and_words_to_the_left() -> None:
    assert tl.format_table(TABLE).splitlines() == [
        "100 % of_it",
        "",
        "run     error  status",
        "          [m]",
        "--------------------------",
        "a|b     0.123  ok",
        "longer      -  not_reached",
        "",
        "A note.",
    ]


def test_markdown_escapes_what_would_end_a_cell() -> None:
    lines = tl.format_table(TABLE, "md").splitlines()
    assert lines[2:5] == [
        "| run | error [m] | status |",
        "| --- | ---: | --- |",
        r"| a\|b | 0.123 | ok |",
    ]


def test_csv_keeps_full_precision() -> None:
    rows = list(csv.reader(io.StringIO(tl.format_table(TABLE, "csv"))))
    assert rows == [
        ["run", "error [m]", "status"],
        ["a|b", "0.12345", "ok"],
        ["longer", "", "not_reached"],
    ]


def test_latex_uses_booktabs_and_escapes_its_special_characters() -> None:
    text = tl.format_table(TABLE, "tex")
    assert r"\caption{100 \% of\_it}" in text
    assert r"longer & - & not\_reached \\" in text
    assert all(rule in text for rule in (r"\toprule", r"\midrule", r"\bottomrule"))


def test_an_unknown_format_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ShowError, match="expected one of txt, md, csv, tex, found 'html'"):
        tl.format_table(TABLE, "html")


def test_a_new_group_of_rows_begins_after_an_empty_line() -> None:
    table = tl.Table(
        title="t", columns=(tl.Column(title="a"),), rows=(("x",), ("y",), ("z",)), breaks=(1,)
    )
    assert tl.format_table(table).splitlines()[-4:] == ["x", "", "y", "z"]
    assert "    x \\\\\n    \\addlinespace\n    y \\\\\n" in tl.format_table(table, "tex")
    assert tl.format_table(table, "csv").splitlines() == ["a", "x", "y", "z"]
