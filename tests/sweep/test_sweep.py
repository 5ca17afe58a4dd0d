import json
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from turtlelog.parts import split_key_unit
from turtlelog.scenario import resolve_scenario
from turtlelog.simulate.many import find_loop
from turtlelog.sweep import (
    ResultTable,
    RowRecords,
    batch,
    build_plan,
    load_row_scenario,
    prepare_sweep,
    read_result_table,
    run_sweep,
)
from turtlelog.sweep.sweep_rows import is_batch

NOISY = {"sensing.noise_position_m": 0.01, "loop.loss_probability": 0.05, "seed": 3}


def sweep_scenario(
    base: tl.Scenario,
    output: Path,
    *grid: str,
    metrics: list[str] | None = None,
    jobs: int = 1,
    records: RowRecords | None = None,
) -> ResultTable:
    sweep = prepare_sweep(base, build_plan(grid), metrics=metrics, records=records)
    run_sweep(sweep, output, jobs=jobs)
    return read_result_table(output, kind="sweep")


def list_cells(table: ResultTable, name: str) -> list[Any]:
    column = table.find(name)
    assert column is not None
    return list(column.cells)


@pytest.mark.everyday(
    "noisy-track-square", "plain-posture", "noisy-textbook", "noisy-lagged", "plain-paper-kp10"
)
@pytest.mark.parametrize("name", ["paper-kp10", "textbook", "posture", "lagged", "track-square"])
@pytest.mark.parametrize("changes", [{}, NOISY], ids=["plain", "noisy"])
def test_rows_equal_single_runs_bit_for_bit(
    name: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    base = tl.override_scenario(tl.load_scenario(name), {"max_duration_s": 8.0, **changes})
    output = tmp_path / "t.parquet"
    table = sweep_scenario(base, output, "loop.transport_delay_ticks=0:2:2", "limits.speed_m_s=1,2")
    assert table.row_count == 4
    for row in range(4):
        ticks = list_cells(table, "loop.transport_delay_ticks")[row]
        limit = list_cells(table, "limits.speed_m_s")[row]
        changed = {"loop.transport_delay_ticks": ticks, "limits.speed_m_s": limit}
        run = tl.simulate_run(tl.override_scenario(base, changed))
        again = tl.simulate_run(load_row_scenario(output, row))
        for single in (run, again):
            found = tl.measure_run(
                single, only=tl.measure.list_essential_metrics(single.declaration)
            )
            assert found
            # The dead time alone is measured only when it is asked for.
            names = {name for name in found if not name.endswith(".dead_time")}
            assert {one.name for one in table.columns if one.name in found} == names
            for metric in (found[name] for name in names):
                assert list_cells(table, metric.id)[row] == metric.value
                assert list_cells(table, f"{metric.id}.status")[row] == metric.status.value
            assert list_cells(table, "stop_reason")[row] == single.stop_reason


@pytest.mark.thorough
def test_table_is_the_same_on_two_cores_and_in_the_compiled_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table is made three times, once by processes that start."""
    base = tl.override_scenario(tl.load_scenario("paper-kp4"), NOISY)
    grid = ("law.kp_linear=-1:4:0.5", "seed=0:2")
    loops = find_loop(resolve_scenario(base), base.plant.facts)
    assert loops is not None
    monkeypatch.setattr(loops, "find", lambda: None)
    sweep_scenario(base, tmp_path / "one.parquet", *grid)
    sweep_scenario(base, tmp_path / "two.parquet", *grid, jobs=2)
    monkeypatch.undo()
    loaded = loops.load()
    if loaded is not None:
        monkeypatch.setattr(loops, "find", lambda: loaded)
        sweep_scenario(base, tmp_path / "compiled.parquet", *grid)
    tables = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(tables) == 2 + (loaded is not None)
    assert len(set(tables.values())) == 1


COVERED = ["translate.overshoot", "rotate.settling_time", "final.position_error"]


@pytest.mark.everyday("paper-kp4")
@pytest.mark.parametrize("preset", ["paper-kp4", "lagged"])
def test_table_is_the_same_from_the_compiled_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    loops = batch.find_batch(tl.load_scenario(preset))
    assert loops is not None
    kernel = loops.load()
    if kernel is None:
        pytest.skip("numba is not installed")
    base = tl.override_scenario(tl.load_scenario(preset), NOISY)
    grid = ("law.kp_linear=-1:4:0.5", "loop.transport_delay_ticks=0:8:4", "seed=0:1")
    for name, found in (("alone", None), ("batch", kernel)):
        monkeypatch.setattr(loops, "find", lambda found=found: found)
        monkeypatch.setattr(loops, "expect", lambda *_, found=found: found)
        sweep_scenario(base, tmp_path / f"{name}.parquet", *grid, metrics=COVERED, jobs=2)
    alone = (tmp_path / "alone.parquet").read_bytes()
    assert (tmp_path / "batch.parquet").read_bytes() == alone


@pytest.mark.parametrize(
    ("name", "key", "metrics", "compiled"),
    [
        ("paper-kp4", "law.kp_linear", COVERED, True),
        ("paper-kp4", "law.kp_linear", ["run.iae", *COVERED], False),
        ("paper-kp4", "law.kp_linear", None, True),
        ("paper-kp4", "law.reorient", COVERED, False),
        ("lagged", "law.kp_linear", COVERED, True),
        ("lagged", "plant.turn_lag_s", COVERED, True),
        ("posture", "law.gamma", ["run.duration"], True),
        ("track-square", "law.lookahead_m", None, True),
        ("track-square", "path.speed_m_s", None, False),
        ("plant-step", "max_duration_s", ["run.duration"], False),
    ],
)
def test_only_what_is_compiled_as_a_whole_is_a_batch(
    name: str, key: str, metrics: list[str] | None, *, compiled: bool
) -> None:
    has_heading = name not in {"posture", "track-square", "plant-step"}
    heading = {"goal.heading_rad": 1.0} if has_heading else {}
    base = tl.override_scenario(tl.load_scenario(name), heading)
    values = "false,true" if key == "law.reorient" else "1:2"
    sweep = prepare_sweep(base, build_plan([f"{key}={values}"]), metrics=metrics)
    assert is_batch(sweep.cut_chunk(0, 1)) is compiled


def test_seed_is_the_bases_unless_it_is_varied(tmp_path: Path) -> None:
    base = tl.override_scenario(tl.load_scenario("textbook"), NOISY)
    same = sweep_scenario(base, tmp_path / "same.parquet", "loop.pose_queue=10,11")
    errors = list_cells(same, "final.position_error")
    assert errors[0] == errors[1]
    varied = sweep_scenario(base, tmp_path / "varied.parquet", "seed=3:4")
    others = list_cells(varied, "final.position_error")
    assert others[0] == errors[0]
    assert others[1] != errors[0]


def test_failed_run_is_a_row_with_its_reason(tmp_path: Path) -> None:
    base = tl.load_scenario("textbook")
    sweep = prepare_sweep(base, build_plan(["law.kp_linear=-1:1"]), metrics=["run.duration"])
    summary = run_sweep(sweep, tmp_path / "t.parquet", jobs=1)
    assert (summary.rows, summary.failed) == (3, 2)
    reason = "grid: law.kp_linear: expected a number > 0, found -1.0"
    assert summary.first_failure == f"row 0: {reason}"
    table = read_result_table(tmp_path / "t.parquet", kind="sweep")
    assert list_cells(table, "failed")[0] == reason
    assert list_cells(table, "failed")[2] is None
    assert list_cells(table, "run.duration")[:2] == [None, None]
    assert list_cells(table, "run.duration.status") == [None, None, "ok"]
    assert list_cells(table, "stop_reason")[:2] == [None, None]


def test_columns_have_the_type_that_the_scenario_has_and_units(tmp_path: Path) -> None:
    table = sweep_scenario(
        tl.load_scenario("textbook"),
        tmp_path / "t.parquet",
        *("law.kp_linear=1:2", "loop.command_queue=7,8", "law.wrap_error=true,false"),
        "law.projection=bearing,heading",
        metrics=["rotate.settling_time", "final.heading_error"],
    )
    types = [(column.name, column.type, column.unit) for column in table.columns]
    assert types == [
        ("row", "whole", None),
        ("law.kp_linear", "real", None),
        ("loop.command_queue", "whole", None),
        ("law.wrap_error", "truth", None),
        ("law.projection", "text", None),
        ("rotate.settling_time", "real", "s"),
        ("rotate.settling_time.status", "text", None),
        ("final.heading_error", "real", "deg"),
        ("final.heading_error.status", "text", None),
        ("stop_reason", "text", None),
        ("failed", "text", None),
    ]
    assert tl.parse_scenario(table.facts["base"]) == tl.load_scenario("textbook")
    assert json.loads(table.facts["plan"])["grid"]["law.kp_linear"] == "1:2"
    assert table.version == tl.__version__


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("limits.speed_m_s", "m/s"),
        ("limits.turn_jerk_rad_s3", "rad/s^3"),
        ("limits.acceleration_m_s2", "m/s^2"),
        ("goal.x_m", "m"),
        ("goal.heading_rad", "rad"),
        ("max_duration_s", "s"),
        ("loop.transport_delay_ticks", "ticks"),
        ("law.kp_linear", None),
        ("seed", None),
        ("law.standstill_samples", None),
    ],
)
def test_unit_of_a_key_is_that_of_its_name(key: str, unit: str | None) -> None:
    assert (split_key_unit(key)[1] or None) == unit


def test_metrics_of_every_kind_are_kept(tmp_path: Path) -> None:
    base = tl.load_scenario("track-square")
    table = sweep_scenario(base, tmp_path / "t.parquet", "path.speed_m_s=0.5,0.4", metrics=["*"])
    found = tl.measure_run(tl.simulate_run(base))
    for metric in found.values():
        assert list_cells(table, metric.id)[0] == metric.value
        assert list_cells(table, f"{metric.id}.status")[0] == metric.status.value


def test_laws_that_differ_share_a_table(tmp_path: Path) -> None:
    table = sweep_scenario(
        tl.load_scenario("textbook"), tmp_path / "t.parquet", "law.kind=sequential-p,posture"
    )
    first = list_cells(table, "rotate.overshoot")
    assert first[0] is not None
    assert first[1] is None
    assert list_cells(table, "rotate.overshoot.status") == ["ok", None]
    assert all(value is not None for value in list_cells(table, "run.duration"))


def test_valueless_metrics_are_named(tmp_path: Path) -> None:
    asked = ["align.overshoot", "x*.overshoot", "run.duration"]
    sweep = prepare_sweep(
        tl.load_scenario("textbook"), build_plan(["law.kp_linear=1:2"]), metrics=asked
    )
    summary = run_sweep(sweep, tmp_path / "t.parquet")
    assert summary.valueless == {
        "align.overshoot": "no_phase",
        "x*.overshoot": "no loop has that name",
    }


def test_runs_that_meet_a_condition_are_recorded(tmp_path: Path) -> None:
    records = RowRecords(
        folder=str(tmp_path / "runs"), where="translate.settling_time > 6 and law.kp_linear < 2"
    )
    table = sweep_scenario(
        tl.load_scenario("textbook"),
        tmp_path / "t.parquet",
        "law.kp_linear=1:4",
        metrics=["run.duration"],
        records=records,
    )
    assert table.find("translate.settling_time") is None
    (path,) = (tmp_path / "runs").iterdir()
    assert path.name == "row-000000.mcap"
    run = tl.read_run(path)
    assert run.name == "textbook row 0"
    expected = tl.simulate_run(load_row_scenario(tmp_path / "t.parquet", 0))
    assert run.poses.xy_m.tolist() == expected.poses.xy_m.tolist()
    assert table.facts["recorded"] == "1"


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("translate.settling_time", "expected a condition, found 1.0"),
        ("nothing > 5", 'unknown name "nothing"'),
        ("always(speed < 1)", "it needs signals over time"),
        ("translate.settling_time >", "column"),
    ],
)
def test_condition_that_no_row_could_answer_is_refused(
    where: str, message: str, tmp_path: Path
) -> None:
    records = RowRecords(folder=str(tmp_path / "runs"), where=where)
    with pytest.raises(tl.TurtlelogError, match="--record-where") as caught:
        prepare_sweep(
            tl.load_scenario("textbook"), build_plan(["law.kp_linear=1:4"]), records=records
        )
    assert message in str(caught.value)


LAW = """
from dataclasses import dataclass
from turtlelog.laws import Decision
class Own:
    @dataclass(frozen=True)
    class Parameters:
        gain: float = 1.0
    def __init__(self, parameters): self.gain = parameters.gain
    def reset(self, start, goal, path=None): pass
    def step(self, time_ns, pose):
        if self.gain > 2.5:
            raise ValueError("too much")
        stop = "there" if time_ns > 2e9 else None
        return Decision(speed_m_s=0.1 * self.gain, turn_rate_rad_s=0.2, stop_reason=stop)
"""


def test_law_of_ones_own_sweeps_on_two_cores_and_is_not_trusted_from_the_table(
    tmp_path: Path,
) -> None:
    (tmp_path / "own.py").write_text(LAW)
    kind = {"law.kind": f"{tmp_path / 'own.py'}:Own"}
    base = tl.override_scenario(tl.load_scenario("textbook"), kind)
    table = sweep_scenario(
        base, tmp_path / "t.parquet", "law.gain=1:3", metrics=["run.path_length"], jobs=2
    )
    length = list_cells(table, "run.path_length")
    assert length[1] == pytest.approx(2 * length[0], rel=1e-5)  # poses have 32 bits
    assert "too much" in list_cells(table, "failed")[2]
    scenario = load_row_scenario(tmp_path / "t.parquet", 0)
    with pytest.raises(tl.errors.ScenarioError, match="expected a built-in law, or --trust-law"):
        tl.simulate_run(scenario)
    trusted = tl.scenario.resolve_scenario(scenario, trust_law=True)
    assert tl.simulate_run(trusted).stop_reason == "there"


def test_varied_law_kind_of_a_table_is_not_trusted(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(LAW)
    grid = f"law.kind={tmp_path / 'own.py'}:Own,posture"
    sweep_scenario(tl.load_scenario("textbook"), tmp_path / "t.parquet", grid)
    with pytest.raises(tl.errors.ScenarioError, match="expected a built-in law, or --trust-law"):
        tl.simulate_run(load_row_scenario(tmp_path / "t.parquet", 0))
    assert tl.simulate_run(load_row_scenario(tmp_path / "t.parquet", 1)).stop_reason is not None


@pytest.mark.parametrize("row", [-1, 2])
def test_row_that_is_not_there_is_one_line(row: int, tmp_path: Path) -> None:
    output = tmp_path / "t.parquet"
    sweep_scenario(tl.load_scenario("textbook"), output, "law.kp_linear=1:2")
    with pytest.raises(tl.errors.SweepError, match=f"expected a row from 0 to 1, found {row}"):
        load_row_scenario(output, row)


def test_untrusted_base_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(LAW)
    tables = {"law": {"kind": f"{tmp_path / 'own.py'}:Own"}}
    base = tl.scenario.build_scenario(tables, source="somebody.mcap")
    plan = build_plan(["law.gain=1:2"])
    with pytest.raises(
        tl.errors.ScenarioError, match=r"somebody\.mcap: law.kind: expected a built-in law"
    ):
        prepare_sweep(base, plan)
    assert prepare_sweep(base, plan, trust_law=True).plan.row_count == 2


@pytest.mark.thorough
def test_compiled_rows_go_to_a_cluster_in_large_chunks(tmp_path: Path) -> None:
    """Each takes about half a second there, as in this process."""
    pytest.importorskip("numba")
    sizes: list[int] = []

    class Here(Executor):
        def submit(self, work: Any, chunk: Any, /) -> "Future[Any]":  # type: ignore[override]
            sizes.append(len(chunk.values))
            future: Future[Any] = Future()
            if len(sizes) == 1:  # the others are never waited for
                future.set_result(work(chunk))
            return future

    base = tl.override_scenario(tl.load_scenario("textbook"), {"max_duration_s": 0.5})
    sweep = prepare_sweep(base, build_plan(["seed=0:999999"]), metrics=["run.duration"])
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep, tmp_path / "t.parquet", jobs=Here(), watch=_stop_beyond_two)
    assert sizes[:-1] == [4096] * 244


def _stop_beyond_two(done: int) -> None:
    if done > 2:
        raise KeyboardInterrupt
