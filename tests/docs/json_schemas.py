"""The page of JSON schemas, from dataclasses. To write it: python -m tests.docs.json_schemas."""

import ast
import importlib
import inspect
import json
from functools import cache
from pathlib import Path
from typing import Any, Final

import msgspec

PAGE: Final = Path(__file__).parents[2] / "docs" / "json.md"

ANSWERS: Final = {
    "run": "run_answer:RunAnswer",
    "sweep": "sweep:SweepAnswer",
    "tune": "tune_answer:TuneAnswer",
    "theory": "theory_tables:IntegratorAnswer",
    "theory --lag": "theory:_TermsAnswer",
    "theory FILE": "theory:_FileAnswer",
    "info": "info_answer:InfoAnswer",
    "metrics": "metrics:MeasuredFile",
    "metrics -o TABLE": "folders:TableAnswer",
    "compare": "compare:_AcrossAnswer",
    "compare --reference": "compare_reference:_ReferenceAnswer",
    "compare BAG SCENARIO": "compare_robot:_RobotAnswer",
    "explain": "explain_answer:ExplainAnswer",
    "identify": "identify:IdentifyAnswer",
    "replay": "replay_answer:LoopReplayAnswer",
    "replay --law": "replay_answer:LawReplayAnswer",
    "replay --plant": "replay_plant:PlantReplayAnswer",
    "list": "list_names:ListAnswer",
    "check": "check_answers:CheckAnswer",
    "plot": "plot:PlotAnswer",
    "plot TABLE": "map_answer:MapAnswer",
    "report": "report:ReportAnswer",
    "convert": "convert:ConvertAnswer",
    "convert --recover": "recover:RecoverAnswer",
}
"""Answers by what is typed; `info` and `metrics` print a list of theirs."""

HEAD: Final = """# JSON

`--json` prints one JSON value and nothing else: a list from `info` and `metrics`, an object from
the others. Quantities are in SI units and radians unless the name or unit says otherwise. A value
that does not exist is null, with a `status` or `reason` beside it. Below are the JSON schemas of
the answers, a line for each of their parts.
"""


def find_answer(typed: str) -> Any:
    """Return the dataclass of an answer."""
    module, _, name = ANSWERS[typed].partition(":")
    return getattr(importlib.import_module(f"turtlelog.cli.{module}"), name)


_OTHERS: Final = (
    "explain.attribution",
    "cli.compare_robot",
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


def format_page() -> str:
    """Return the page."""
    know_types()
    parts = [HEAD]
    for typed in ANSWERS:
        schema = msgspec.json.schema(find_answer(typed), schema_hook=lambda _: {})
        found = "\n".join(
            f"{json.dumps(name)}: {json.dumps(part, ensure_ascii=False)}"
            for name, part in schema["$defs"].items()
        )
        parts.append(f"## `turtlelog {typed} --json`\n\n```text\n{found}\n```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(format_page(), "utf-8")
