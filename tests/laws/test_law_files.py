import sys
from pathlib import Path

import pyarrow.parquet
import pytest

import turtlelog as tl
from turtlelog.errors import LawError
from turtlelog.laws import find_law
from turtlelog.sweep import build_plan, prepare_sweep, run_sweep

LAW = """
import helper
from turtlelog.laws import Decision, SequentialP


class Own(SequentialP):
    def __init__(self, parameters):
        import late

        super().__init__(parameters)
        self.turn_rate = late.TURN_RATE

    def step(self, time_ns, pose):
        from parts.speed import get_speed

        return Decision(speed_m_s=get_speed(), turn_rate_rad_s=self.turn_rate)
"""


def write_law(folder: Path, speed: float, law: str = LAW) -> str:
    """Write a law with helpers beside it, which turns at a tenth of its speed; return its kind."""
    (folder / "parts").mkdir(parents=True)
    (folder / "own.py").write_text(law, "utf-8")
    (folder / "helper.py").write_text(f"SPEED = {speed}\n", "utf-8")
    (folder / "late.py").write_text("from helper import SPEED\nTURN_RATE = SPEED / 10\n", "utf-8")
    (folder / "parts" / "__init__.py").write_text("", "utf-8")
    code = "from . import numbers\n\ndef get_speed():\n    return numbers.SPEED\n"
    (folder / "parts" / "speed.py").write_text(code, "utf-8")
    (folder / "parts" / "numbers.py").write_text("from helper import SPEED\n", "utf-8")
    return f"{folder / 'own.py'}:Own"


def simulate(kind: str) -> tl.Run:
    changes = {"law.kind": kind, "max_duration_s": 0.5}
    return tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), changes))


def read_speed(run: tl.Run) -> tuple[float, float]:
    return float(run.samples.speed_m_s[-1]), float(run.samples.turn_rate_rad_s[-1])


def test_laws_of_two_folders_each_have_the_helper_beside_them(tmp_path: Path) -> None:
    kinds = [write_law(tmp_path / name, speed) for name, speed in (("a", 0.5), ("b", 0.25))]
    speeds = [read_speed(simulate(kind)) for kind in (*kinds, *kinds)]
    assert speeds == [(0.5, 0.05), (0.25, 0.025)] * 2


def test_what_a_law_imports_is_private_to_its_folder(tmp_path: Path) -> None:
    path, names = [*sys.path], {*sys.modules}
    simulate(write_law(tmp_path, 0.5))
    assert sys.path == path
    assert {"helper", "late", "parts"}.isdisjoint(sys.modules)
    assert all(name.startswith("turtlelog_law_") for name in {*sys.modules} - names)


def test_laws_of_one_folder_share_a_helper(tmp_path: Path) -> None:
    first = find_law(write_law(tmp_path, 0.5))
    (tmp_path / "other.py").write_text(LAW, "utf-8")
    second = find_law(f"{tmp_path / 'other.py'}:Own")
    assert sys.modules[first.__module__].helper is sys.modules[second.__module__].helper


@pytest.mark.parametrize("name", ["random", "turtlelog"])
def test_a_file_beside_a_law_replaces_neither_the_standard_library_nor_turtlelog(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / f"{name}.py").write_text("raise RuntimeError('the wrong one')\n", "utf-8")
    simulate(write_law(tmp_path / "laws", 0.5))
    (tmp_path / "laws" / f"{name}.py").write_text("raise RuntimeError\n", "utf-8")
    kind = write_law(tmp_path / "more", 0.5, f"import {name}\n{LAW}")
    (tmp_path / "more" / f"{name}.py").write_text("raise RuntimeError('wrong')\n", "utf-8")
    assert read_speed(simulate(kind)) == (0.5, 0.05)


def test_a_folder_of_data_hides_no_installed_package(tmp_path: Path) -> None:
    (tmp_path / "numpy").mkdir()
    find_law(write_law(tmp_path, 0.5, f"import numpy\nnumpy.zeros(3)\n{LAW}"))


def test_a_helper_that_fails_is_named_and_may_be_mended(tmp_path: Path) -> None:
    kind = write_law(tmp_path, 0.5)
    (tmp_path / "helper.py").write_text("SPEED = = 1\n", "utf-8")
    with pytest.raises(LawError, match=r"own\.py cannot be loaded: .*helper\.py, line 1"):
        find_law(kind)
    (tmp_path / "helper.py").write_text("SPEED = 1.0\n", "utf-8")
    find_law(kind)


def test_a_missing_helper_is_one_line(tmp_path: Path) -> None:
    kind = write_law(tmp_path, 0.5, f"import helpers\n{LAW}")
    with pytest.raises(LawError, match=r"own\.py cannot be loaded: .*No module named 'helpers'"):
        find_law(kind)


def test_a_file_named_as_a_module_is_told_how_to_name_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_law(tmp_path, 0.5)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(LawError, match=r"is no installed module; write own\.py:CLASS$"):
        find_law("own:Own")


def test_workers_of_a_sweep_import_the_helper_of_each_law(tmp_path: Path) -> None:
    kinds = [write_law(tmp_path / name, speed) for name, speed in (("a", 0.5), ("b", 0.25))]
    changes = {"max_duration_s": 0.5, "law.kind": kinds[0]}
    base = tl.override_scenario(tl.load_scenario("textbook"), changes)
    plan = build_plan([f"law.kind={','.join(kinds)}", "start.heading_rad=0,0.1"])
    output = tmp_path / "t.parquet"
    run_sweep(prepare_sweep(base, plan, metrics=["run.path_length"]), output, jobs=2)
    found = pyarrow.parquet.read_table(output)
    lengths = found.column("run.path_length").to_pylist()
    assert found.column("failed").to_pylist() == [None] * 4
    assert lengths[:2] == pytest.approx([2.0 * length for length in lengths[2:]], rel=0.01)
