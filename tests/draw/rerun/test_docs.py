import re
from pathlib import Path

import pytest

from tests.draw.rerun.conftest import DOCUMENTS
from tests.draw.rerun.rrds import list_entities, read_layout

TEXT = (Path(__file__).parents[3] / "docs" / "rerun.md").read_text(encoding="utf-8")


def test_snippets_run_as_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for snippet in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL):
        exec(compile(snippet, "docs/rerun.md", "exec"), {})
    assert (tmp_path / "kp10.rrd").is_file()


def test_every_entity_is_documented(
    run_rrd: Path, follower_rrd: Path, strange_rrd: Path, tracker_rrd: Path
) -> None:
    documented = set(re.findall(r"`(/[a-z0-9_/<>]+)`", TEXT))
    rrds = (run_rrd, follower_rrd, strange_rrd, tracker_rrd)
    fixed = {
        re.sub(
            r"^/state/[a-z_]+$",
            "/state/<name>",
            re.sub(r"^/.+/(marks|ideal|lines/event)$", r"/<plot>/\1", entity),
        )
        for entity in (entity for rrd in rrds for entity in list_entities(rrd))
        if not entity.startswith(("/__", "/documents/", "/reference/"))
    }
    assert fixed <= documented


def test_every_view_is_documented(
    run_rrd: Path, comparison_rrd: Path, explanation_rrd: Path, strange_rrd: Path, tracker_rrd: Path
) -> None:
    rrds = (run_rrd, comparison_rrd, explanation_rrd, strange_rrd, tracker_rrd)
    views = {view for rrd in rrds for view in read_layout(rrd)}
    views = {re.sub("^State .*", "State", view) for view in views}
    plain = {re.split(r" \[| \(|, | of ", view)[0] for view in views}
    assert {view for view in plain if view not in TEXT} <= {*DOCUMENTS, "Notes"}
