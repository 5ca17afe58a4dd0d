from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from tests.draw.rerun.rrds import list_entities, read_blueprint_parts, read_layout
from turtlelog.draw.rerun.entities import name_document

SCENES = ["run_rrd", "comparison_rrd", "explanation_rrd", "violation_rrd"]
SCENES += ["follower_rrd", "laws_rrd"]


@pytest.fixture(params=SCENES)
def rrd(request: pytest.FixtureRequest) -> Path:
    path: Path = request.getfixturevalue(request.param)
    return path


def test_every_path_that_a_view_names_holds_something(rrd: Path) -> None:
    named = {path.removeprefix("- ") for paths in read_layout(rrd).values() for path in paths}
    assert {path for path in named if "*" not in path} <= list_entities(rrd)


def test_no_view_is_empty(rrd: Path) -> None:
    entities = list_entities(rrd)
    for view, paths in read_layout(rrd).items():
        shown = {entity for path in paths for entity in entities if fnmatchcase(entity, path)}
        assert shown or name_document(view) in entities, view


def test_planes_are_dark_whatever_the_theme(rrd: Path) -> None:
    grounds = read_blueprint_parts(rrd, "Background:color")
    assert grounds
    assert set(grounds) == {0x0D0D0DFF}
