import math
import pickle
import re
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np
import pytest

from tests.sequential import DECLARATION, DONE, ROTATE, TRANSLATE
from turtlelog.errors import RunError
from turtlelog.measure import measure_run
from turtlelog.run import (
    CommandColumns,
    PhaseSpan,
    PoseColumns,
    Run,
    SampleColumns,
    SourceKind,
    find_source_kind,
)
from turtlelog.run.loops import Declaration
from turtlelog.scenario import get_preset
from turtlelog.simulate import simulate_run

Columns = PoseColumns | CommandColumns | SampleColumns

RUN = simulate_run(get_preset("textbook"))


def make_poses(rows: int = 4, **changes: Any) -> PoseColumns:
    columns: dict[str, Any] = {
        "time_ns": np.arange(rows) * 10,
        "xy_m": np.zeros((rows, 2)),
        "heading_rad": np.zeros(rows),
        "speed_m_s": np.zeros(rows),
        "turn_rate_rad_s": np.zeros(rows),
        "measured_speed_m_s": np.zeros(rows),
        "measured_turn_rate_rad_s": np.zeros(rows),
        "sensed_xy_m": np.zeros((rows, 2)),
        "height_m": np.zeros(rows),
        "tilt_rad": np.zeros(rows),
        "sensed_heading_rad": np.zeros(rows),
    }
    return PoseColumns(**(columns | changes))


def make_commands(rows: int = 4, **changes: Any) -> CommandColumns:
    columns: dict[str, Any] = {
        "time_ns": np.arange(rows) * 10,
        "speed_m_s": np.zeros(rows),
        "lateral_speed_m_s": np.zeros(rows),
        "turn_rate_rad_s": np.zeros(rows),
    }
    return CommandColumns(**(columns | changes))


def make_samples(rows: int = 4, **changes: Any) -> SampleColumns:
    columns: dict[str, Any] = {
        "time_ns": np.arange(rows) * 10,
        "sequence": np.arange(rows),
        "pose_sequence": np.arange(rows),
        "phase": np.zeros(rows, dtype=np.int64),
        "error_xy_m": np.zeros((rows, 2)),
        "world_velocity_m_s": np.zeros((rows, 2)),
        "reference_xy_m": np.zeros((rows, 2)),
        "states": np.zeros((rows, 1)),
    }
    for column in fields(SampleColumns):
        columns.setdefault(column.name, np.zeros(rows))
    return SampleColumns(**(columns | changes))


MAKERS: dict[str, Callable[..., Columns]] = {
    "pose": make_poses,
    "command": make_commands,
    "sample": make_samples,
}
COLUMNS = [
    (table, column.name) for table, make in MAKERS.items() for column in fields(make(rows=1))
]
NUMBERS = [
    (table, name)
    for table, name in COLUMNS
    if getattr(MAKERS[table](rows=1), name).dtype.kind == "f"
]


PARTIAL = {
    *("world_velocity_m_s", "reference_xy_m", "reference_heading_rad"),
    *("sensed_xy_m", "sensed_heading_rad", "height_m", "tilt_rad"),
}


def make_run(**changes: Any) -> Run:
    parts: dict[str, Any] = {
        "name": "run",
        "source": "test",
        "poses": make_poses(),
        "commands": make_commands(),
        "samples": make_samples(),
        "declaration": replace(DECLARATION, states=("memory",)),
    }
    return Run(**(parts | changes))


def match_whole(text: str) -> str:
    return rf"\A{re.escape(text)}\Z"


@pytest.mark.parametrize(("table", "name"), [c for c in COLUMNS if c[1] != "time_ns"])
def test_column_of_another_length_is_refused(table: str, name: str) -> None:
    short = getattr(MAKERS[table](rows=3), name)
    expected = (4, *short.shape[1:])
    line = f"{table}.{name}: expected shape {expected}, found {short.shape}"
    with pytest.raises(RunError, match=match_whole(line)):
        MAKERS[table](rows=4, **{name: short})


@pytest.mark.parametrize(
    ("make", "name", "shape"),
    [
        (make_poses, "xy_m", (4,)),
        (make_poses, "xy_m", (4, 3)),
        (make_samples, "error_xy_m", (2, 4)),
        (make_samples, "world_velocity_m_s", (4,)),
        (make_commands, "speed_m_s", (4, 2)),
    ],
)
def test_column_of_another_width_is_refused(
    make: Callable[..., Columns], name: str, shape: tuple[int, ...]
) -> None:
    with pytest.raises(
        RunError, match=rf"\.{name}: expected shape .*, found {re.escape(str(shape))}"
    ):
        make(**{name: np.zeros(shape)})


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("table", "name"), NUMBERS)
def test_row_that_is_no_number_is_named(table: str, name: str, bad: float) -> None:
    if np.isnan(bad) and name in PARTIAL:
        pytest.skip("a sample need not have one")
    values = np.zeros_like(getattr(MAKERS[table](), name))
    values[2] = bad
    line = f"{table}.{name}[2]: expected a number, found {values[2]}"
    with pytest.raises(RunError, match=match_whole(line)):
        MAKERS[table](**{name: values})


@pytest.mark.parametrize("time_ns", [[0, 20, 10, 30], [0, 10, 10, 30]], ids=["backward", "stuck"])
def test_pose_times_advance(time_ns: list[int]) -> None:
    line = (
        f"pose.time_ns: expected strictly increasing values, found 10 after {time_ns[1]} at row 2"
    )
    with pytest.raises(RunError, match=match_whole(line)):
        make_poses(time_ns=np.array(time_ns))


@pytest.mark.parametrize(("table", "make"), [("command", make_commands), ("sample", make_samples)])
def test_command_and_sample_times_do_not_go_back(table: str, make: Callable[..., Columns]) -> None:
    line = f"{table}.time_ns: expected not decreasing values, found 10 after 20 at row 2"
    with pytest.raises(RunError, match=match_whole(line)):
        make(time_ns=np.array([0, 20, 10, 30]))


@pytest.mark.parametrize("make", [make_commands, make_samples])
def test_samples_of_a_burst_share_one_time(make: Callable[..., Columns]) -> None:
    assert len(make(time_ns=np.array([0, 10, 10, 10]))) == 4


@pytest.mark.parametrize("sequence", [[0, 2, 1, 3], [0, 1, 1, 2]], ids=["backward", "stuck"])
def test_sample_numbers_advance(sequence: list[int]) -> None:
    with pytest.raises(RunError, match=r"\Asample\.sequence: expected strictly increasing values"):
        make_samples(sequence=np.array(sequence))


@pytest.mark.parametrize("phase", [-1, 4])
def test_unknown_phase_is_refused(phase: int) -> None:
    line = f"sample.phase[1]: expected 0 to 3, found {phase}"
    with pytest.raises(RunError, match=match_whole(line)):
        make_run(samples=make_samples(phase=np.array([0, phase, 0, 0])))


def test_states_that_are_not_declared_are_refused() -> None:
    line = "sample.states: expected 1 columns, found 2"
    with pytest.raises(RunError, match=match_whole(line)):
        make_run(samples=make_samples(states=np.zeros((4, 2))))


@pytest.mark.parametrize("row", [-1, 4])
def test_sample_of_a_pose_that_is_not_there_is_refused(row: int) -> None:
    told = f"answers pose {row}, but the poses are numbered 0 to 3"
    line = f"controller sample 3 (pose_sequence): {told}"
    with pytest.raises(RunError, match=match_whole(line)):
        make_run(samples=make_samples(pose_sequence=np.array([0, 1, 2, row])))


def test_run_without_poses_is_refused() -> None:
    with pytest.raises(RunError, match=match_whole("poses: must have at least one row")):
        make_run(poses=make_poses(rows=0), samples=make_samples(rows=0))


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_tables_may_have_no_rows(make: Callable[..., Columns]) -> None:
    assert len(make(rows=0)) == 0


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (make_poses, "speed_m_s"),
        (make_poses, "turn_rate_rad_s"),
        (make_samples, "wanted_speed_m_s"),
        (make_samples, "wanted_turn_rate_rad_s"),
    ],
)
def test_column_that_was_not_recorded_is_none(make: Callable[..., Columns], name: str) -> None:
    assert getattr(make(**{name: None}), name) is None


@pytest.mark.parametrize(("table", "name"), COLUMNS)
def test_arrays_are_read_only(table: str, name: str) -> None:
    values = getattr(MAKERS[table](), name)
    with pytest.raises(ValueError, match="read-only"):
        values[0] = 1


@pytest.mark.parametrize("table", MAKERS)
def test_tables_are_frozen(table: str) -> None:
    columns = MAKERS[table]()
    with pytest.raises(FrozenInstanceError):
        columns.time_ns = np.arange(4)  # type: ignore[misc]


def test_parameters_and_notes_are_read_only() -> None:
    run = make_run(parameters={"seed": 1}, notes={"sorted_rows": "2"})
    with pytest.raises(TypeError, match="does not support item assignment"):
        run.parameters["seed"] = 2  # type: ignore[index]
    with pytest.raises(TypeError, match="does not support item assignment"):
        run.notes["sorted_rows"] = "3"  # type: ignore[index]


def test_parameters_and_notes_do_not_follow_the_mapping_they_came_from() -> None:
    parameters, notes = {"seed": 1}, {"sorted_rows": "2"}
    run = make_run(parameters=parameters, notes=notes)
    parameters["seed"] = 2
    notes.clear()
    assert (run.parameters, run.notes) == ({"seed": 1}, {"sorted_rows": "2"})


def test_run_starts_at_its_first_sample() -> None:
    samples = make_samples(time_ns=np.array([20, 20, 30, 40]))
    assert make_run(samples=samples).start_ns == 20


def test_run_without_samples_starts_at_its_first_pose() -> None:
    run = make_run(poses=make_poses(time_ns=np.arange(4) + 7), samples=make_samples(rows=0))
    assert run.start_ns == 7


@pytest.mark.parametrize("last", MAKERS)
def test_run_ends_with_the_last_row_of_any_table(last: str) -> None:
    tables: dict[str, Any] = {f"{table}s": make() for table, make in MAKERS.items()}
    tables[f"{last}s"] = MAKERS[last](time_ns=np.array([0, 10, 20, 99]))
    assert make_run(**tables).end_ns == 99


def test_run_of_poses_alone_ends_with_its_last_pose() -> None:
    run = make_run(samples=make_samples(rows=0), commands=make_commands(rows=0))
    assert (run.start_ns, run.end_ns) == (0, 30)


@pytest.mark.parametrize(
    ("stop_reason", "is_complete"),
    [(None, False), ("max_duration", False), ("standstill", True), ("within_tolerance", True)],
)
def test_run_is_complete_when_the_law_ended_it(stop_reason: str | None, is_complete: bool) -> None:  # noqa: FBT001
    assert make_run(stop_reason=stop_reason).is_complete is is_complete


def test_phases_are_named_as_declared_then_those_of_every_law() -> None:
    assert make_run().phase_names == ("rotate", "pause", "translate", "done")
    assert Declaration().phase_names == ("control", "pause", "done")


def make_run_of_phases(phase: list[int], time_ns: list[int]) -> Run:
    rows = len(phase)
    samples = make_samples(rows, phase=np.array(phase, dtype=np.int64), time_ns=np.array(time_ns))
    return make_run(poses=make_poses(rows=rows, time_ns=np.arange(rows) * 10), samples=samples)


def list_spans(run: Run) -> list[tuple[str, int, int]]:
    return [(span.phase, span.start_ns, span.end_ns) for span in run.find_phase_spans()]


def test_silence_after_the_last_rotating_sample_is_a_pause() -> None:
    phase = [ROTATE, ROTATE, ROTATE, TRANSLATE, TRANSLATE]
    run = make_run_of_phases(phase, [0, 10, 20, 500, 510])
    expected = [("rotate", 0, 20), ("pause", 20, 500), ("translate", 500, 510)]
    assert list_spans(run) == expected


def test_every_phase_has_its_own_pause() -> None:
    phase = [ROTATE, TRANSLATE, ROTATE, TRANSLATE, DONE]
    run = make_run_of_phases(phase, [0, 20, 40, 60, 80])
    labels = [label for label, _, _ in list_spans(run)]
    again = ["rotate", "pause", "translate", "pause"]
    assert labels == [*again, *again, "done"]


@pytest.mark.parametrize(("silent_ns", "is_pause"), [(10, False), (14, False), (15, True)])
def test_a_pause_is_longer_than_the_sampling_period(silent_ns: int, *, is_pause: bool) -> None:
    times_ns = [0, 10, 20 + silent_ns - 10, 30 + silent_ns - 10]
    spans = list_spans(make_run_of_phases([ROTATE, ROTATE, TRANSLATE, TRANSLATE], times_ns))
    rotating = [("rotate", 0, 10), ("pause", 10, 10 + silent_ns)]
    rotating = rotating if is_pause else [("rotate", 0, 10 + silent_ns)]
    assert spans == [*rotating, ("translate", 10 + silent_ns, 20 + silent_ns)]


@pytest.mark.parametrize("moves", [True, False])
def test_a_scenario_without_a_pause_has_none(*, moves: bool) -> None:
    scenario = get_preset("textbook")
    start = scenario.start
    still = replace(scenario, goal=replace(scenario.goal, x_m=start.x_m, y_m=start.y_m))
    run = simulate_run(scenario if moves else still)
    assert [span.phase for span in run.find_phase_spans()] == ["rotate", "translate"]
    assert "pause" not in run._repr_html_()


def test_a_notebook_shows_the_length_of_a_phase_that_its_metric_has() -> None:
    run = simulate_run(get_preset("paper-kp10"))
    shown = format(float(measure_run(run)["rotate.duration"]), ".4g")
    assert f"rotate {shown} s with its pause of 0.528 s, translate " in run._repr_html_()


def test_spans_of_a_run_join_without_gaps() -> None:
    phase = [ROTATE, ROTATE, TRANSLATE, ROTATE, TRANSLATE, DONE]
    spans = make_run_of_phases(phase, [5, 10, 25, 30, 40, 50]).find_phase_spans()
    assert [span.start_ns for span in spans[1:]] == [span.end_ns for span in spans[:-1]]
    assert (spans[0].start_ns, spans[-1].end_ns) == (5, 50)


def test_run_that_only_rotates_has_one_span() -> None:
    run = make_run_of_phases([ROTATE, ROTATE, ROTATE], [10, 20, 30])
    assert run.find_phase_spans() == (PhaseSpan(phase="rotate", start_ns=10, end_ns=30),)


@pytest.mark.parametrize(
    "commands", [make_commands(2), make_commands(3, time_ns=np.array([10, 20, 35]))]
)
def test_run_that_ends_blocked_while_rotating_ends_in_a_pause(commands: CommandColumns) -> None:
    samples = make_samples(3, time_ns=np.array([10, 20, 30]))
    run = make_run(poses=make_poses(rows=5), commands=commands, samples=samples)
    assert list_spans(run) == [("rotate", 10, 30), ("pause", 30, 40)]


def test_last_span_ends_with_the_run() -> None:
    run = make_run_of_phases([TRANSLATE, TRANSLATE], [0, 10])
    assert list_spans(run) == [("translate", 0, run.end_ns)]


def test_run_without_samples_has_no_spans() -> None:
    assert make_run(samples=make_samples(rows=0)).find_phase_spans() == ()


def test_a_run_comes_back_from_a_pickle_frozen() -> None:
    run = simulate_run(get_preset("paper-kp4"))
    same = pickle.loads(pickle.dumps(run))
    assert np.array_equal(same.poses.xy_m, run.poses.xy_m)
    assert same.parameters == run.parameters
    with pytest.raises(ValueError, match="read-only"):
        same.poses.xy_m[0, 0] = 1.0


@pytest.mark.parametrize("name", ["", "two\nlines", "\x1b[31m"])
def test_a_name_that_cannot_be_printed_is_refused(name: str) -> None:
    with pytest.raises(RunError, match=r"\Aname: expected printable text, found '.*'\Z"):
        replace(simulate_run(get_preset("textbook")), name=name)


def test_a_heading_in_degrees_is_refused() -> None:
    poses = simulate_run(get_preset("textbook")).poses
    with pytest.raises(RunError, match=r"pose\.heading_rad\[0\]: expected -pi to pi, found 90"):
        replace(poses, heading_rad=np.full(len(poses), 90.0))


def test_times_at_both_ends_of_64_bits_are_told_apart() -> None:
    commands = simulate_run(get_preset("textbook")).commands
    time_ns = np.full(len(commands), 2**63 - 1)
    time_ns[1:] = -(2**63)
    with pytest.raises(RunError, match=r"command\.time_ns: expected not decreasing"):
        replace(commands, time_ns=time_ns)


@pytest.mark.parametrize(
    "goal", [(1.0,), (1.0, 2.0, 3.0), "ab", 5, (math.nan, 0.0), (0.0, math.inf)], ids=repr
)
def test_run_refuses_what_is_no_goal(goal: Any) -> None:
    with pytest.raises(RunError, match="goal_xy_m: expected two finite numbers"):
        replace(RUN, goal_xy_m=goal)


def test_run_refuses_a_heading_of_the_goal_that_is_no_number() -> None:
    with pytest.raises(RunError, match="goal_heading_rad: expected a finite number"):
        replace(RUN, goal_heading_rad=math.nan)


@pytest.mark.parametrize("name", ["poses", "commands", "samples"])
def test_run_refuses_what_are_no_columns(name: str) -> None:
    wrong: Any = {name: None}
    with pytest.raises(RunError, match=f"{name}: expected [A-Z][a-z]+Columns, found NoneType"):
        replace(RUN, **wrong)


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("time_ns", lambda n: list(range(n)), "pose.time_ns: expected a numpy array, found list"),
        ("time_ns", lambda n: np.arange(n) * 0.016, "expected whole numbers, found float64"),
        ("heading_rad", lambda n: np.zeros(n, dtype=complex), "expected floats, found complex128"),
        ("heading_rad", lambda n: np.array(["a"] * n), "pose.heading_rad: expected floats"),
        ("heading_rad", lambda n: None, "pose.heading_rad: expected a numpy array, found NoneType"),
    ],
)
def test_columns_refuse_what_is_no_array_of_their_kind(
    column: str, values: Any, message: str
) -> None:
    wrong: Any = {column: values(len(RUN.poses))}
    with pytest.raises(RunError, match=message):
        replace(RUN.poses, **wrong)


@pytest.mark.parametrize("kind", SourceKind)
def test_the_kind_of_a_source_is_read_from_its_words(kind: SourceKind) -> None:
    name = "" if kind is SourceKind.SIMULATION else "kp4.csv"
    assert find_source_kind(kind.describe(name)) is kind


@pytest.mark.parametrize("source", ["simulation of mine", "mcap: kp4", "my table: kp4.csv", ""])
def test_a_source_in_other_words_has_no_kind(source: str) -> None:
    assert find_source_kind(source) is None
