"""Conversion of IDL schemas of ROS 2 and DDS to `ros2msg` text."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NoReturn

from turtlelog.errors import LogError

LONGEST_TEXT: Final = 2**19
"""Largest size of an IDL text with all its types [bytes]; the longest in ROS is a tenth of this."""

_DEEPEST: Final = 8  # nested modules or type aliases; ROS has two
_LONGEST_WORD: Final = 1024

_PART: Final = re.compile(r"^={3,}[ \t\r]*\n[ \t]*IDL:[^\n]*(?:\n|\Z)", re.MULTILINE)
_TOKEN: Final = re.compile(
    r"""//[^\n]*|/\*.*?\*/|^[ \t]*\#[^\n]*|\s+  # comments, what a preprocessor reads, blanks
    |(?P<word>(?:::)?[A-Za-z_]\w*(?:::[A-Za-z_]\w*)*)
    |(?P<number>[+-]?\.?\d[\w.]*(?:(?<=[eE])[+-]\d+)?)
    |(?P<text>L?"(?:[^"\\]|\\.)*+"|L?'(?:[^'\\]|\\.)*+')
    |(?P<open>/\*|L?["'])
    |(?P<sign><<|>>|[^\s\w])""",
    re.VERBOSE | re.DOTALL | re.MULTILINE | re.ASCII,
)

_KINDS: Final = {
    "boolean": "bool",
    "octet": "byte",
    "char": "char",
    "float": "float32",
    "double": "float64",
    "short": "int16",
    "long": "int32",
    "long long": "int64",
    "unsigned short": "uint16",
    "unsigned long": "uint32",
    "unsigned long long": "uint64",
    **{name: name for size in (8, 16, 32, 64) for name in (f"int{size}", f"uint{size}")},
    "string": "string",
    "wstring": "wstring",
}
_SEVERAL: Final = frozenset({"unsigned", "long", "short", "double"})
"""Words that may together form a type name."""

_NOT_READ: Final = frozenset({"union", "bitset", "bitmask", "interface", "valuetype", "native"})
_OTHER_BYTES: Final = frozenset({"optional", "mutable", "bit_bound"})
"""Annotations that change the encoding of a message."""
_BETWEEN: Final = frozenset({"msg", "srv", "action"})
"""Module names between package and type in ROS names."""


@dataclass(frozen=True, slots=True)
class _Kind:
    """A type reference: its name, its module, and `[3]`, `[]` or nothing."""

    name: str
    scope: tuple[str, ...]
    brackets: str = ""


def convert_idl(name: str, text: str) -> str:
    """Return the `ros2msg` text of a type (`package/msg/Type` or scoped) and of those it uses."""
    if len(text) > LONGEST_TEXT:
        raise LogError(f"schema {name}: expected up to {LONGEST_TEXT} bytes, found {len(text)}")
    types = _Types(name)
    for part in _PART.split(text):
        types.parse(part)
    return types.print()


class _Types:
    """The definitions in IDL texts, by scoped name; parser of the texts."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._structs: dict[str, list[tuple[_Kind, str]]] = {}
        self._others: dict[str, _Kind] = {}
        self._numbers: dict[str, str] = {}
        self._tokens: list[str] = []
        self._place = 0

    def parse(self, text: str) -> None:
        self._tokens, self._place = list(_list_tokens(self._name, text)), 0
        while self._next:
            self._parse_definition(())

    @property
    def _next(self) -> str:
        return self._tokens[self._place] if self._place < len(self._tokens) else ""

    def _take(self, expected: str = "") -> str:
        found = self._next
        if not found or (expected and found != expected):
            self._fail(expected or "more", found or "the end")
        self._place += 1
        return found

    def _skip(self, sign: str) -> bool:
        if self._next != sign:
            return False
        self._place += 1
        return True

    def _fail(self, expected: str, found: str) -> NoReturn:
        raise LogError(f"schema {self._name}: expected {expected}, found {found[:40]!r}")

    def _take_name(self) -> str:
        found = self._take()
        if not found.isidentifier():
            self._fail("a name", found)
        # IDL prefixes a name that is also a keyword with an underscore.
        return found.removeprefix("_")

    def _parse_definition(self, scope: tuple[str, ...]) -> None:
        self._pass_annotations()
        word = self._take()
        match word:
            case "module":
                self._parse_module((*scope, self._take_name()))
            case "struct":
                self._parse_struct(scope)
            case "typedef":
                found = self._parse_declarators(scope)
                self._others |= {"::".join((*scope, name)): kind for kind, name in found}
            case "enum":
                self._others["::".join((*scope, self._take_name()))] = _Kind("uint32", ())
                self._pass_until("}")
            case "const":
                self._parse_constant(scope)
            case _ if word in _NOT_READ:
                raise LogError(f"schema {self._name}: {word} is not read")
            case _ if word != ";":
                self._fail("module, struct, typedef, enum or const", word)
        self._skip(";")

    def _parse_module(self, scope: tuple[str, ...]) -> None:
        if len(scope) > _DEEPEST:
            raise LogError(f"schema {self._name}: expected up to {_DEEPEST} modules in each other")
        self._take("{")
        while not self._skip("}"):
            self._parse_definition(scope)

    def _parse_struct(self, scope: tuple[str, ...]) -> None:
        name = "::".join((*scope, self._take_name()))
        if self._next == ";":  # a declaration; its definition follows
            return
        if self._next == ":":
            raise LogError(f"schema {self._name}: {name}: a struct of a struct is not read")
        self._take("{")
        members: list[tuple[_Kind, str]] = []
        while not self._skip("}"):
            self._pass_annotations()
            members += self._parse_declarators(scope)
            self._take(";")
        # IDL requires a member: ROS writes this one for types without fields.
        if [member for _, member in members] == ["structure_needs_at_least_one_member"]:
            members = []
        self._structs[name] = members

    def _parse_constant(self, scope: tuple[str, ...]) -> None:
        self._parse_kind(scope)
        name = "::".join((*scope, self._take_name()))
        self._take("=")
        first = self._place
        self._pass_until(";")
        if self._place == first + 2:  # a computed value is not accepted as the length of an array
            self._numbers[name] = self._tokens[first]

    def _parse_declarators(self, scope: tuple[str, ...]) -> Iterator[tuple[_Kind, str]]:
        """Yield type and name of each declarator in a line such as `double x, y[3]`."""
        kind = self._parse_kind(scope)
        while True:
            name, brackets = self._take_name(), kind.brackets
            while self._skip("["):
                if brackets:
                    raise LogError(f"schema {self._name}: {name}: arrays of arrays are not read")
                brackets = f"[{self._take_length(scope)}]"
                self._take("]")
            yield _Kind(kind.name, kind.scope, brackets), name
            if not self._skip(","):
                return

    def _parse_kind(self, scope: tuple[str, ...]) -> _Kind:
        self._pass_annotations()
        word = self._take()
        if word == "sequence":
            return self._parse_sequence(scope)
        if word == "map":
            raise LogError(f"schema {self._name}: map is not read")
        if word in _SEVERAL:
            while self._next in _SEVERAL:
                word = f"{word} {self._take()}"
            if word not in _KINDS:
                self._fail("a type", word)
        elif word in {"string", "wstring"} and self._skip("<"):
            self._take_length(scope)
            self._close()
        elif not word.replace("::", "").isidentifier():
            self._fail("a type", word)
        return _Kind(word, scope)

    def _parse_sequence(self, scope: tuple[str, ...]) -> _Kind:
        self._take("<")
        self._pass_annotations()
        if self._next == "sequence":
            raise LogError(f"schema {self._name}: sequences of sequences are not read")
        kind = self._parse_kind(scope)
        bound = f"<={self._take_length(scope)}" if self._skip(",") else ""
        self._close()
        return _Kind(kind.name, kind.scope, f"[{bound}]")

    def _close(self) -> None:
        if self._next == ">>":  # the end of two types, as in sequence<string<10>>
            self._tokens[self._place] = ">"
        else:
            self._take(">")

    def _take_length(self, scope: tuple[str, ...]) -> str:
        found = self._take()
        for count in range(len(scope), -1, -1):
            found = self._numbers.get("::".join((*scope[:count], found)), found)
        if not re.fullmatch(r"\d{1,9}", found, re.ASCII):
            self._fail("a length", found)
        return found

    def _pass_annotations(self) -> None:
        while self._skip("@"):
            name = self._take()
            if name in _OTHER_BYTES:
                raise LogError(f"schema {self._name}: @{name} is not read: it changes the bytes")
            if self._skip("("):
                self._pass_until(")")

    def _pass_until(self, end: str) -> None:
        """Skip up to and including a token, ignoring anything in brackets."""
        depth = 0
        while True:
            found = self._take()
            if not depth and found == end:
                return
            depth += (found == "(") - (found == ")")

    def print(self) -> str:
        """Return the wanted struct as `ros2msg`, followed by the structs that it uses."""
        wanted = self._name.replace("/", "::")
        if wanted not in self._structs:
            others = ", ".join(self._structs)[:80]
            found = others and f"; there is {others}"
            raise LogError(f"schema {self._name}: its definition is missing{found}")
        parts: list[str] = []
        known, waiting = {wanted}, [wanted]
        while waiting:
            struct, lines = waiting.pop(), []
            for kind, member in self._structs[struct]:
                text, nested = self._describe(kind)
                lines.append(f"{text} {member}\n")
                if nested and nested not in known:
                    known.add(nested)
                    waiting.append(nested)
            heading = f"{'=' * 80}\nMSG: {_rename(struct)}\n" if parts else ""
            parts.append(heading + "".join(lines))
        return "".join(parts)

    def _describe(self, kind: _Kind) -> tuple[str, str]:
        """Return the `ros2msg` name of a type, and its struct if the type is a struct."""
        brackets = kind.brackets
        for _ in range(_DEEPEST):
            if kind.name in _KINDS:
                return _KINDS[kind.name] + brackets, ""
            found = self._find(kind)
            if found in self._structs:
                return _rename(found) + brackets, found
            kind = self._others[found]
            if brackets and kind.brackets:
                raise LogError(f"schema {self._name}: {found}: arrays of arrays are not read")
            brackets = brackets or kind.brackets
        raise LogError(f"schema {self._name}: expected types that end, found one that is itself")

    def _find(self, kind: _Kind) -> str:
        """Return the scoped name of a type, searched from the using module outwards."""
        name, is_absolute = kind.name.removeprefix("::"), kind.name.startswith("::")
        for count in range(0 if is_absolute else len(kind.scope), -1, -1):
            found = "::".join((*kind.scope[:count], name))
            if found in self._structs or found in self._others:
                return found
        raise LogError(f"schema {self._name}: no definition of {kind.name}")


def _list_tokens(name: str, text: str) -> Iterator[str]:
    place = 0
    while place < len(text):
        found = _TOKEN.match(text, place)
        if found is None:
            raise LogError(f"schema {name}: expected IDL, found {text[place : place + 40]!r}")
        if found.lastgroup == "word" and len(found[0]) > _LONGEST_WORD:
            raise LogError(f"schema {name}: expected shorter names, found {found[0][:40]!r}")
        if found.lastgroup is not None:
            yield found[0]
        # A comment or text without an end: searching for further ends would take quadratic time.
        place = len(text) if found.lastgroup == "open" else found.end()


def _rename(scoped: str) -> str:
    """Return a scoped name as `package/Type`. Names outside ROS get their own package."""
    *scope, name = scoped.split("::")
    if len(scope) == 2 and scope[1] in _BETWEEN:
        scope.pop()
    is_ros = len(scope) == 1 and scope[0] not in _BETWEEN
    return f"{scope[0] if is_ros else '__'.join(('idl', *scope))}/{name}"
