"""States and reference poses of a law: written live and at once, read, recovered, exported."""

import csv
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from tests.log.recording.strange import make_strange
from tests.log.recording.ticks import assert_same_columns, make_scenario, record
from tests.log.runs import STRANGE, assert_same, make_run
from tests.log.strict import check_strictly
from tests.strange_law import KIND
from tests.torture.outcomes import sample_harms
from tests.torture.recordings import pack_again, record_scenario
from turtlelog.errors import LogError
from turtlelog.log import (
    PartialRecordingWarning,
    Recorder,
    RecordingTail,
    TopicColumns,
    export_csv,
    export_rosbag2,
    read_columns,
    read_info,
    read_recording,
    recover_recording,
    write_columns,
    write_recording,
)
from turtlelog.log.recording.head import HEAD, format_head
from turtlelog.log.recording.run_writer import describe_run
from turtlelog.log.recording.topics import (
    CONTROL,
    LAW_STATE,
    POSE,
    REFERENCE,
    REFERENCE64,
    define_types,
)
from turtlelog.run import Origin, Run
from turtlelog.simulate import Tick, iterate_ticks, simulate_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return simulate_run(make_strange(tmp_path_factory.mktemp("laws")))


def write_changed(run: Run, path: Path, changes: Mapping[str, Any]) -> Path:
    """Write a run whose topics are changed; None leaves one out."""
    write_recording(run, path)
    topics = {**read_columns(path), **changes}
    kept = [columns for columns in topics.values() if columns is not None]
    types = define_types(run.declaration, run.parameters.get("law.kind", ""))
    head = {HEAD: format_head(describe_run(run))}
    others = {columns.type: f"float64 {name}\n" for columns in kept for name in columns.fields}
    write_columns(kept, path, definitions={**others, **types}, metadata=head)
    return path


def take(columns: TopicColumns, rows: Any) -> TopicColumns:
    return replace(
        columns,
        log_time_ns=columns.log_time_ns[rows],
        publish_time_ns=columns.publish_time_ns[rows],
        sequence=columns.sequence[rows],
        fields={name: values[rows] for name, values in columns.fields.items()},
    )


def test_a_strange_law_comes_back_to_the_last_bit(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    check_strictly(tmp_path / "a.mcap")
    found = read_recording(tmp_path / "a.mcap")
    assert_same(found, run)
    assert (found.declaration, found.phase_names) == (run.declaration, run.phase_names)
    assert found.phase_names == ("two", "one", "pause", "done")
    references = found.samples.reference_heading_rad
    assert references is not None
    assert 0 < np.isnan(references).sum() < len(references)
    assert found.samples.world_velocity_m_s is not None
    assert np.isnan(found.samples.world_velocity_m_s).all(axis=1).sum() == len(references) - 1


@pytest.mark.parametrize("goal", ["goal", "no goal"])
def test_a_strange_law_is_the_same_live_and_at_once(goal: str, tmp_path: Path) -> None:
    uses_goal = goal == "goal"
    scenario = make_strange(tmp_path, uses_goal=uses_goal, goal__heading_rad=1.0)
    live, once = tmp_path / "live.mcap", tmp_path / "once.mcap"
    record(live, scenario)
    check_strictly(live)
    run = simulate_run(scenario)
    write_recording(run, once)
    assert_same_columns(live, once)
    for path in (live, once):
        assert_same(read_recording(path), run)
    assert (run.goal_xy_m is None, run.samples.bearing_rad is None) == (not uses_goal,) * 2
    names = {topic.topic for topic in read_info(live).topics}
    assert ("/turtle1/goal" in names) == uses_goal
    assert {LAW_STATE, REFERENCE.name, REFERENCE64.name} <= names


def test_a_law_that_hesitates_between_its_phases_is_the_same_live_and_at_once(
    tmp_path: Path,
) -> None:
    scenario = make_scenario("textbook", law__kind=KIND, law__gain_a=4.0)
    record(tmp_path / "live.mcap", scenario)
    write_recording(simulate_run(scenario), tmp_path / "once.mcap")
    assert_same_columns(tmp_path / "live.mcap", tmp_path / "once.mcap")
    assert_same(read_recording(tmp_path / "live.mcap"), simulate_run(scenario))
    phases = read_columns(tmp_path / "live.mcap")["/turtle1/phase"].fields["data"].tolist()
    assert phases == ["one", "pause", "two", "done"]


def test_phases_of_a_strange_law_are_told_by_name(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    found = read_columns(tmp_path / "a.mcap")["/turtle1/phase"]
    assert found.fields["data"].tolist() == ["two", "pause", "one", "done"]


def test_a_live_recording_without_its_end_lacks_what_no_sample_has(tmp_path: Path) -> None:
    scenario = make_strange(tmp_path, uses_goal=False, max_duration_s=0.1)
    recorder, ticks = Recorder(tmp_path / "a.mcap", scenario), list[Tick]()
    for tick in iterate_ticks(scenario):
        recorder.receive(tick)
        ticks.append(tick)
    recorder.flush()
    (tmp_path / "b.mcap").write_bytes((tmp_path / "a.mcap").read_bytes())
    recorder.close()
    with pytest.warns(PartialRecordingWarning):
        found = read_recording(tmp_path / "b.mcap", allow_partial=True)
    expected = replace(simulate_run(scenario), stop_reason=None, notes=found.notes)
    expected = replace(expected, origin=Origin(lost="rows"))
    assert_same(found, expected)
    assert found.samples.world_velocity_m_s is None


def test_a_tail_sees_states_and_references(run: Run, tmp_path: Path) -> None:
    scenario = make_strange(tmp_path)
    with Recorder(tmp_path / "a.mcap", scenario) as recorder:
        ticks = list(iterate_ticks(scenario))
        for tick in ticks[:30]:
            recorder.receive(tick)
        recorder.flush()
        with RecordingTail(tmp_path / "a.mcap") as tail:
            found = tail.read_run()
            assert found is not None
            rows = len(found.samples)
            assert found.samples.states is not None
            assert run.samples.states is not None
            assert_same(found.samples.states, run.samples.states[:rows].copy())
            for tick in ticks[30:]:
                recorder.receive(tick)
            recorder.close()
            assert_same(tail.read_last_run().samples.states, run.samples.states)


def test_lost_rows_take_their_samples_with_them(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    topics = read_columns(tmp_path / "a.mcap")
    states, exact = topics[LAW_STATE], topics[REFERENCE64.name]
    changes = {LAW_STATE: take(states, states.sequence != 30)}
    changes[REFERENCE64.name] = take(exact, exact.sequence != 4)
    path = write_changed(run, tmp_path / "b.mcap", changes)
    with pytest.raises(LogError, match=r"law_state: expected the numbers of the 40 samples"):
        read_recording(path)
    damaged = bytearray(path.read_bytes())
    damaged[-20] ^= 1
    path.write_bytes(damaged)
    with pytest.warns(PartialRecordingWarning, match="; 2 samples without their pose, states or"):
        found = read_recording(path, allow_partial=True)
    kept = ~np.isin(run.samples.sequence, [4, 30])
    assert found.samples.sequence.tolist() == run.samples.sequence[kept].tolist()
    for name in ("states", "reference_xy_m", "reference_heading_rad", "speed_m_s"):
        assert_same(getattr(found.samples, name), getattr(run.samples, name)[kept], name)


def test_a_sample_of_a_lost_pose_takes_its_states_with_it(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    poses = read_columns(tmp_path / "a.mcap")[POSE.name]
    path = write_changed(run, tmp_path / "b.mcap", {POSE.name: take(poses, poses.sequence != 10)})
    recovered = tmp_path / "c.mcap"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - 40])
    recover_recording(path, recovered)
    found = read_recording(recovered)
    kept = run.samples.pose_sequence != 10
    assert len(found.samples) == len(run.samples) - 1
    assert run.samples.states is not None
    assert_same(found.samples.states, run.samples.states[kept])


@pytest.mark.thorough
def test_no_damage_moves_a_state_to_another_sample(tmp_path: Path) -> None:
    sound = record_scenario(make_strange(tmp_path, max_duration_s=0.5), tmp_path, "zstd")
    path, parts = tmp_path / "damaged.mcap", 0
    whole = read_recording(tmp_path / "whole.mcap").samples
    assert whole.reference_heading_rad is not None
    for harm in sample_harms(sound, 60, seed=3):
        path.write_bytes(harm.apply(sound))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", PartialRecordingWarning)
                found = read_recording(path, allow_partial=True).samples
        except LogError:
            continue
        at = np.searchsorted(whole.sequence, found.sequence)
        parts += 0 < len(at) < len(whole)
        for name in ("sequence", "states", "speed_m_s"):
            assert_same(getattr(found, name), getattr(whole, name)[at], f"{name} of {harm}")
        assert found.reference_heading_rad is not None
        headings, is_lost = whole.reference_heading_rad[at], np.isnan(found.reference_heading_rad)
        assert (found.reference_heading_rad == headings)[~is_lost].all()
        # In phase one no loop asks for a reference: a sample stays without the one it had.
        assert not is_lost[found.phase == 0].any()
    assert parts > 10


def test_recovery_keeps_states_and_references(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    (tmp_path / "cut.mcap").write_bytes(pack_again((tmp_path / "a.mcap").read_bytes(), "zstd"))
    data = (tmp_path / "cut.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    report = recover_recording(tmp_path / "cut.mcap", tmp_path / "whole.mcap")
    assert report.recovered[LAW_STATE] > 0
    found = read_recording(tmp_path / "whole.mcap")
    at = np.isin(run.samples.sequence, found.samples.sequence)
    assert 0 < at.sum() < len(run.samples)
    for name in ("states", "reference_heading_rad", "speed_m_s"):
        assert_same(getattr(found.samples, name), getattr(run.samples, name)[at], name)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"fields": {"luck": np.zeros(40)}}, "law_state: expected the declared states, each a f"),
        ({"type": "turtlelog_msgs/msg/Other"}, None),
        ({"sequence": np.arange(40, dtype=np.uint32) + 1}, "expected the numbers of the 40 sam"),
        ({"sequence": np.arange(40, dtype=np.uint32) * 0}, "expected the numbers of the 40 sam"),
    ],
)
def test_states_are_judged_by_the_declaration(
    change: dict[str, Any], expected: str | None, run: Run, tmp_path: Path
) -> None:
    write_recording(run, tmp_path / "a.mcap")
    columns = replace(read_columns(tmp_path / "a.mcap")[LAW_STATE], **change)
    if "fields" in change:
        columns = replace(columns, type="turtlelog_msgs/msg/Luck")
    topics = {**read_columns(tmp_path / "a.mcap"), LAW_STATE: columns}
    path, types = tmp_path / "b.mcap", dict(define_types(run.declaration, "f.py:Strange"))
    types["turtlelog_msgs/msg/Luck"] = "float64 luck\n"
    types["turtlelog_msgs/msg/Other"] = types["turtlelog_msgs/msg/StrangeState"]
    head = {HEAD: format_head(describe_run(run))}
    write_columns([*topics.values()], path, definitions=types, metadata=head)
    if expected is None:
        assert_same(read_recording(path).samples.states, run.samples.states)
    else:
        with pytest.raises(LogError, match=rf"\A\S+b\.mcap: .*{expected}"):
            read_recording(path)


@pytest.mark.parametrize("numbers", [[1, 1], [2, 1], [1, 99]], ids=["twice", "back", "of none"])
def test_references_of_no_sample_are_refused(numbers: list[int], run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    exact = take(read_columns(tmp_path / "a.mcap")[REFERENCE64.name], [0, 1])
    exact = replace(exact, sequence=np.array(numbers, dtype=np.uint32))
    path = write_changed(run, tmp_path / "b.mcap", {REFERENCE64.name: exact})
    with pytest.raises(LogError, match="reference64: expected numbers of the 40 samples, each onc"):
        read_recording(path)


def test_a_topic_that_nobody_declares_is_left_alone(tmp_path: Path) -> None:
    made = make_run(np.ones(4))
    bare = replace(
        made,
        declaration=replace(STRANGE, states=(), loops=STRANGE.loops[1:], phases={"x": (), "y": ()}),
        samples=replace(made.samples, states=None, reference_xy_m=None, reference_heading_rad=None),
    )
    write_recording(made, tmp_path / "made.mcap")
    more = {
        name: columns
        for name, columns in read_columns(tmp_path / "made.mcap").items()
        if name in {LAW_STATE, REFERENCE.name, REFERENCE64.name}
    }
    write_recording(bare, tmp_path / "a.mcap")
    topics = {**read_columns(tmp_path / "a.mcap"), **more}
    types = define_types(STRANGE)
    head = {HEAD: format_head(describe_run(bare))}
    write_columns([*topics.values()], tmp_path / "b.mcap", definitions=types, metadata=head)
    assert_same(read_recording(tmp_path / "b.mcap"), bare)


def test_other_tools_see_states_and_references(run: Run, tmp_path: Path) -> None:
    export_rosbag2(run, tmp_path / "bag")
    states, headings = [], {}
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, _, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            if connection.topic == LAW_STATE:
                states.append([message.integral, message.time_ns])
            elif connection.topic == REFERENCE.name:
                turn = 2.0 * np.arctan2(message.pose.orientation.z, message.pose.orientation.w)
                headings[message.pose.position.x] = turn
    assert run.samples.states is not None
    assert states == run.samples.states.tolist()
    assert run.samples.reference_xy_m is not None
    assert run.samples.reference_heading_rad is not None
    expected = zip(run.samples.reference_xy_m[:, 0], run.samples.reference_heading_rad, strict=True)
    for x_m, heading_rad in expected:
        assert np.isnan(x_m) or np.cos(headings[x_m] - heading_rad) == pytest.approx(1.0)
    assert "StrangeState" in (tmp_path / "bag" / "metadata.yaml").read_text()


def test_states_and_references_are_columns_of_a_table(run: Run, tmp_path: Path) -> None:
    export_csv(run, tmp_path / "samples.csv", table="samples")
    with (tmp_path / "samples.csv").open(newline="") as stream:
        heads, *rows = csv.reader(stream)
    columns = {head: [row[place] for row in rows] for place, head in enumerate(heads)}
    samples = run.samples
    assert samples.states is not None
    assert samples.reference_heading_rad is not None
    assert [float(text) for text in columns["integral"]] == samples.states[:, 0].tolist()
    # The table has a column time_ns of its own.
    assert [float(text) for text in columns["state_time_ns"]] == samples.states[:, 1].tolist()
    assert [int(text) for text in columns["time_ns"]] == samples.time_ns.tolist()
    assert columns["phase"] == ["two"] * 20 + ["one"] * 20
    found = np.array([float(text) for text in columns["reference_heading_rad"]])
    np.testing.assert_array_equal(found, samples.reference_heading_rad)
    assert {"reference_x_m", "reference_y_m"} <= columns.keys()


def test_any_reference_heading_comes_back(tmp_path: Path) -> None:
    values = np.array([3.0, -0.0, 1e300, np.nextafter(np.pi, 4.0), 5e-324, 123.456])
    run = make_run(values)
    write_recording(run, tmp_path / "a.mcap")
    assert_same(read_recording(tmp_path / "a.mcap"), run)


def test_a_changed_declaration_is_told_by_the_checksum(run: Run, tmp_path: Path) -> None:
    write_recording(run, tmp_path / "a.mcap")
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(
        data.replace(b'"states":["integral"', b'"states":["intfgral"')
    )
    with pytest.raises(LogError, match="expected checksum"):
        read_info(tmp_path / "a.mcap")


def test_no_row_of_a_control_sample_is_read_without_its_states(run: Run, tmp_path: Path) -> None:
    path = write_changed(run, tmp_path / "a.mcap", {LAW_STATE: None})
    assert CONTROL.name in read_columns(path)
    with pytest.raises(
        LogError, match="law_state: expected the numbers of the 40 samples, found 0"
    ):
        read_recording(path)
