"""Pages, help and printed answers are in plain words: short sentences, one term for one thing."""

from itertools import chain
from pathlib import Path
from typing import Final

import pytest

from tests.cli.conftest import Call, call as call
from tests.docs.plain_words import (
    INSTEAD,
    LONGEST,
    PAGES,
    USUAL,
    WordCounts,
    count_words,
    find_hard_words,
    list_counts,
    list_help,
    list_printed,
    list_sentences,
)
from turtlelog.cli.app import app


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_are_in_plain_words(page: Path) -> None:
    text = page.read_text("utf-8")
    assert find_hard_words([*list_sentences(text), *list_printed(text)], page.name) == []
    counts = count_words(text)
    assert (counts.long, counts.turned, counts.forbidden) == (0, 0, 0)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_sentences_of_a_page_are_short(page: Path) -> None:
    assert count_words(page.read_text("utf-8")).median <= USUAL


def test_help_is_in_plain_words(call: Call) -> None:
    """The modules of all commands are loaded, and their whole help is laid out."""
    helps = {name: call(name, "--help-all").out for name in app if not name.startswith("-")}
    faults = [find_hard_words(list_help(text), f"turtlelog {name}") for name, text in helps.items()]
    assert [*chain.from_iterable(faults)] == []


EXAMPLES: Final = {
    "Of a run the end is read.": "The end of a run is read.",
    "Where none fits, it stops.": "If none fits, it stops.",
    "What the log shows is named.": "What does the log show?",
    "It reads somebody's bag.": "It reads third-party bags.",
    "The clock is told.": "The clock is printed.",
    "Times are read as asked.": "Times are read as given.",
    "The loop as built is late.": "The loop as recorded is late.",
    "Poses are read by line.": "Poses are linearly interpolated.",
    "It waits for good.": "It waits without end.",
    "It checks formulas over time.": "It checks temporal-logic formulas.",
    "A file was expected, found none.": "Name a file.",
    "The grain is 1 mm.": "The resolution is 1 mm.",
    "It hangs on the start.": "It depends on the start.",
    "It says how sure it is.": "It gives its confidence.",
    "A lagged robot drives.": "A robot model drives.",
    "One mechanism causes it.": "One effect causes it.",
    "It costs next to nothing.": "It costs 9 bytes.",
    "That is no success.": "That has no value.",
    "A push moves it.": "A disturbance moves it.",
    "It is a riddle.": "It is unknown.",
    "Draw so many rows.": "Draw as many rows.",
    "The start backlog is 5.": "The initial queue is 5.",
    "A stretch is cut.": "A segment is cut.",
    "It swings around.": "It oscillates.",
    "The log tells the gain.": "The log shows the gain.",
}
"""A sentence for each entry of INSTEAD, in its order, and one that is not meant by it."""


@pytest.mark.parametrize(("pattern", "example"), [*zip(INSTEAD, EXAMPLES, strict=True)])
def test_what_is_forbidden_is_found(pattern: str, example: str) -> None:
    for text in (example, EXAMPLES[example]):
        faults = find_hard_words(list_sentences(f"First.\n\n{text}\n"), "page.md")
        meant = f": write: {INSTEAD[pattern]}"
        found = [fault.startswith("page.md:3: ") for fault in faults if fault.endswith(meant)]
        assert found == ([True] if text == example else [])


@pytest.mark.parametrize(("words", "faults"), [(LONGEST, 0), (LONGEST + 1, 1)])
def test_a_sentence_that_is_too_long_is_found(words: int, faults: int) -> None:
    text = f"Short.\n{'word ' * (words - 1)}`a b\nc`. Short.\n"
    assert len(find_hard_words(list_sentences(text), "page.md")) == faults


def test_code_and_names_are_no_words() -> None:
    text = "Keys: `loop.start_backlog`.\n\n```toml\npush = 1\n```\n\n    swings\n\nEnd of it.\n"
    assert [one.text for one in list_sentences(text)] == ["Keys: code.", "End of it."]
    assert [one.line for one in list_sentences(text)] == [1, 9]


def test_a_sentence_ends_at_its_point_and_not_at_an_initial() -> None:
    text = "By S. Balasubramanian et al. in 2015. turtlelog computes it. Done?\n"
    sentences = [one.text for one in list_sentences(text)]
    assert sentences == ["By S. Balasubramanian et al. in 2015.", "turtlelog computes it.", "Done?"]


def test_what_commands_print_is_read() -> None:
    text = "A.\n\n```console\n$ turtlelog run as built\nrun: as built\n```\n"
    assert find_hard_words(list_printed(text), "page.md") == [
        "page.md:5: 'as built': write: as recorded"
    ]


def test_faults_of_a_page_are_counted_by_kind() -> None:
    long = f"A {'word ' * LONGEST}ends."
    text = f"Of six runs two end. Where it ends, it stops. It swings. {long}\n\n| Of it |\n"
    assert count_words(text) == WordCounts(
        words=5 + 5 + 2 + LONGEST + 2 + 2, median=5, long=1, turned=2, forbidden=1
    )


def test_each_page_has_a_line_of_counts() -> None:
    lines = list_counts(PAGES[:2])
    assert [line.split()[0] for line in lines] == ["page", "README.md", "architecture.md"]
