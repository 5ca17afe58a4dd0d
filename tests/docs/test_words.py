"""Pages, help and printed answers are in plain words: short sentences, one term for one thing."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Final, Literal

import pytest

from tests.cli.conftest import Call, call as call
from turtlelog.cli.app import app

ROOT: Final = Path(__file__).parents[2]
PAGES: Final = [
    ROOT / "README.md",
    *(page for page in sorted((ROOT / "docs").glob("*.md")) if page.name != "json.md"),
]
"""Pages that people write; json.md is generated."""

LONGEST: Final = 35
"""Words of a sentence: readers lose the subject of a longer one."""

USUAL: Final = 17
"""Words of the median sentence of a page, a little below the 20 that a sentence should have."""

INSTEAD: Final = {
    r"^Of (a|an|the|any|all|such|some)\b": 'begin with the subject: "A run ..."',
    r"^Where\b.*[^?]$": "If, When, or the subject",
    r"^What (is|a|the|it|does)\b.*[^?]$": "begin with the subject",
    r"\b(some|any)body's\b|\bother people's\b": "third-party",
    r"\b(is|are) told\b": "is given, is named, is printed",
    r"\bas asked\b": "as given",
    r"\bas built\b": "as recorded",
    r"\bby line\b": "linearly interpolated",
    r"\bfor good\b": "for ever, without end",
    r"\bformulas? over time\b": "temporal-logic formula",
    r"\bfound (none|another)\b": "what is wrong, why, and what to type",
    r"\bgrain\b": "resolution",
    r"\bhangs? on\b": "depends on",
    r"\bhow sure\b": "confidence",
    r"\blagged robot\b": "robot model",
    r"\bmechanisms?\b": "cause",
    r"\bnext to nothing\b": "how much, as a number",
    r"\bno success\b": "is refused, fails, has no value",
    r"\bpush(es|ed)?\b": "disturbance, disturbs",
    r"\briddle\b": "say what is unknown",
    r"\bso many\b": "the number, or N",
    r"\bstart backlogs?\b": "initial queue",
    r"\bstretch(es)?\b": "segment, part",
    r"\bswings?\b": "oscillation, oscillates",
    r"\b(log|file|bag|recording|line|note)s? tells?\b": "shows, contains",
}
"""What is not written, ignoring case, and what is."""

_SENTENCE: Final = re.compile(
    r".+?(?:(?<!\b[A-Z])(?<!\bal)(?<!\bProc)[.!?][)\"'*_]*(?=\s)|\Z)", re.S
)


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence, a cell of a table or a printed line, and the line in which it begins."""

    line: int
    text: str
    kind: Literal["sentence", "cell", "line"] = "sentence"

    def count_words(self) -> int:
        return sum(re.search(r"\w", word) is not None for word in self.text.split())


def list_sentences(text: str) -> list[Sentence]:
    """Return the sentences of Markdown outside of code, a run of inline code as one word."""
    found = []
    for line, block, kind in _list_blocks(_blank_code(text)):
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", _hide, block))
        for match in _SENTENCE.finditer(plain):
            begin = match.start() + len(match[0]) - len(match[0].lstrip())
            sentence = " ".join(match[0].split())
            if sentence:
                at = line + plain.count("\n", 0, begin)
                found.append(Sentence(line=at, text=sentence, kind=kind))
    return found


def _hide(code: re.Match[str]) -> str:
    return "code" + "\n" * code[0].count("\n")


def _blank_code(text: str) -> str:
    """Return Markdown with as many lines, those of code and of HTML empty."""
    pattern = r"^```.*?^```$|<!--.*?-->|(?<=\n\n) {4}.*?(?=\n\n|\Z)|</?\w[^>]*>"
    return re.sub(pattern, lambda found: "\n" * found[0].count("\n"), text, flags=re.M | re.S)


def _list_blocks(text: str) -> Iterator[tuple[int, str, Literal["sentence", "cell"]]]:
    """Yield paragraphs, entries of lists and cells: their first line, their text, what they are."""
    block: list[str] = []
    begin = 1
    for number, line in enumerate([*text.split("\n"), ""], 1):
        entry = re.match(r"\s*(?:[-*]|\d+\.) ", line)
        if not line.strip() or line.startswith(("#", "|", "![")) or entry:
            if block:
                yield begin, "\n".join(block), "sentence"
            block = []
        if line.startswith("|"):
            for cell in re.split(r"(?<!\\)\|", line.strip("|")):
                yield number, cell, "cell"
        elif line.startswith("!["):
            yield number, line, "cell"
        elif line.strip() and not line.startswith("#"):
            begin = begin if block else number
            block.append(line[entry.end() :] if entry else line)


def list_printed(text: str) -> list[Sentence]:
    """Return the lines that the commands on a page print."""
    found = []
    for match in re.finditer(r"^```(?:console|text)\n(.*?)^```$", text, re.M | re.S):
        lines = list_lines(match[1], first=text.count("\n", 0, match.start(1)) + 1)
        found += [line for line in lines if not line.text.startswith("$ ")]
    return found


def list_lines(printed: str, first: int = 1) -> list[Sentence]:
    """Return the lines that a command printed."""
    lines = enumerate(printed.splitlines(), first)
    return [Sentence(line=at, text=line, kind="line") for at, line in lines]


def list_help(text: str) -> list[Sentence]:
    """Return the sentences of a help text: its paragraphs, and what its panels say of options."""
    lines = []
    for line in text.splitlines():
        in_panel = re.fullmatch(r"│ (.*?) *│", line)
        entry = re.match(r"(?:\*  | {3})?\S.*?(?:  +|$)", in_panel[1]) if in_panel else None
        plain = line if in_panel is None else in_panel[1][entry.end() if entry else 0 :]
        lines.append(f"- {plain}" if entry else plain if "─" not in line else "")
    return list_sentences("\n".join(line.strip() for line in lines))


def find_hard_words(sentences: list[Sentence], name: str) -> list[str]:
    """Return what is forbidden in sentences: where it is, and what to write."""
    faults = []
    for sentence in sentences:
        for pattern, words in INSTEAD.items():
            found = re.search(pattern, sentence.text, re.I)
            if found and (sentence.kind == "sentence" or not pattern.startswith("^")):
                faults.append(f"{name}:{sentence.line}: {found[0]!r}: write: {words}")
        count = sentence.count_words()
        if count > LONGEST and sentence.kind != "line":
            beginning = " ".join(sentence.text.split()[:6])
            faults.append(f"{name}:{sentence.line}: {count} words: cut in two: {beginning} ...")
    return faults


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_are_in_plain_words(page: Path) -> None:
    text = page.read_text("utf-8")
    assert find_hard_words([*list_sentences(text), *list_printed(text)], page.name) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_sentences_of_a_page_are_short(page: Path) -> None:
    sentences = list_sentences(page.read_text("utf-8"))
    counts = [one.count_words() for one in sentences if one.kind == "sentence"]
    assert median(count for count in counts if count > 1) <= USUAL


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
