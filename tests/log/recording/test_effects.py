"""Sensed poses and shaped commands: written live and at once, read, recovered, exported."""

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.log.recording.test_law_state import take
from tests.log.recording.ticks import assert_same_columns, make_scenario, record_ticks
from tests.log.runs import assert_same
from tests.log.strict import check_strictly
from tests.torture.outcomes import sample_harms
from tests.torture.recordings import pack_again
from turtlelog import read_run
from turtlelog.arithmetic import to_float32
from turtlelog.errors import LogError
from turtlelog.log import (
    PartialRecordingWarning,
    Recorder,
    RecordingTail,
    TopicColumns,
    export_csv,
    export_parquet,
    export_rosbag2,
    read_columns,
    read_info,
    read_recording,
    recover_recording,
    write_columns,
    write_recording,
)
from turtlelog.log.exported_tables import import_tables
from turtlelog.log.recording.head import HEAD, format_head
from turtlelog.log.recording.run_writer import describe_run
from turtlelog.log.recording.topics import CONTROL, POSE, SCHEMAS, SENSED, SENSED64, SHAPED
from turtlelog.run import Run
from turtlelog.scenario import Scenario
from turtlelog.simulate import SampleRow, Tick, collect_run, iterate_ticks

ROWS = 60


def make_noisy(precision: str = "float32") -> Scenario:
    return make_scenario(
        "textbook",
        max_duration_s=0.016 * (ROWS - 1),
        loop__period_ticks=2,
        loop__pose_precision=precision,
        sensing__noise_position_m=0.01,
        shaping__low_pass_s=0.1,
    )


def disturb_ticks(scenario: Scenario, seed: int = 1) -> Iterator[Tick]:
    """Yield ticks whose poses are sensed with noise; of those that nobody reads some drop out."""
    random = np.random.default_rng(seed)
    for number, tick in enumerate(iterate_ticks(scenario)):
        x_m, y_m, heading_rad = random.normal(size=3).tolist()
        if scenario.loop.pose_precision == "float32":
            x_m, y_m, heading_rad = map(to_float32, (x_m, y_m, heading_rad))
        if number % 6 == 1:
            x_m = y_m = heading_rad = np.nan
        row = replace(tick.row, sensed_x_m=x_m, sensed_y_m=y_m, sensed_heading_rad=heading_rad)
        computed = tuple(shape(sample) for sample in tick.computed)
        yield msgspec.structs.replace(tick, row=row, computed=computed)


def shape(sample: SampleRow) -> SampleRow:
    speed, turn_rate = sample.wanted_speed_m_s, sample.wanted_turn_rate_rad_s
    return replace(sample, shaped_speed_m_s=speed / 3.0, shaped_turn_rate_rad_s=turn_rate / 3.0)


def build_run(scenario: Scenario, ticks: list[Tick]) -> Run:
    run = collect_run(scenario, ticks)
    rows = [tick.row for tick in ticks]
    sensed = np.array([(row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad) for row in rows])
    shaped = [sample for tick in ticks for sample in tick.computed]
    return replace(
        run,
        poses=replace(
            run.poses, sensed_xy_m=sensed[:, :2].copy(), sensed_heading_rad=sensed[:, 2].copy()
        ),
        samples=replace(
            run.samples,
            shaped_speed_m_s=np.array([sample.shaped_speed_m_s for sample in shaped]),
            shaped_turn_rate_rad_s=np.array([sample.shaped_turn_rate_rad_s for sample in shaped]),
        ),
    )


def read_sensed(run: Run) -> NDArray[np.float64]:
    """Return x, y and heading as they were sensed, shape (n, 3)."""
    assert run.poses.sensed_xy_m is not None
    assert run.poses.sensed_heading_rad is not None
    return np.column_stack([run.poses.sensed_xy_m, run.poses.sensed_heading_rad])


def read_shaped(run: Run) -> NDArray[np.float64]:
    """Return speed and turn rate after shaping, shape (n, 2)."""
    assert run.samples.shaped_speed_m_s is not None
    assert run.samples.shaped_turn_rate_rad_s is not None
    return np.column_stack([run.samples.shaped_speed_m_s, run.samples.shaped_turn_rate_rad_s])


@pytest.fixture(scope="module")
def run() -> Run:
    """Return one in double precision, of which 32 bits would lose something."""
    scenario = make_noisy("float64")
    return build_run(scenario, [*disturb_ticks(scenario)])


def write_changed(run: Run, path: Path, changes: Mapping[str, TopicColumns | None]) -> Path:
    """Write a run whose topics are changed; None leaves one out."""
    write_recording(run, path)
    topics = {**read_columns(path), **changes}
    kept = [columns for columns in topics.values() if columns is not None]
    head = {HEAD: format_head(describe_run(run))}
    write_columns(kept, path, definitions=SCHEMAS, metadata=head)
    return path


def read_damaged(path: Path, match: str) -> Run:
    """Read a file whose checksums fail at its end, as far as it goes."""
    damaged = bytearray(path.read_bytes())
    damaged[-20] ^= 1
    path.write_bytes(damaged)
    with pytest.warns(PartialRecordingWarning, match=match):
        return read_recording(path, allow_partial=True)


def test_what_is_sensed_and_shaped_comes_back_to_the_last_bit(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    check_strictly(tmp_path / "a.mcap")
    assert_same(read_recording(tmp_path / "a.mcap"), run)
    counts = {topic.topic: topic.count for topic in read_info(tmp_path / "a.mcap").topics}
    assert counts[SENSED.name] == counts[SENSED64.name] == ROWS - ROWS // 6
    assert counts[SHAPED.name] == counts[CONTROL.name] == ROWS // 2


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_effects_are_the_same_live_and_at_once(precision: str, tmp_path: Path) -> None:
    scenario = make_noisy(precision)
    ticks = [*disturb_ticks(scenario)]
    live, once, run = tmp_path / "live.mcap", tmp_path / "once.mcap", build_run(scenario, ticks)
    record_ticks(live, scenario, ticks)
    check_strictly(live)
    write_recording(run, once)
    assert_same_columns(live, once)
    assert_same(read_recording(live), run)
    assert (SENSED64.name in read_columns(live)) == (precision == "float64")


def test_a_live_recording_without_its_end_shows_its_effects(tmp_path: Path) -> None:
    scenario = make_noisy()
    ticks = [*disturb_ticks(scenario)]
    run = build_run(scenario, ticks)
    with Recorder(tmp_path / "a.mcap", scenario) as recorder:
        for tick in ticks[:30]:
            recorder.receive(tick)
        recorder.flush()
        with RecordingTail(tmp_path / "a.mcap") as tail:
            found = tail.read_run()
    assert found is not None
    assert_same(read_sensed(found), read_sensed(run)[:30])
    assert_same(read_shaped(found), read_shaped(run)[:15])


def write_and_read(run: Run, path: Path) -> Run:
    write_recording(run, path)
    return read_recording(path)


def test_a_stretch_in_which_every_pose_drops_out_is_no_run_without_a_sensor(
    run: Run, tmp_path: Path
) -> None:
    part = run.slice(0.016, 0.016)
    assert (len(part.poses), len(part.samples)) == (1, 0)
    found = write_and_read(part, tmp_path / "a.mcap")
    assert_same(found.poses, part.poses)
    assert np.isnan(read_sensed(found)).all()


def test_a_slice_keeps_what_was_sensed_of_its_poses(run: Run, tmp_path: Path) -> None:
    part = run.slice(0.3, 0.6)
    assert_same(read_sensed(part), read_sensed(run)[19:38])
    assert_same(write_and_read(part, tmp_path / "a.mcap"), part)


def test_recordings_without_effects_say_nothing_of_them(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    plain = collect_run(make_scenario(), iterate_ticks(make_scenario(max_duration_s=0.2)))
    found = write_and_read(plain, path)
    assert found.poses.sensed_xy_m is None
    assert found.samples.shaped_speed_m_s is None
    assert b"more_topics" not in path.read_bytes()
    assert b"sensed" not in path.read_bytes()


@pytest.mark.parametrize(
    ("topic", "rows", "expected"),
    [
        (SENSED.name, [0, 2, 4], "sensed_pose: pose 6 is missing, which a sample read"),
        (SENSED64.name, [0, 2, 4], "sensed_pose64: expected the times of the 50 poses, found 3 o"),
        (SHAPED.name, [0, 1], "shaped: expected the numbers of the 30 samples, found 2 others"),
    ],
)
def test_rows_that_are_missing_in_a_whole_file_are_refused(
    topic: str, rows: list[int], expected: str, run: Run, tmp_path: Path
) -> None:
    write_recording(run, tmp_path / "a.mcap")
    columns = read_columns(tmp_path / "a.mcap")[topic]
    kept = take(columns, np.isin(columns.sequence, rows))
    path = write_changed(run, tmp_path / "b.mcap", {topic: kept})
    with pytest.raises(LogError, match=rf"\A\S+b\.mcap: topic /turtle1/{expected}"):
        read_recording(path)


@pytest.mark.parametrize("topics", [[SENSED.name, SENSED64.name], [SHAPED.name]])
def test_a_whole_topic_that_is_missing_is_refused(
    topics: list[str], run: Run, tmp_path: Path
) -> None:
    path = write_changed(run, tmp_path / "b.mcap", dict.fromkeys(topics))
    with pytest.raises(LogError, match=rf"topic {topics[0]}: (expected|pose 0)"):
        read_recording(path)


@pytest.mark.parametrize("change", [{"sequence": 1}, {"log_time_ns": 7}, {"sequence": ROWS}])
def test_sensed_poses_of_no_pose_are_refused(
    change: dict[str, int], run: Run, tmp_path: Path
) -> None:
    write_recording(run, tmp_path / "a.mcap")
    topics = read_columns(tmp_path / "a.mcap")
    changes: dict[str, TopicColumns | None] = {SENSED64.name: None}
    [(name, value)] = change.items()
    values = getattr(topics[SENSED.name], name).copy()
    values[-1] = value
    changes[SENSED.name] = replace(topics[SENSED.name], **{name: values})
    with pytest.raises(LogError, match=r"sensed_pose: expected (numbers|the times) of the"):
        read_recording(write_changed(run, tmp_path / "b.mcap", changes))


def test_a_lost_sensed_pose_takes_its_sample_with_it(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    topics, changes = read_columns(tmp_path / "a.mcap"), dict[str, TopicColumns | None]()
    for name in (SENSED.name, SENSED64.name):
        changes[name] = take(topics[name], topics[name].sequence != 8)
    changes[SHAPED.name] = take(topics[SHAPED.name], topics[SHAPED.name].sequence != 20)
    path = write_changed(run, tmp_path / "b.mcap", changes)
    found = read_damaged(
        path,
        "; 2 samples without their pose, sensed pose, shaped command, states or reference are"
        " dropped; of 11 poses none was sensed, or what was sensed is lost",
    )
    kept = ~np.isin(run.samples.pose_sequence, [8, 40])
    assert len(found.samples) == len(run.samples) - 2
    assert_same(read_shaped(found), read_shaped(run)[kept])
    expected = read_sensed(run)
    expected[8] = np.nan
    assert_same(read_sensed(found), expected)


def test_a_sensed_pose_of_a_lost_pose_is_dropped_and_counted(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    poses = read_columns(tmp_path / "a.mcap")[POSE.name]
    path = write_changed(run, tmp_path / "b.mcap", {POSE.name: take(poses, poses.sequence != 8)})
    found = read_damaged(path, "; 1 samples without.* dropped; 1 sensed poses without their pose")
    rows = np.arange(ROWS) != 8
    assert_same(read_sensed(found), read_sensed(run)[rows])


@pytest.mark.thorough
def test_no_damage_moves_what_is_sensed_to_another_pose(run: Run, tmp_path: Path) -> None:
    path, parts = tmp_path / "damaged.mcap", 0
    write_recording(run, tmp_path / "whole.mcap")
    sound = pack_again((tmp_path / "whole.mcap").read_bytes(), "zstd")
    for harm in sample_harms(sound, 40, seed=5):
        path.write_bytes(harm.apply(sound))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", PartialRecordingWarning)
                found = read_recording(path, allow_partial=True)
        except LogError:
            continue
        at = np.searchsorted(run.poses.time_ns, found.poses.time_ns)
        parts += 0 < len(at) < ROWS
        sensed, was = read_sensed(found), read_sensed(run)[at]
        assert (sensed == was)[~np.isnan(sensed)].all()
        assert not np.isnan(sensed[found.samples.pose_sequence]).any()
        at = np.searchsorted(run.samples.sequence, found.samples.sequence)
        assert_same(read_shaped(found), read_shaped(run)[at], f"{harm}")
    assert parts > 5


def test_recovery_keeps_what_is_sensed_and_shaped(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    data = pack_again((tmp_path / "a.mcap").read_bytes(), "zstd")
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    report = recover_recording(tmp_path / "cut.mcap", tmp_path / "whole.mcap")
    assert report.recovered[SENSED.name] > 0
    found = read_recording(tmp_path / "whole.mcap")
    rows = np.isin(run.poses.time_ns, found.poses.time_ns)
    assert 0 < rows.sum() < ROWS
    assert_same(read_sensed(found), read_sensed(run)[rows])
    lost = int(np.isnan(read_sensed(run)[rows, 0]).sum())
    assert f"; of {lost} poses none was sensed, or what was" in found.notes["recovered"]


def test_tables_hold_what_is_sensed_and_shaped(run: Run, tmp_path: Path) -> None:
    export_csv(run, tmp_path / "tables")
    found = import_tables(tmp_path / "tables")
    assert_same(found.poses, run.poses)
    assert_same(found.samples, run.samples)
    head = (tmp_path / "tables" / "poses.csv").read_text(encoding="utf-8").partition("\n")[0]
    assert head.strip().endswith("sensed_x_m,sensed_y_m,sensed_heading_rad")


def test_parquet_and_bags_hold_what_is_sensed_and_shaped(run: Run, tmp_path: Path) -> None:
    export_parquet(run, tmp_path / "tables")
    assert_same(import_tables(tmp_path / "tables").poses, run.poses)
    assert run.to_arrow("samples").schema.field("shaped_speed_m_s").metadata == {b"unit": b"m/s"}
    export_rosbag2(run, tmp_path / "bag")
    assert_same(read_run(tmp_path / "bag").poses, run.poses)


def test_a_file_without_our_metadata_is_read_by_its_topics(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    topics = [*read_columns(tmp_path / "a.mcap").values()]
    write_columns(topics, tmp_path / "b.mcap", definitions=SCHEMAS)
    found = read_run(tmp_path / "b.mcap")
    assert_same(read_sensed(found), read_sensed(run).astype(np.float32).astype(np.float64))
    assert "30 of /turtle1/shaped" in found.notes["not_read"]
    assert "sensed" not in found.notes["not_read"]
    moved = [
        replace(columns, log_time_ns=columns.log_time_ns + 3)
        if columns.topic == SENSED.name
        else columns
        for columns in topics
    ]
    write_columns(moved, tmp_path / "c.mcap", definitions=SCHEMAS)
    found = read_run(tmp_path / "c.mcap")
    assert found.poses.sensed_xy_m is None
    assert "50 of /turtle1/sensed_pose" in found.notes["not_read"]


def test_shaped_commands_are_no_commands_that_went_out(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    topics: dict[str, Any] = dict(read_columns(tmp_path / "a.mcap"))
    del topics["/turtle1/cmd_vel"]
    write_columns([*topics.values()], tmp_path / "b.mcap", definitions=SCHEMAS)
    assert "commands" in read_run(tmp_path / "b.mcap").absent
