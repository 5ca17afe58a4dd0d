"""What `--json` prints, as a page and as JSON schemas, from dataclasses.

To write both: python -m tests.docs.json_schemas.
"""

import ast
import importlib
import inspect
import json
import re
from dataclasses import field, fields, is_dataclass, make_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from turtlelog.cli.console import list_json_keys

PAGE: Final = Path(__file__).parents[2] / "docs" / "json.md"
SCHEMAS: Final = PAGE.with_name("schemas.json")

ANSWERS: Final = {
    "run": "run:RunAnswer",
    "sweep": "sweep:SweepAnswer",
    "tune": "tune_answer:TuneAnswer",
    "theory": "theory_loops:IntegratorAnswer",
    "theory --lag": "theory:_TermsAnswer",
    "theory FILE": "theory:_FileAnswer",
    "info": "info:InfoAnswer",
    "metrics": "metrics:MeasuredFile",
    "metrics -o TABLE": "metrics:TableAnswer",
    "compare": "compare_answer:_AcrossAnswer",
    "compare --reference": "compare_reference:_ReferenceAnswer",
    "compare --why": "compare:WhyAnswer",
    "compare --reference --ate": "compare_trajectories:TrajectoriesAnswer",
    "compare BAG SCENARIO": "compare_reference:_RobotAnswer",
    "explain": "explain:ExplainAnswer",
    "identify": "identify:IdentifyAnswer",
    "replay": "replay_answer:LoopReplayAnswer",
    "replay --law": "replay_answer:LawReplayAnswer",
    "replay --plant": "replay_answer:PlantReplayAnswer",
    "replay of commands alone": "replay_answer:CommandReplayAnswer",
    "list": "list_names:ListAnswer",
    "check": "check_answers:CheckAnswer",
    "plot": "plot:PlotAnswer",
    "plot TABLE": "plot_table:MapAnswer",
    "report": "report:ReportAnswer",
    "convert": "convert:ConvertAnswer",
    "convert --recover": "convert:RecoverAnswer",
}
"""Answers by what is typed; `info` and `metrics` print a list of theirs."""

HEAD: Final = """# JSON

`--json` prints one JSON value and nothing else: a list from `info` and `metrics`, an object from
the others. Quantities are in SI units and radians unless the name or unit says otherwise. A value
that does not exist is null, with a `status` or `reason` beside it; `?` marks its type. A linked
type has its table in the section of another command. [schemas.json](schemas.json) contains a JSON
schema for each command.
"""


def find_answer(typed: str) -> Any:
    """Return the dataclass of an answer."""
    module, _, name = ANSWERS[typed].partition(":")
    return getattr(importlib.import_module(f"turtlelog.cli.{module}"), name)


@cache
def show_type(kind: Any) -> Any:
    """Return the type of what is printed for a value: a dataclass with the keys of its fields."""
    if isinstance(kind, type) and is_dataclass(kind):
        hints = get_type_hints(kind, include_extras=True)
        own = {one.name: one for one in fields(kind)}
        shown: list[Any] = []
        for name, (key, is_null_if_empty) in list_json_keys(kind).items():
            told, source = show_type(hints[name]), own[name]
            default: Any = field(default=source.default, default_factory=source.default_factory)
            if is_null_if_empty:
                words = tuple(filter(None, get_args(told)))
                told, default = (Literal[words] if words else str) | None, None
            shown.append((key, told, default))
        namespace = {"__doc__": kind.__doc__}
        return make_dataclass(kind.__name__, shown, kw_only=True, namespace=namespace)
    parts, origin = get_args(kind), get_origin(kind)
    if not parts or origin in {Literal, Annotated}:
        return kind
    return (Union if origin is UnionType else origin)[tuple(map(show_type, parts))]


_OTHERS: Final = (
    "check.result",
    "explain.answers",
    "cli.theory_gains",
    "cli.theory_loops",
    "cli.replay_answer",
)
"""Modules whose dataclasses stand within answers."""


@cache
def know_types() -> None:
    """Import what modules import for type checkers alone: schemas need it as well."""
    names = [find_answer(typed).__module__ for typed in ANSWERS if not typed.startswith("plot")]
    for name in dict.fromkeys([*names, *(f"turtlelog.{other}" for other in _OTHERS)]):
        module = importlib.import_module(name)
        for node in ast.parse(inspect.getsource(module)).body:
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                imports = compile(ast.Module(node.body, []), name, "exec")
                exec(imports, module.__dict__)


def build_schema(typed: str) -> dict[str, Any]:
    """Return the JSON schema of an answer."""
    know_types()
    return msgspec.json.schema(show_type(find_answer(typed)), schema_hook=lambda _: {})


def format_schemas() -> str:
    """Return the schemas of all answers as JSON."""
    found = {f"turtlelog {typed} --json": build_schema(typed) for typed in ANSWERS}
    return json.dumps(found, ensure_ascii=False, indent=1) + "\n"


def format_page() -> str:
    """Return the page: of each answer its keys in a table, and those of what stands within.

    A part of several answers has its table in the first of them, to which the others link.
    """
    places: dict[str, str] = {}
    return "\n".join([HEAD, *(_format_answer(typed, places) for typed in ANSWERS)])


def _format_answer(typed: str, places: dict[str, str]) -> str:
    """Return the section of an answer; add to the sections by the tables that they have first."""
    parts = build_schema(typed)["$defs"]
    first = find_answer(typed).__name__
    names = [first, *(name for name in parts if name != first)]
    tables = {name: _format_part(name, parts[name], is_first=name == first) for name in names}
    anchor = re.sub(r"[^\w-]", "", f"turtlelog {typed} --json".lower().replace(" ", "-"))
    text = "\n".join(one for one in tables.values() if places.setdefault(one, anchor) == anchor)
    for name, table in tables.items():
        if places[table] != anchor:
            word = f"`{_name_part(name)}`"
            text = text.replace(word, f"[{word}](#{places[table]})")
    return f"## `turtlelog {typed} --json`\n\n" + text


def _format_part(name: str, part: dict[str, Any], *, is_first: bool) -> str:
    description, _, attributes = part.get("description", "").partition("Attributes:")
    attributes = attributes.partition("Raises:")[0]
    texts = re.findall(r"^ *(\w+): (.*(?:\n {10,}.*)*)", attributes, re.M)
    meanings = {key: _tell(text) for key, text in texts}
    about = _tell(description)
    head = about if is_first else f"`{_name_part(name)}`: {about}".removesuffix(": ")
    rows = [
        f"| `{key}` | {_name_kind(kind)} | {meanings.get(key, '').replace('|', chr(92) + '|')} |"
        for key, kind in part.get("properties", {}).items()
    ]
    table = ["| key | value | |", "|---|---|---|", *rows] if rows else []
    return "\n".join([*([head, ""] if head else []), *table, *([""] if table else [])])


def _tell(text: str) -> str:
    return re.sub(r"\bNone\b", "null", " ".join(text.split()))


def _name_kind(kind: dict[str, Any]) -> str:
    """Return a kind of value in words."""
    if "anyOf" in kind:
        *others, last = map(_name_kind, kind["anyOf"])
        return f"{' or '.join(others)}?" if last == "null" else " or ".join([*others, last])
    if "$ref" in kind:
        return f"`{_name_part(kind['$ref'].rpartition('/')[2])}`"
    if "enum" in kind:
        return ", ".join(f"`{json.dumps(value)}`" for value in kind["enum"])
    match kind.get("type"):
        case "array":
            items = kind.get("items")
            of = [items] if items else kind.get("prefixItems", [])
            return f"list of {', '.join(map(_name_kind, of))}" if of else "list"
        case "object":
            values = kind.get("additionalProperties")
            return (
                f"object of {_name_kind(values)} by name" if isinstance(values, dict) else "object"
            )
        case other:
            return str(other or "any value")


def _name_part(name: str) -> str:
    return name.removeprefix("_")


if __name__ == "__main__":
    PAGE.write_text(format_page(), "utf-8")
    SCHEMAS.write_text(format_schemas(), "utf-8")
