"""Escape foreign text for a terminal, Markdown or a spreadsheet; hide secrets; guard HTML pages.

No name can control the program that shows it. A URL is shown without password and signature.
"""

import re
import unicodedata
from collections.abc import Iterable
from typing import Final

_UNUSUAL: Final = re.compile(r"[^ -~]")
_HIDDEN: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories: control characters, invisible marks (of direction, width, joining),
surrogates, and separators of lines and paragraphs. These characters are invisible, and some change
how other text looks."""

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
"""Scheme of a URL. A scheme has at least two letters, because `C:` is a drive. fsspec has schemes
with `_`, for example `async_wrapper`. Known schemes have up to 20 letters. Without a limit, the
search in a long word starts again at each letter."""

URL: Final = re.compile(rf"(?:{_SCHEME}::){{0,8}}{_SCHEME}://")
"""Beginning of a URL. URLs can be nested: `simplecache::https://`, rarely in a third. The limit
keeps the search short."""

_LOGIN: Final = (
    r"(?:[^\s/?#]{0,1000}@"  # up to the last @ before the path
    r"|[^\s:/?#@'\"<>`\[]{1,200}:(?!\d*(?!\w))(?:\S{0,1000}@|[^/?#\n]{0,200}@))?"
)
"""User and password in a sentence. A password may contain quotes; behind `user:` it may also
contain `/` or blanks. A number behind the colon is a port. Without the limits, the search in a long
word starts again at each URL."""

_IN_TEXT: Final = re.compile(
    URL.pattern
    + _LOGIN
    + r"(?:[^\s?#]{0,1000}[?#]\S*(?<![.,;:!?)'\"<>`])|[^\s'\"<>`]*(?<![.,;:!?)]))"
)
"""A URL within a sentence, without the sentence's punctuation behind it. Quotes in the query, or in
a path before the query, belong to the URL."""

_LONG_WORD: Final = re.compile(r"\S{1000,}")
"""A word that may contain a longer password than `_LOGIN` finds."""

_LINK: Final = re.compile(rf"::(?={_SCHEME}(?:::|://))")
"""Separator between two URLs of a chain; a password or address may also contain `::`."""

_PORT: Final = re.compile(r"(?:[^:]*|\[[^]]*\])(?::\d*)?|arn:.*")
"""A host, with or without a port. Text with another colon is a name and a password. S3 has bucket
names with colons, which begin with `arn:`."""

_SHORT: Final = 4
"""Smallest length of a password or query value that is searched within a message. Shorter text is
part of many words."""


def escape_controls(text: str, *, keep: str = "") -> str:
    r"""Return text that cannot control a terminal: `\x1b`, `\n`, `\u202e` for invisible characters.

    Args:
        text: Text from any source.
        keep: Characters that are not escaped, for example line ends of trusted text.
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
    """Return text as Markdown that shows the text unchanged, in one line.

    Args:
        text: Text from any source.
        starts_line: Whether a heading, list or quotation could begin at the place of the text.
    """
    inline = _INLINE.sub(r"\\\g<0>", escape_controls(" ".join(text.split())))
    return _BLOCK.sub(r"\1\\", inline) if starts_line else inline


def fence_markdown(text: str) -> str:
    """Return lines of text as a fenced block of Markdown that no line of the text can end."""
    longest = max(map(len, re.findall("`+", text)), default=0)
    fence = "`" * max(longest + 1, 3)
    return f"{fence}\n{text}\n{fence}"


def escape_latex(text: str) -> str:
    """Return text in one line of LaTeX, with its special characters escaped."""
    special = {character: f"\\{character}" for character in "&%$#_{}"}
    special |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    special |= {"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"}
    line = " ".join(text.splitlines())
    escaped = "".join(special.get(letter, letter) for letter in escape_controls(line))
    return re.sub(r"\\textasciicircum{}(\d+)", r"\\textsuperscript{\1}", escaped)


def guard_cell(cell: object) -> object:
    """Return a cell of a CSV table that no spreadsheet reads as a formula.

    A text that looks like a formula gets an apostrophe in front. Numbers, and texts that are
    numbers, do not change.
    """
    if not isinstance(cell, str) or not _FORMULA.match(cell) or _HARMLESS.fullmatch(cell):
        return cell
    return f"'{cell}"


def show_url(url: str) -> str:
    """Return a URL without the parts that may be secret: user, password, query and fragment."""
    return "::".join(map(_show_one, _LINK.split(url)))


def _show_one(url: str) -> str:
    scheme, mark, rest = url.partition("://")
    login = _find_login(rest) if mark else ""
    place = re.split(r"[?#]", rest[len(login) :], maxsplit=1)[0]
    return scheme + mark + ("" if login.endswith("@") or not login else "...") + place


def _find_login(rest: str) -> str:
    """Return user, password and `@` before the host. Without a host, return the whole text."""
    # A password may contain `/`, as in secret keys of S3, or `?`, which usually follow a host.
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
        text: Text from a library or the user.
        url: URL that the message is about. The user, password and query of this URL are also hidden
            outside a URL.
    """
    text = _LONG_WORD.sub(lambda found: _drop_logins(found[0]), text)
    text = _IN_TEXT.sub(lambda found: show_url(found[0]), text)
    for secret in sorted(_list_secrets(url), key=len, reverse=True):
        text = text.replace(secret, "...")
    return text


def _drop_logins(word: str) -> str:
    """Return a word without the text between its first `://` and its last `@`."""
    found, last = URL.search(word), word.rfind("@")
    if found is None or last < found.end():
        return word
    return word[: found.end()] + word[last + 1 :]


def cut_text(text: str, most: int) -> str:
    """Return the first characters of a text. A URL that must be cut is reduced to its scheme.

    If the end of a password were cut off, `show_url` could not recognise the password.
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


_PAGE_SOURCES: Final = {
    "default_src": "'none'",
    "style_src": "'unsafe-inline'",
    "img_src": "data: blob:",
    "base_uri": "'none'",
    "form_action": "'none'",
}
"""Allowed sources. Bokeh and Rerun write styles while they draw; other rules prevent styles from
loading anything."""


def write_policy(scripts: Iterable[str], **more: str) -> str:
    """Return a content policy that allows the page's scripts by their hashes, and nothing remote.

    Data blocks, for example of JSON, are not scripts. `more` are further sources by directive, with
    `_` for `-`, as in `connect_src="'self'"`.
    """
    from base64 import b64encode  # only pages need these
    from hashlib import sha256

    hashes = (b64encode(sha256(code.encode()).digest()).decode() for code in scripts)
    ours = {"script_src": " ".join(f"'sha256-{found}'" for found in hashes), **_PAGE_SOURCES}
    sources = {
        name: f"{ours.get(name, '')} {more.get(name, '')}".strip() for name in {**ours, **more}
    }
    return "; ".join(
        f"{name.replace('_', '-')} {source}" for name, source in sources.items() if source
    )


def write_policy_tag(*scripts: str) -> str:
    """Return the policy as a tag for the head of a page, which must precede all that loads."""
    policy = write_policy(scripts)
    return f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
