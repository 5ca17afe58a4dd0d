"""The schema of specifications: it accepts what the reader does."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from tests.cli.conftest import SPEC, Call

KINDS: dict[str, Any] = {"string": str, "number": int | float, "boolean": bool, "object": dict}


def matches(value: Any, schema: dict[str, Any], root: dict[str, Any] | None = None) -> bool:
    """Whether a value fits, by those words of JSON Schema that ours uses."""
    root = root or schema
    if "$ref" in schema:
        return matches(value, root["$defs"][schema["$ref"].rpartition("/")[2]], root)
    if "const" in schema or "enum" in schema:
        return value in schema.get("enum", [schema.get("const")])
    if not isinstance(value, KINDS[schema["type"]]):
        return False
    if isinstance(value, dict):
        return has_fitting_keys(value, schema, root)
    if isinstance(value, str):
        return re.search(schema["pattern"], value) is not None
    return isinstance(value, bool) or 0 <= value <= schema.get("maximum", 1e9)


def has_fitting_keys(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> bool:
    found = [
        [set(one.get("required", ())) <= set(value) for one in schema.get(word, [schema])]
        for word in ("oneOf", "anyOf")
    ]
    needs = schema.get("dependentRequired", {})
    if sum(found[0]) != 1 or not any(found[1]):
        return False
    if not all(set(needs[key]) <= set(value) for key in value if key in needs):
        return False
    inner = schema.get("properties", {})
    patterns = schema.get("patternProperties", {})
    schemas = {
        key: inner.get(key)
        or next((patterns[found] for found in patterns if re.search(found, key)), None)
        or schema["additionalProperties"]
        for key in value
    }
    return all(found and matches(value[key], found, root) for key, found in schemas.items())


def test_the_schema_accepts_the_examples_and_refuses_what_the_reader_does(
    call: Call, kp4: Path
) -> None:
    schema = call("check", "--schema").json
    examples = Path(__file__).parents[2] / "examples"
    for path in [*examples.glob("*.toml")]:
        assert matches(tomllib.loads(path.read_text("utf-8")), schema), path
    assert matches(tomllib.loads(SPEC), schema)
    assert matches(tomllib.loads(call("check", "--init", kp4).out), schema)
    others = '[metrics."a.rms_error"]\nabs = 1\nreason = "b"\n[signals.memory]\nreason = "b"'
    phase = 'alignment = "phase:one"\n[checks.a]\nholds = "true"\nphase = "one"'
    for right in (others, phase):
        assert matches(tomllib.loads(f"format = 1\n{right}"), schema), right
    wrong_ones: tuple[str, ...] = (
        '[checks.a]\nfase = "b"',
        "[checks.a]\nexpect = 3",
        "[signals.z]\nabs = 1",
        "",
    )
    wrong_ones += ('[metrics."a.rms_eror"]\nreason = "b"', "[signals.Memory]\nreason = 'b'")
    wrong_ones += ('alignment = "start"\n[checks.a]\nholds = "true"',)
    for wrong in (*wrong_ones, '[checks.a]\nexpect = "true"\nphase = "rotate"'):
        assert not matches(tomllib.loads(f"format = 1\n{wrong}"), schema), wrong
    assert not matches({"format": 2}, schema)


def test_the_schema_in_the_docs_is_the_one_that_is_printed(call: Call) -> None:
    stored = Path(__file__).parents[2] / "docs" / "ci" / "spec.schema.json"
    assert json.loads(stored.read_text("utf-8")) == call("check", "--schema").json
