"""Text of others that stays text, in a terminal, in Markdown, in a spreadsheet, and keeps secrets.

Names cannot steer what shows them. A URL is shown without its password and its signature.
"""

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
_FORMULA: Final = re.compile(r"\s*+(?:'++\s*+)?[=+\-@\uff0b\uff0d\uff1d\uff20]")
_HARMLESS: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|-")

_SCHEME: Final = r"[A-Za-z][A-Za-z0-9+._-]{1,40}"
"""At least two letters: `C:` is a drive. fsspec has schemes with `_`, as `async_wrapper`. Known
schemes have up to 20 letters; without a limit a long word is searched from each of its letters."""

URL: Final = re.compile(rf"(?:{_SCHEME}::){{0,8}}{_SCHEME}://")
"""`simplecache::https://` is one within the other, rarely in a third; the limit is as above."""

_LOGIN: Final = (
    r"(?:[^\s/?#]{0,1000}@"  # up to the last @ before the path
    r"|[^\s:/?#@'\"<>`\[]{1,200}:(?!\d*(?!\w))(?:\S{0,1000}@|[^/?#\n]{0,200}@))?"
)
"""User and password in a sentence. A password may have quotes; behind `user:` also `/`, or blanks.
A number behind the colon is a port. Without the limits a long word is searched from each URL."""

_IN_TEXT: Final = re.compile(
    URL.pattern
    + _LOGIN
    + r"(?:[^\s?#]{0,1000}[?#]\S*(?<![.,;:!?)'\"<>`])|[^\s'\"<>`]*(?<![.,;:!?)]))"
)
"""A URL within a sentence, whose marks are behind it. In a query, as in a path before it, quotes
are letters like others."""

_LONG_WORD: Final = re.compile(r"\S{1000,}")
"""A password in it may be longer than `_LOGIN` looks for."""

_LINK: Final = re.compile(rf"::(?={_SCHEME}(?:::|://))")
"""Between two of such a chain; `::` may also be in a password or an address."""

_PORT: Final = re.compile(r"(?:[^:]*|\[[^]]*\])(?::\d*)?|arn:.*")
"""A host, with a port or without: what has another colon is a name and a password. S3 has names of
buckets with colons, which begin with `arn:`."""

_SHORT: Final = 4
"""Characters of a password or a value of a query at least, to be looked for within a message: what
is shorter is part of many words."""


def escape_controls(text: str, *, keep: str = "") -> str:
    r"""Return text that cannot steer a terminal: `\x1b`, `\n`, `\u202e` for what is not seen.

    Args:
        text: Of anybody.
        keep: Characters that stay, as the ends of lines of a text of our own.
    """
    if not _UNUSUAL.search(text):
        return text
    # Each letter once: a text of others may have millions.
    hidden = {
        letter: letter.encode("unicode_escape").decode()
        for letter in {*text} - {*keep}
        if unicodedata.category(letter) in _HIDDEN
    }
    return text.translate(str.maketrans(hidden)) if hidden else text


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


def show_url(url: str) -> str:
    """Return a URL without what may be secret: user, password, query and fragment."""
    return "::".join(map(_show_one, _LINK.split(url)))


def _show_one(url: str) -> str:
    scheme, mark, rest = url.partition("://")
    login = _find_login(rest) if mark else ""
    place = re.split(r"[?#]", rest[len(login) :], maxsplit=1)[0]
    return scheme + mark + ("" if login.endswith("@") or not login else "...") + place


def _find_login(rest: str) -> str:
    """Return user and password before the host, with their `@`; the whole where there is no host.

    A password may hold what belongs behind a host, as `/` in the secret keys of S3 and `?`.
    """
    host = re.split(r"[/?#]", rest, maxsplit=1)[0]
    if "@" in host:
        return host[: host.rindex("@") + 1]
    if _PORT.fullmatch(host):
        return ""
    first = rest.find("@")
    if first < 0:
        return host
    behind = re.search(r"[?#]|$", rest[first:])
    return rest[: rest.rindex("@", 0, first + behind.start()) + 1]  # type: ignore[union-attr]


def hide_secrets(text: str, url: str = "") -> str:
    """Return a message with its URLs as `show_url` returns them.

    Args:
        text: What a library or the user wrote.
        url: What it is about: its user, password and query are hidden also where they stand alone.
    """
    text = _LONG_WORD.sub(lambda found: _drop_logins(found[0]), text)
    text = _IN_TEXT.sub(lambda found: show_url(found[0]), text)
    for secret in sorted(_list_secrets(url), key=len, reverse=True):
        text = text.replace(secret, "...")
    return text


def _drop_logins(word: str) -> str:
    """Return a word without what stands between its first URL's `://` and its last `@`."""
    found, last = URL.search(word), word.rfind("@")
    if found is None or last < found.end():
        return word
    return word[: found.end()] + word[last + 1 :]


def cut_text(text: str, most: int) -> str:
    """Return the first letters of a text; of a URL that is cut, the scheme alone.

    Where the end of a password is cut off, nothing tells that it is one.
    """
    if len(text) <= most:
        return text
    kept = text[:most]
    start = most - len(re.split(r"\s", kept)[-1])
    found = URL.search(kept, start)
    return kept if found is None else kept[: found.end()]


def _list_secrets(url: str) -> set[str]:
    from urllib.parse import unquote  # Only for a message about a URL.

    found: set[str] = set()
    for one in _LINK.split(url):
        rest = one.partition("://")[2]
        login = _find_login(rest)
        password = login.removesuffix("@").partition(":")[2]
        query = re.split(r"[?#]", rest[len(login) :], maxsplit=1)[1:]
        values = [part.partition("=")[2] or part for text in query for part in text.split("&")]
        # A library takes what stands before the first `/` for the host.
        found |= {login, *login.split("/"), password, *password.split("/"), *query, *values}
    return {one for text in found for one in (text, unquote(text)) if len(one) >= _SHORT}
