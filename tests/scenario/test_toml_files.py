from pathlib import Path

import pytest

from tests.scenario.lines import match_whole
from turtlelog.errors import ScenarioError
from turtlelog.scenario import get_preset, load_scenario, parse_scenario, read_scenario


def test_text_that_is_no_toml_is_told_with_its_place() -> None:
    line = r"\Arun\.toml: not TOML: [^\n]*\(at line 2, column 6\)\Z"
    with pytest.raises(ScenarioError, match=line):
        parse_scenario("seed = 1\nname turtle\n", source="run.toml")


@pytest.mark.parametrize("start", [b"\xef\xbb\xbf", b"\r\n"], ids=["byte-order-mark", "windows"])
def test_file_of_a_windows_editor_is_read(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "run.toml"
    path.write_bytes(start + b"seed = 3\r\n")
    assert read_scenario(path).seed == 3


def test_empty_file_on_disk_is_the_textbook(tmp_path: Path) -> None:
    path = tmp_path / "empty.toml"
    path.touch()
    assert read_scenario(path) == get_preset("textbook")


def test_empty_file_of_another_name_is_no_scenario(tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    with pytest.raises(ScenarioError, match=r"empty: expected a scenario, found an empty file$"):
        load_scenario(tmp_path / "empty")


def test_wrong_value_in_a_file_is_named_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("seed = -1", encoding="utf-8")
    line = f"{path}: seed: expected a whole number >= 0, found -1"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        read_scenario(path)


def test_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_bytes(b"\x89MCAP0\r\n\xff\xfe")
    line = f"{path}: not TOML, not even text"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        read_scenario(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    line = f"{path}: no such file"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        read_scenario(path)


def test_folder_is_no_scenario(tmp_path: Path) -> None:
    line = f"{tmp_path}: a folder, not a scenario file (.toml)"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        load_scenario(tmp_path)


def test_name_that_is_neither_preset_nor_file_is_refused() -> None:
    line = 'no preset or file "papre"; did you mean paper? List: turtlelog list presets'
    with pytest.raises(ScenarioError, match=match_whole(line)):
        load_scenario("papre")
