import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_uv_has_the_pins_of_the_constraints_file() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["tool"]["uv"]["constraint-dependencies"] == pins
    assert all(re.fullmatch(r"[a-z0-9.-]+==[0-9a-z.]+", pin) for pin in pins)


def test_every_dependency_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    pins = (ROOT / "constraints.txt").read_text()
    wanted = project["project"]["dependencies"] + project["project"]["optional-dependencies"]["dev"]
    wanted += project["build-system"]["requires"]
    names = {re.split(r"[<>=\[]", requirement)[0] for requirement in wanted}
    assert {name for name in names if f"\n{name}==" not in pins} == set()


PACKAGES = {"rerun": "rerun-sdk", "lazy_loader": "lazy-loader", "tomli_w": "tomli-w"}
"""Packages that are not called like their module."""

BROUGHT_BY_THE_USER = {"pandas", "pytest"}
"""Used where they are there: data frames, the plugin."""


def list_imports() -> set[str]:
    names = set()
    for file in (ROOT / "turtlelog").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module)
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "load_library":
                names |= {str(arg.value) for arg in node.args if isinstance(arg, ast.Constant)}
    tops = {name.partition(".")[0] for name in names}
    return tops - sys.stdlib_module_names - {"turtlelog"}


def test_what_is_imported_is_declared_and_the_other_way_round() -> None:
    imported = {PACKAGES.get(name, name) for name in list_imports() - BROUGHT_BY_THE_USER}
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert imported == {re.split(r"[<>=\[]", requirement)[0] for requirement in declared}


def test_slim_installation_is_all_but_views_and_figures() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    lines = (ROOT / "requirements-core.txt").read_text().splitlines()
    slim = [line for line in lines if not line.startswith("#")]
    lacks = {re.split(r"[<>=\[]", name)[0] for name in set(declared) - set(slim)}
    assert set(slim) <= set(declared)
    assert lacks == {"rerun-sdk", "pyarrow", "matplotlib", "control"}
