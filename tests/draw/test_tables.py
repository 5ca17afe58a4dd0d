import csv
import io
from dataclasses import replace

import pytest

import turtlelog as tl
from turtlelog.errors import ShowError

TABLE = tl.compare.Table(
    title="100 % of_it",
    columns=(
        tl.compare.Column(title="run"),
        tl.compare.Column(title="error", unit="m", digits=3),
        tl.compare.Column(title="status"),
    ),
    rows=(("a|b", 0.12345, "ok"), ("longer", None, "not_reached")),
    notes=("A note.",),
)


def test_text_aligns_figures_to_the_right_and_words_to_the_left() -> None:
    assert tl.draw.format_table(TABLE).splitlines() == [
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
    lines = tl.draw.format_table(TABLE, "md").splitlines()
    assert lines[2:5] == [
        "| run | error [m] | status |",
        "| --- | ---: | --- |",
        r"| a\|b | 0.123 | ok |",
    ]


def test_csv_keeps_full_precision() -> None:
    rows = list(csv.reader(io.StringIO(tl.draw.format_table(TABLE, "csv"))))
    assert rows == [
        ["run", "error [m]", "status"],
        ["a|b", "0.12345", "ok"],
        ["longer", "", "not_reached"],
    ]


def test_a_status_is_in_words_for_people_and_a_name_for_programs() -> None:
    status = tl.measure.Status.NOT_REACHED
    table = replace(TABLE, rows=(("a", 1.0, status),))
    shown = [tl.draw.format_table(table, kind).rstrip() for kind in ("txt", "md", "tex")]
    assert all("not reached" in text for text in (*shown, table._repr_html_()))
    assert tl.draw.format_table(table, "csv").splitlines()[1] == "a,1.0,not_reached"
    assert table.rows[0][2] == "not_reached"


def test_latex_uses_booktabs_and_escapes_its_special_characters() -> None:
    text = tl.draw.format_table(TABLE, "tex")
    assert r"\caption{100 \% of\_it}" in text
    assert r"longer & - & not\_reached \\" in text
    assert all(rule in text for rule in (r"\toprule", r"\midrule", r"\bottomrule"))


def test_latex_units_stand_below_the_titles() -> None:
    lines = tl.draw.format_table(TABLE, "tex").splitlines()
    head = lines.index(r"    \toprule")
    assert lines[head + 1 : head + 3] == [r"    run & error & status \\", r"     & [m] &  \\"]


@pytest.mark.parametrize(
    ("value", "shown"), [(-0.5, "$-0.5$"), (2.5e-7, r"$2.5 \times 10^{-7}$"), (-3, "$-3$")]
)
def test_latex_numbers_have_a_minus_and_powers(value: float, shown: str) -> None:
    table = tl.compare.Table(title="t", columns=(tl.compare.Column(title="a"),), rows=((value,),))
    assert f"    {shown} \\\\\n" in tl.draw.format_table(table, "tex")


def test_no_name_is_a_command_to_latex() -> None:
    table = tl.compare.Table(
        title="t",
        columns=(tl.compare.Column(title="n"),),
        rows=(("[1pt]",), ("*",), ("a<b|c>\nd^2",)),
    )
    lines = tl.draw.format_table(table, "tex").splitlines()
    assert r"    {}[1pt] \\" in lines
    assert r"    {}* \\" in lines
    assert r"    a\textless{}b\textbar{}c\textgreater{} d\textsuperscript{2} \\" in lines
    assert "| a\\<b\\|c> d^2 |" in tl.draw.format_table(table, "md")


def test_a_wide_latex_table_spans_both_columns() -> None:
    wide = tl.compare.Table(title="t", columns=TABLE.columns, rows=(("x" * 60, 1.0, "ok"),))
    assert tl.draw.format_table(wide, "tex").startswith("\\begin{table*}\n")
    assert tl.draw.format_table(TABLE, "tex").startswith("\\begin{table}\n")


def test_an_unknown_format_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ShowError, match="expected one of txt, md, csv, tex, found 'html'"):
        tl.draw.format_table(TABLE, "html")


def test_a_new_group_of_rows_begins_after_an_empty_line() -> None:
    table = tl.compare.Table(
        title="t",
        columns=(tl.compare.Column(title="a"),),
        rows=(("x",), ("y",), ("z",)),
        breaks=(1,),
    )
    assert tl.draw.format_table(table).splitlines()[-4:] == ["x", "", "y", "z"]
    assert "    x \\\\\n    \\addlinespace\n    y \\\\\n" in tl.draw.format_table(table, "tex")
    assert tl.draw.format_table(table, "csv").splitlines() == ["a", "x", "y", "z"]


def test_latex_counts_and_labels_a_numbered_table_itself() -> None:
    table = tl.compare.tabulate_table1([tl.read_recording("recordings/paper/kp4.mcap")])
    text = tl.draw.format_table(table, "tex")
    assert r"\caption{Errors 15 s after the first sample}" in text
    assert text.count("Table 1") == 0
    assert r"\label{tab:table1}" in text
    assert tl.draw.format_table(table).startswith("Table 1: errors 15 s after the first sample")
