"""How pages are worded: their sentences, the words that are not written, and counts of both.

To print the counts of README and docs: make words.
"""

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from statistics import median
from typing import Final, Literal

ROOT: Final = Path(__file__).parents[2]
PAGES: Final = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
"""README and docs. The words of json.md are those of the answers' docstrings."""

LONGEST: Final = 35
"""Words of a sentence: readers lose the subject of a longer one."""

USUAL: Final = 17
"""Words of the median sentence of a page, a little below the 20 that a sentence should have."""

INSTEAD: Final = {
    r"^Of\b": 'begin with the subject: "A run ..."',
    r"^Where\b.*[^?]$": "If, When, or the subject",
    r"^What (is|a|the|it|does)\b.*[^?]$": "begin with the subject",
    r"\b(some|any)body's\b|\bother people's\b": "third-party",
    r"\b(is|are|was|were|be) told\b": "given, named, printed, distinguished",
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


@dataclass(frozen=True, slots=True)
class WordCounts:
    """What a page is held to.

    Attributes:
        words: Words of its sentences.
        median: Words of its median sentence; 0 if it has none.
        long: Sentences and cells of more than `LONGEST` words.
        turned: Sentences that begin with "Of" or "Where".
        forbidden: Other words and patterns of `INSTEAD`, printed lines included.
    """

    words: int
    median: float
    long: int
    turned: int
    forbidden: int


def count_words(text: str) -> WordCounts:
    """Return how many words a page has, and how many faults of each kind."""
    sentences = list_sentences(text)
    faults = find_hard_words([*sentences, *list_printed(text)], "")
    lengths = [one.count_words() for one in sentences if one.kind == "sentence"]
    long = sum(": cut in two: " in fault for fault in faults)
    turned = sum(re.match(r":\d+: '(Of|Where)\b", fault, re.I) is not None for fault in faults)
    return WordCounts(
        words=sum(one.count_words() for one in sentences),
        median=median([count for count in lengths if count > 1] or [0]),
        long=long,
        turned=turned,
        forbidden=len(faults) - long - turned,
    )


def list_counts(pages: Sequence[Path]) -> list[str]:
    """Return the lines of a table of pages, then each fault with what to write."""
    names = [field.name for field in fields(WordCounts)]
    lines = [f"{'page':20}" + "".join(f"{name:>11}" for name in names)]
    faults = []
    for page in pages:
        text = page.read_text("utf-8")
        lines.append(f"{page.name:20}" + "".join(f"{n:11g}" for n in astuple(count_words(text))))
        faults += find_hard_words([*list_sentences(text), *list_printed(text)], page.name)
    return lines + faults


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


if __name__ == "__main__":
    sys.stdout.write("\n".join(list_counts(PAGES)) + "\n")
