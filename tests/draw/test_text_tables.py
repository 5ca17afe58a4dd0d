import pytest

import turtlelog as tl

NAMES = ("a_rather_long_name_of_a_run", "another-rather-long-name-of-a-run", "x" * 40)


def make_table(runs: int, *, joined: bool = False) -> tl.compare.Table:
    columns = [tl.compare.Column(title="signal"), tl.compare.Column(title="unit")]
    for number in range(runs):
        columns.append(tl.compare.Column(title=f"{NAMES[number % 3]}_{number}"))
        columns.append(tl.compare.Column(title="at", unit="s", digits=2, joined=joined))
    row: tuple[str | float, ...] = ("heading_error", "rad", *(0.125, 12.5) * runs)
    return tl.compare.Table(
        title="Title", columns=tuple(columns), rows=(row, row), notes=("word " * 40,)
    )


@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
@pytest.mark.parametrize("runs", [1, 2, 4, 12])
def test_a_table_fits_its_width_and_loses_nothing(width: int, runs: int) -> None:
    text = tl.draw.format_table(make_table(runs, joined=True), width=width)
    assert max(map(len, text.splitlines())) <= width
    assert text.count("0.125") == text.count("12.50") == 2 * runs
    figures = [line for line in text.splitlines() if line.startswith("heading_error")]
    assert all(line.count("0.125") == line.count("12.50") for line in figures)


def test_every_letter_of_a_broken_name_is_there() -> None:
    text = tl.draw.format_table(make_table(1), width=45)
    assert NAMES[0] not in text
    head = "".join(line.split(" s")[0] for line in text.split("-----")[0].splitlines()[2:])
    assert "a_rather_long_" in head
    assert "name_of_a_run_0" in head.replace(" ", "")


def test_a_table_that_fits_is_as_it_is_without_a_width() -> None:
    table = make_table(1)
    assert tl.draw.format_table(table, width=200).split() == tl.draw.format_table(table).split()
    assert tl.draw.format_table(table).splitlines()[2] == (
        "signal         unit  a_rather_long_name_of_a_run_0     at"
    )


def test_a_long_name_in_a_row_goes_on_below() -> None:
    columns = (tl.compare.Column(title="run"), tl.compare.Column(title="error", unit="m", digits=3))
    table = tl.compare.Table(title="T", columns=columns, rows=((NAMES[0], 0.5), ("b", 1.5)))
    assert tl.draw.format_table(table, width=26).splitlines()[5:] == [
        "a_rather_long_name_  0.500",
        "of_a_run",
        "b                    1.500",
    ]


def test_a_name_of_two_lines_stays_on_one() -> None:
    table = tl.compare.Table(
        title="a\nb", columns=(tl.compare.Column(title="c\nd"),), rows=(("e\nf",),)
    )
    assert tl.draw.format_table(table).splitlines() == [r"a\nb", "", r"c\nd", "----", r"e\nf"]


@pytest.mark.parametrize("width", [1, 8, 20])
def test_no_width_is_too_small_to_print(width: int) -> None:
    assert "0.125" in tl.draw.format_table(make_table(2), width=width)


def test_a_narrow_cell_breaks_between_words_and_not_at_a_decimal_point() -> None:
    table = tl.compare.Table(
        title="",
        columns=(tl.compare.Column(title="axis"), tl.compare.Column(title="gain")),
        rows=(("speed", "0.500 (0.500 to 0.500)"), ("rotate.settling_time", "1")),
    )
    lines = [line.split() for line in tl.draw.format_table(table, width=30).splitlines()]
    cells = [cell for line in lines for cell in line]
    assert "(0.500" in cells
    assert "0.500)" in cells
