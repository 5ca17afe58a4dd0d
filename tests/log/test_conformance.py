import json
from pathlib import Path
from typing import Any

import pytest

from tests.log.engine.raw_records import RawContents, read_raw
from tests.log.runs import SHARED, find_shared

FILES = sorted((SHARED / "conformance").glob("*/*.mcap"))


def read_expected(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the records that the suite's .json lists, by kind, each once."""
    expected: dict[str, list[dict[str, Any]]] = {}
    for record in json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))["records"]:
        of_kind = expected.setdefault(record["type"], [])
        fields = dict(record["fields"])
        # The summary repeats schemas and channels.
        if record["type"] not in {"Schema", "Channel"} or fields not in of_kind:
            of_kind.append(fields)
    return expected


def describe(record: Any) -> dict[str, Any]:
    """Return a record as the suite writes it: numbers as text, bytes as a list of numbers."""
    return {name: _describe_value(value) for name, value in vars(record).items()}


def _describe_value(value: Any) -> Any:
    if isinstance(value, bytes):
        return [str(byte) for byte in value]
    return str(value) if isinstance(value, int) else value


def list_records(contents: RawContents) -> dict[str, list[dict[str, Any]]]:
    kinds = {
        "Header": [contents.header],
        "Schema": contents.schemas.values(),
        "Channel": contents.channels.values(),
        "Message": contents.messages,
        "Metadata": contents.metadata,
        "Attachment": contents.attachments,
    }
    return {kind: [describe(record) for record in records] for kind, records in kinds.items()}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_of_the_suite_is_read_as_its_json_says(path: Path) -> None:
    expected = read_expected(path)
    found = list_records(read_raw(path))
    assert found == {kind: expected.get(kind, []) for kind in found}


def test_the_suite_is_read_whole() -> None:
    find_shared("conformance")
    print(f"{len(FILES)} files of the conformance suite")  # noqa: T201
    assert len(FILES) >= 208
