"""The pages name everything that there is: places of the tree, commands, pages."""

import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import msgspec
import pytest

import turtlelog as tl
from turtlelog.errors import TurtlelogError
from turtlelog.laws import LAWS

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "turtlelog"
PAGES = sorted((ROOT / "docs").glob("*.md"))
ENTRANCES = {"__init__.py", "__init__.pyi", "__main__.py", "__pycache__", "py.typed"}


def read_page(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def list_places() -> list[str]:
    rows = re.findall(r"^\| (`[^|]+) \|", read_page("docs/architecture.md"), re.M)
    return [place for row in rows for place in re.findall(r"`([^`]+)`", row)]


@cache
def list_commands() -> list[str]:
    done = subprocess.run(
        [sys.executable, "-m", "turtlelog", "--help"],
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "100", "PYTHONUTF8": "1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return re.findall(r"^│ ([a-z]+)  ", done.stdout, re.M)


@pytest.mark.parametrize("place", list_places())
def test_places_on_the_page_are_in_the_tree(place: str) -> None:
    path = PACKAGE / place
    assert path.is_dir() if place.endswith("/") else path.is_file()


def test_places_in_the_tree_are_on_the_page() -> None:
    found = {f"{path.name}{'/' * path.is_dir()}" for path in PACKAGE.iterdir()}
    assert found - ENTRANCES - {"__pycache__/"} - set(list_places()) == set()


def test_no_place_stands_twice() -> None:
    places = list_places()
    assert len(places) == len(set(places))


def test_every_stage_is_in_the_picture() -> None:
    picture = read_page("docs/images/architecture.svg")
    stages = {place for place in list_places() if place.count("/") == 1 and place.endswith("/")}
    assert {stage for stage in stages if stage not in picture} == set()


def test_commands_stand_on_their_page_in_the_order_of_help() -> None:
    assert re.findall(r"^## (.+)$", read_page("docs/commands.md"), re.M) == list_commands()


def test_every_command_has_an_example_on_its_page() -> None:
    sections = re.split(r"^## ", read_page("docs/commands.md"), flags=re.M)[1:]
    shown = {
        section.split()[0]
        for section in sections
        if re.search(rf"```console\n(?:.*\n)*?\$ turtlelog {section.split()[0]} ", section)
    }
    assert [name for name in list_commands() if name not in shown] == []


def test_every_command_says_what_its_json_holds() -> None:
    sections = re.split(r"^## ", read_page("docs/commands.md"), flags=re.M)[1:]
    assert [section.split()[0] for section in sections if "`--json`" not in section] == []


def test_the_page_of_commands_begins_with_a_list_of_them() -> None:
    rows = re.findall(r"^\| `turtlelog ([a-z]+)", read_page("docs/commands.md"), re.M)
    assert rows == list_commands()


def list_defaults(section: str) -> dict[str, str]:
    """Return the keys in the tables of a section, with the defaults that stand there."""
    found: dict[str, str] = {}
    tables = re.findall(r"^\| \w+ \| unit \| default \|.*\n((?:\|.*\n)*)", section, re.M)
    rows = re.findall(r"^\| (`[^|]+) \| [^|]* \| ([^|]+) \|", "".join(tables), re.M)
    for keys, defaults in rows:
        names = re.findall(r"`(\w+)`", keys)
        values = [word.strip(" `") for word in defaults.split(",")]
        found |= dict(zip(names, values * (len(names) // len(values)), strict=True))
    return found


@pytest.mark.parametrize("kind", [kind for kind in LAWS if kind != "open-loop"])
def test_defaults_of_a_law_are_those_on_its_page(kind: str) -> None:
    (section,) = re.findall(
        rf"^## {kind}\n(.*?)(?=^## |\Z)", read_page("docs/laws.md"), re.M | re.S
    )
    used = msgspec.to_builtins(LAWS[kind].Parameters())
    words = {True: "true", False: "false", None: "none"}
    shown_defaults = list_defaults(section)
    assert shown_defaults
    for name, shown in shown_defaults.items():
        default = used[name]
        if isinstance(default, int | float) and not isinstance(default, bool):
            assert float(shown) == default, name
        else:
            assert shown == words.get(default, default), name


def test_the_readme_leads_to_the_index_and_the_index_to_every_page() -> None:
    assert "](docs/index.md)" in read_page("README.md")
    index = read_page("docs/index.md")
    left_out = [page.name for page in PAGES if f"]({page.name})" not in index]
    assert left_out == ["index.md"]


def list_names() -> list[str]:
    found = ((name, getattr(tl, name)) for name in tl.__all__ if not name.startswith("_"))
    return [name for name, value in found if not isinstance(value, ModuleType)]


def test_every_public_name_stands_on_its_page() -> None:
    page = read_page("docs/python.md")
    assert [name for name in list_names() if not re.search(rf"\b{name}\b", page)] == []


def test_public_names_are_those_that_one_writes() -> None:
    assert len(list_names()) <= 60


def test_every_error_stands_on_the_page_of_names() -> None:
    section = read_page("docs/python.md").partition("\n## Errors\n")[2].partition("\n## ")[0]
    named = {name for name in re.findall(r"`(\w+)`", section) if name.endswith("Error")}
    areas = {error.__name__ for error in TurtlelogError.__subclasses__()}
    assert areas <= named
    assert all(issubclass(getattr(tl.errors, name), TurtlelogError) for name in named)


def list_doors() -> list[str]:
    """Files and folders that the table of changes names."""
    table = (
        read_page("docs/architecture.md").partition("## To add X")[2].partition("\nTests add")[0]
    )
    return sorted({place for place in re.findall(r"`([\w/.]+)`", table) if "/" in place})


@pytest.mark.parametrize("door", list_doors())
def test_a_change_goes_where_the_page_says(door: str) -> None:
    assert (PACKAGE / door).exists()
