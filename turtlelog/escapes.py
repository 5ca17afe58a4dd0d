"""Names of others, written so that they stay text: in a terminal, in Markdown, in a spreadsheet."""

import re
import unicodedata
from typing import Final

_UNUSUAL: Final = re.compile(r"[^ -~]")
_HIDDEN: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode's controls, invisible marks (of direction, width, joining), halves of characters, and
separators of lines and paragraphs: nobody sees them, and some change how the rest is seen."""

_INLINE: Final = re.compile(
    r"[\\`*|~$]"  # code, emphasis, cells, mathematics
    r"|<(?=[A-Za-z/!?])|&(?=#?\w+;)"  # HTML
    r"|\](?=[(\[:])"  # links and pictures
    r"|(?<=\w):(?=//)|(?<=www)\."  # addresses, which become links by themselves
    r"|(?<![^\W_])_|_(?![^\W_])"  # emphasis, which no underscore within a word begins
)
_BLOCK: Final = re.compile(r"^(\d{1,9}(?=[.)](?:\s|$))|(?=[-+=>#]))")
_FORMULA: Final = re.compile(r"\s*'*\s*[=+\-@\uff0b\uff0d\uff1d\uff20]")
_HARMLESS: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|-")


def escape_controls(text: str, *, keep: str = "") -> str:
    r"""Return text that cannot steer a terminal: `\x1b`, `\n`, `\u202e` for what is not seen.

    Args:
        text: Of anybody.
        keep: Characters that stay, as the ends of lines of a text of our own.
    """

    def escape(found: re.Match[str]) -> str:
        letter = found[0]
        if letter in keep or unicodedata.category(letter) not in _HIDDEN:
            return letter
        return letter.encode("unicode_escape").decode()

    return _UNUSUAL.sub(escape, text)


def escape_markdown(text: str, *, starts_line: bool = False) -> str:
    """Return text as Markdown that shows it as it is, in one line.

    Args:
        text: Of anybody.
        starts_line: Whether it stands where a heading, a list or a quotation could begin.
    """
    inline = _INLINE.sub(r"\\\g<0>", escape_controls(" ".join(text.split())))
    return _BLOCK.sub(r"\1\\", inline) if starts_line else inline


def fence_markdown(text: str) -> str:
    """Return lines of text as a block of Markdown that no line of them ends."""
    longest = max(map(len, re.findall("`+", text)), default=0)
    fence = "`" * max(longest + 1, 3)
    return f"{fence}\n{text}\n{fence}"


def guard_cell(cell: object) -> object:
    """Return a cell of a CSV table that no spreadsheet takes for a formula.

    Where a text would be one, an apostrophe stands before it. Numbers are never changed, nor is a
    text that is one.
    """
    if not isinstance(cell, str) or not _FORMULA.match(cell) or _HARMLESS.fullmatch(cell):
        return cell
    return f"'{cell}"
