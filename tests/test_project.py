import ast
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

import turtlelog

ROOT = Path(__file__).parents[1]


def read_citation() -> dict[str, Any]:
    found: dict[str, Any] = YAML(typ="safe").load(ROOT / "CITATION.cff")
    return found


def test_citation_says_what_the_project_says_of_itself() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = read_citation()
    assert (cited["title"], cited["version"]) == (project["name"], turtlelog.__version__)
    assert cited["abstract"] == project["description"]
    assert cited["license"] == project["license"]
    assert cited["keywords"] == project["keywords"]


def test_citation_names_the_paper_as_the_pages_do() -> None:
    (paper,) = read_citation()["references"]
    title = f'"{paper["title"]}"'
    assert title in " ".join((ROOT / "README.md").read_text().split())
    assert title in " ".join((ROOT / "docs" / "paper.md").read_text().split())


@pytest.mark.parametrize("name", ["docs/ci/github.yml", "docs/ci/gitlab.yml"])
def test_workflows_install_what_the_repository_has(name: str) -> None:
    text = (ROOT / name).read_text()
    YAML(typ="safe").load(text)
    installed = re.findall(r"^ *- (?:run: )?pip install (.+)$", text, re.M)
    assert installed == ["-r turtlelog/requirements-core.txt pytest", "--no-deps ./turtlelog"]
    assert (ROOT / "requirements-core.txt").is_file()


def test_uv_has_the_pins_of_the_constraints_file() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["tool"]["uv"]["constraint-dependencies"] == pins
    assert all(re.fullmatch(r"[a-z0-9.-]+==[0-9a-z.]+", pin) for pin in pins)


def test_every_dependency_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    pins = (ROOT / "constraints.txt").read_text()
    wanted = project["project"]["dependencies"] + project["build-system"]["requires"]
    for extra in project["project"]["optional-dependencies"].values():
        wanted += [requirement for requirement in extra if not requirement.startswith("turtlelog[")]
    names = {re.split(r"[<>=\[;]", requirement)[0] for requirement in wanted}
    assert {name for name in names if f"\n{name}==" not in pins} == set()


PACKAGES = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "lazy_loader": "lazy-loader",
    "rerun": "rerun-sdk",
    "tomli_w": "tomli-w",
}
"""Packages that are not called like their module."""

BROUGHT_BY_OTHERS = {"pandas", "pytest", "fontTools", "xarray", "IPython", "rerun_notebook"}
"""Used where they are there: data frames, labelled arrays, the plugin, fonts of PDFs. The last two
come with rerun-sdk[notebook], which is the extra `notebook`."""


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
    """All files of the package are parsed."""
    imported = {PACKAGES.get(name, name) for name in list_imports() - BROUGHT_BY_OTHERS}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    own = extras["cluster"] + extras["fast"] + extras["movie"] + extras["remote"] + extras["report"]
    optional = {re.split(r"[<>=]", found)[0] for found in own}
    declared = {re.split(r"[<>=\[;]", requirement)[0] for requirement in project["dependencies"]}
    assert imported - optional == declared


def read_project() -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return found


def test_the_page_of_platforms_names_the_versions_that_are_declared() -> None:
    page = (ROOT / "docs" / "platforms.md").read_text("utf-8")
    project = read_project()
    (rerun,) = [name for name in project["dependencies"] if name.startswith("rerun-sdk")]
    low, high = re.fullmatch(r"rerun-sdk>=([\d.]+),<([\d.]+)", rerun).groups()  # type: ignore[union-attr]
    assert f"rerun-sdk >= {low}, < {high}" in page
    assert project["requires-python"] == ">=3.11"
    classified = [name.rpartition(" ")[2] for name in project["classifiers"] if " :: 3." in name]
    assert re.findall(r"^\| (3\.\d+) \|", page, re.M) == classified


def test_slim_installation_is_all_but_views_and_figures() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    lines = (ROOT / "requirements-core.txt").read_text().splitlines()
    slim = [line for line in lines if not line.startswith("#")]
    lacks = {re.split(r"[<>=\[;]", name)[0] for name in set(declared) - set(slim)}
    assert set(slim) <= set(declared)
    assert lacks == {"rerun-sdk", "pyarrow", "matplotlib", "control", "pillow"}
