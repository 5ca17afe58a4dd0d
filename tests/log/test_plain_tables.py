"""Tables that other people's programs write, as runs."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.log.plain_tables import ROWS, write
from tests.log.runs import assert_same, simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log import export_csv
from turtlelog.log.any_file import read_file_info, read_run, read_trajectory
from turtlelog.log.read_choice import ReadChoice
from turtlelog.measure import measure_run
from turtlelog.measure.signals import find_no_commands


def test_a_table_is_read_and_says_what_it_took(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "time [s],x [m],y_mm,yaw (deg),v,yaw_rate_deg_s,cmd_v,cmd_w,battery",
        *[(0, 1, 2000, 0, 0.25, 90, 0.5, 1, 12), (0.1, 1.5, 2500, 45, 0.5, 180, 0.75, 2, 12)],
    )
    run = read_run(path)
    assert (run.name, run.source) == ("drive", "table: drive.csv")
    assert run.poses.time_ns.tolist() == [0, 100_000_000]
    assert run.poses.xy_m.tolist() == [[1.0, 2.0], [1.5, 2.5]]
    assert run.poses.heading_rad == pytest.approx([0, math.pi / 4])
    assert run.poses.speed_m_s is None
    assert run.poses.measured_speed_m_s is not None
    assert run.poses.measured_speed_m_s.tolist() == [0.25, 0.5]
    assert run.poses.measured_turn_rate_rad_s == pytest.approx([math.pi / 2, math.pi])
    assert run.commands.time_ns.tolist() == [0, 100_000_000]
    assert run.commands.speed_m_s.tolist() == [0.5, 0.75]
    assert run.commands.turn_rate_rad_s.tolist() == [1.0, 2.0]
    assert run.notes["columns"] == (
        "t from time [s], x from x [m], y from y_mm [mm], heading from yaw (deg),"
        " speed from v [m/s, assumed], turn_rate from yaw_rate_deg_s [deg/s],"
        " command_speed from cmd_v [m/s, assumed], command_turn_rate from cmd_w [rad/s, assumed];"
        " not read: battery; --column command_turn_rate='cmd_w [UNIT]' names another unit"
    )
    assert "samples" in run.absent
    assert "commands" not in run.absent


@pytest.mark.parametrize(
    ("speed", "turn_rate"),
    [
        ("cmd_v", "cmd_w"),
        ("v_cmd", "omega_cmd"),
        ("command_speed", "command_turn_rate"),
        ("/cmd_vel/linear/x", "/cmd_vel/angular/z"),
        ("cmd_vel.twist.linear.x", "cmd_vel.twist.angular.z"),
        ("cmd_vx", "cmd_wz"),
        ("Cmd lin [m/s]", "Cmd ang [rad/s]"),
    ],
)
def test_commands_are_told_from_what_is_measured(
    speed: str, turn_rate: str, tmp_path: Path
) -> None:
    header = f"t,x,y,yaw,{speed},{turn_rate},odom.twist.twist.linear.x,measured_turn_rate"
    run = read_run(write(tmp_path, header, (0, 0, 0, 0, 1, 2, 3, 4)))
    assert (run.commands.speed_m_s[0], run.commands.turn_rate_rad_s[0]) == (1.0, 2.0)
    assert run.poses.measured_speed_m_s == [3.0]
    assert run.poses.measured_turn_rate_rad_s == [4.0]


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (
            "v_set_mm_s,w_ref",
            "v_set_mm_s and w_ref look like commands but are not read: --column"
            " command_speed='v_set_mm_s' --column command_turn_rate='w_ref'",
        ),
        (
            "cmd_w,desired_velocity",
            "desired_velocity looks like commands but is not read: --column"
            " command_speed='desired_velocity'",
        ),
        (
            "left_wheel_cmd,x_ref",
            "left_wheel_cmd looks like commands but is not read: --column command_speed=NAME and"
            " --column command_turn_rate=NAME name columns of the robot's own rates",
        ),
        ("cmd_v,cmd_w,v_ref", None),
        ("x_ref,theta_ref,speed_error,target_id", None),
    ],
)
def test_columns_that_look_like_commands_are_named(
    names: str, told: str | None, tmp_path: Path
) -> None:
    cells = range(len(names.split(",")))
    run = read_run(write(tmp_path, f"t,x,y,yaw,{names}", *[(t, 1, 2, 0, *cells) for t in (0, 1)]))
    assert run.notes.get("unread_commands") == told


def test_a_quaternion_about_the_vertical_axis_is_a_heading(tmp_path: Path) -> None:
    rows = [(row, 1, 2, math.sin(row / 2), math.cos(row / 2)) for row in (0, 1)]
    run = read_run(write(tmp_path, "t,x,y,orientation.z,orientation.w", *rows))
    assert run.poses.heading_rad == pytest.approx([0.0, 1.0])
    with pytest.raises(LogError, match="no column for heading"):
        read_run(write(tmp_path, "t,x,y,qx,qw", *[(row, 1, 2, 0, 1) for row in (0, 1)]))


OF_TWO_TOPICS = ",".join(
    ["__time"]
    + [f"/{topic}/pose/pose/position/{axis}" for topic in ("amcl_pose", "odom") for axis in "xy"]
    + [f"/{topic}/pose/pose/orientation/yaw" for topic in ("amcl_pose", "odom")]
)


@pytest.mark.parametrize(
    ("asked", "pose"),
    [
        ({}, (3.0, 4.0, 0.2)),
        ({"heading": "/amcl_pose/pose/pose/orientation/yaw"}, (1.0, 2.0, 0.1)),
    ],
)
def test_the_columns_of_a_pose_are_of_one_topic(
    asked: dict[str, str], pose: tuple[float, ...], tmp_path: Path
) -> None:
    rows = [(row, 1, 2, 3, 4, 0.1, 0.2) for row in (0, 1)]
    run = read_run(write(tmp_path, OF_TWO_TOPICS, *rows), columns=asked)
    found = (*run.poses.xy_m[0].tolist(), float(run.poses.heading_rad[0]))
    assert found == pytest.approx(pose)
    assert "mixed_topics" not in run.notes


def test_a_pose_of_two_topics_says_so(tmp_path: Path) -> None:
    path = write(tmp_path, OF_TWO_TOPICS, *[(row, 1, 2, 3, 4, 0.1, 0.2) for row in (0, 1)])
    own, other = "/odom/pose/pose/position", "/amcl_pose/pose/pose/orientation/yaw"
    run = read_run(path, columns={"x": f"{own}/x", "y": f"{own}/y", "heading": other})
    assert run.notes["mixed_topics"] == (
        "the pose is joined from several topics: x and y from /odom; heading from /amcl_pose"
    )


@pytest.mark.parametrize(
    ("suffix", "sign", "point"),
    [
        ("csv", ";", ","),
        ("csv", "; ", "."),
        ("tsv", "\t", ","),
        ("txt", "  ", "."),
        ("txt", " ", ","),
    ],
)
def test_delimiters_and_decimal_commas(suffix: str, sign: str, point: str, tmp_path: Path) -> None:
    rows = [sign.join(str(cell).replace(".", point) for cell in row) for row in ROWS]
    names = sign.join(["t [s]", "x", "y", "yaw [rad]"])
    path = write(tmp_path, f"# a drive\n\n{names}", *rows, "# end", suffix=suffix)
    assert read_run(path).poses.xy_m.tolist() == [[1.0, 2.0], [1.5, 2.5], [2.0, 3.0]]


@pytest.mark.parametrize(
    ("header", "first", "second"),
    [
        ("time_ns", "1700000000123456789", "1700000000223456790"),
        ("time", "1700000000123456789", "1700000000223456790"),
        ("stamp", "1700000000.123456789", "1700000000.223456790"),
        ("t_ms", "1700000000123.456789", "1700000000223.45679"),
        ("timestamp", "1700000000123456.789", "1700000000223456.790"),
        ("time", "2023-11-14T22:13:20.123456789Z", "2023-11-14 23:13:20.223456790+01:00"),
        ("time", "2023-11-14 22:13:20.123456789", "2023-11-14 22:13:20,223456790"),
    ],
)
def test_absolute_times_keep_every_digit(
    header: str, first: str, second: str, tmp_path: Path
) -> None:
    path = write(tmp_path, f"{header};x;y;yaw", (first, 0, 0, 0), (second, 1, 0, 0), sign=";")
    run = read_run(path)
    assert run.poses.time_ns.tolist() == [0, 100_000_001]
    assert run.notes["original_timestamp"] == "2023-11-14T22:13:20.123456789Z"


def test_seconds_and_nanoseconds_are_one_time(tmp_path: Path) -> None:
    header = "header.stamp.sec,header.stamp.nanosec,x,y,yaw"
    run = read_run(write(tmp_path, header, (5, 999_999_999, 0, 0, 0), (6, 1, 0, 0, 0)))
    assert run.poses.time_ns.tolist() == [0, 2]
    assert run.notes["original_timestamp"] == "5.999999999 s"


def test_quaternions_give_the_heading_and_say_a_tilt(tmp_path: Path) -> None:
    header = "t,x,y,z,qx,qy,qz,qw"
    rows = [(0, 0, 0, 0, 0, 0, math.sin(0.4), math.cos(0.4)), (1, 0, 0, 0.5, 0, 0, 0, 2)]
    run = read_run(write(tmp_path, header, *rows))
    assert run.poses.heading_rad == pytest.approx([0.8, 0.0], abs=1e-15)
    assert run.notes["plane"] == (
        "the robot leaves the plane: its height varies by 0.5 m (0 to 0.5 m); most metrics are"
        " seen from above"
    )
    path = write(tmp_path, header, rows[0], (1, 0, 0, 0, 0, 0, 0, 0))
    with pytest.raises(LogError, match="line 3, column qw: expected a rotation of a length other"):
        read_run(path)


def test_an_empty_rotation_in_the_second_run_is_found_in_its_line(tmp_path: Path) -> None:
    rows = [(row / 10, row / 50, 0, 0, 0, 0, 0, int(row != 2)) for row in (*range(20), *range(40))]
    path = write(tmp_path, "t,x,y,z,qx,qy,qz,qw", *rows)
    message = "line 24, column qw: expected a rotation of a length other than 0, found '0'"
    for reader in (read_run, read_trajectory):
        with pytest.raises(LogError, match=message):
            reader(path)


def test_columns_are_mapped_by_the_user(tmp_path: Path) -> None:
    path = write(tmp_path, "clock,east,north,psi [deg],w", (0, 1, 2, 90, 3), (20, 1, 2, 180, 3))
    columns = {"t": "clock [ms]", "x": "east", "y": "north", "heading": "psi [deg]"}
    run = read_run(path, columns=columns)
    assert run.poses.time_ns.tolist() == [0, 20_000_000]
    assert run.poses.heading_rad[0] == pytest.approx(math.pi / 2)
    in_rad = read_run(path, columns={**columns, "heading": "psi [deg] [rad]"})
    assert in_rad.notes["columns"].startswith("t from clock [ms], x from east [m, assumed]")
    assert in_rad.poses.heading_rad[0] == pytest.approx(90 - 28 * math.pi)


def test_what_a_mapping_lacks_is_one_line(tmp_path: Path) -> None:
    path = write(tmp_path, "t,x,y,psi,x", *[(0, 0, 0, 0, 0)])
    for columns, message in (
        ({"heading": "phi"}, "--column heading=phi: expected a column of the table, found t, x, y"),
        ({"heading": "psi [m]"}, r"expected a unit of rad, deg, compass, found m"),
        ({"bearing": "psi"}, "--column bearing: expected one of t, t_nanosec, x, y, z, heading"),
        (
            {"x": "x"},
            "column x: expected one of that name, found 2, #2 and #5: --column x='#2' chooses",
        ),
    ):
        with pytest.raises(LogError, match=r"drive\.csv: ") as caught:
            read_run(path, columns=columns)
        assert message in str(caught.value)


@pytest.mark.parametrize(
    ("step", "unit"),
    [
        (6.3, "rad, assumed"),  # where radians are wrapped, and where an odometer starts anew
        (40.0, "rad, assumed"),
        (329.0, "rad, assumed"),
        (331.0, "deg, as it steps by a turn of these"),
        (359.0, "deg, as it steps by a turn of these"),
        (362.0, "rad, assumed"),
    ],
)
def test_degrees_without_a_unit_are_told_by_where_they_wrap(
    step: float, unit: str, tmp_path: Path
) -> None:
    run = read_run(write(tmp_path, "t,x,y,yaw", (0, 0, 0, 0.0), (0.1, 0, 0, step)))
    assert f"yaw [{unit}]" in run.notes["columns"]
    expected = math.radians(step) if unit.startswith("deg") else step
    assert math.cos(run.poses.heading_rad[1] - expected) == pytest.approx(1.0)


def test_times_that_are_no_seconds_need_a_unit(tmp_path: Path) -> None:
    path = write(tmp_path, "t,x,y,yaw", (0, 0, 0, 0), (1001, 0, 0, 0))
    with pytest.raises(LogError, match=r"column t: .* found steps of 1001, which are no seconds"):
        read_run(path)
    assert read_run(path, columns={"t": "t [us]"}).poses.time_ns[1] == 1_001_000
    path = write(tmp_path, "t,x,y,yaw", (0, 0, 0, 0), (999, 0, 0, 0))
    assert read_run(path).poses.time_ns[1] == 999_000_000_000


def test_rows_are_sorted_and_counted(tmp_path: Path) -> None:
    rows = [ROWS[1], ROWS[0], ROWS[1], ROWS[2], (0.2, 9, 9, 9), (0.3, "", "nan", 0)]
    run = read_run(write(tmp_path, "t,x,y,yaw", *rows))
    assert run.poses.time_ns.tolist() == [0, 100_000_000, 200_000_000, 200_000_001]
    names = ("sorted_rows", "dropped_duplicates", "moved_rows", "wrapped_headings")
    assert [run.notes[name] for name in names] == ["1", "1", "1", "1"]
    assert run.notes["rows_without_pose"] == "1 of 5"


def test_rows_may_lack_a_command_or_a_measurement(tmp_path: Path) -> None:
    rows = [(0, 0, 0, 0, 1, ""), (1, 0, 0, 0, "", 2), (2, 0, 0, 0, "NaN", 2)]
    run = read_run(write(tmp_path, "t,x,y,yaw,cmd_v,speed", *rows))
    assert run.commands.time_ns.tolist() == [0]
    assert run.commands.turn_rate_rad_s.tolist() == [0.0]
    assert (find_no_commands(run, "speed") is None, find_no_commands(run, "turn_rate") is None) == (
        True,
        False,
    )
    metrics = measure_run(run)
    assert (
        metrics["run.turn_rate_steps"].reason == "the recording holds no commands of the turn rate"
    )
    assert metrics["run.turn_rate_effort"].status is metrics["run.turn_rate_tracking_rms"].status
    assert metrics["run.speed_effort"].value is not None
    assert run.notes["rows_without_command"] == "2 of 3"
    assert run.poses.measured_speed_m_s is None
    assert run.notes["measured_speed"] == "not read: 1 of 3 poses lack it"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y\n0,0,0\n", "no column for heading; there are t, x, y: --column heading='NAME"),
        ("t,x,y\n0,0,0\n", "or --column heading=course takes the direction of travel"),
        ("a,b\n0,0\n", "no column for t, x, y and heading; there are a, b: --column t='NAME"),
        ("t,x,pos_x,y,yaw\n0,0,0,0,0\n", "expected one for x, found x and pos_x: --column x='x'"),
        ("t,x,y,yaw\n0,0,0,0\n1,zero,0,0\n", "line 3, column x: expected a number, found 'zero'"),
        ("t,x,y,yaw\n# c\n0,inf,0,0\n", "line 3, column x: expected a finite number, found 'inf'"),
        ("t,x,y,yaw\n,0,0,0\n", "line 2, column t: expected a time, found ''"),
        ("t,x,y,yaw\n1e999999999,0,0,0\n", "line 2, column t: expected a finite number"),
        ("t_s,x,y,yaw\n1e999999999,0,0,0\n", "line 2, column t_s: expected a time"),
        ("t_s,x,y,yaw\n-1e-999999999,0,0,\n", "no row has x, y and heading"),
        ("t,x,y,yaw\n2024-13-01T00:00:00,0,0,0\n", "line 2, column t: expected a time"),
        ("t,x,y,yaw\n0,0,0\n", "line 2: expected 4 cells, found 3"),
        ("t,x,y,yaw\n", "no rows below the header t, x, y, yaw"),
        ("0,0,0,0\n1,0,0,0\n", "expected a header that names the columns, the 8 columns of a"),
        ("", "expected a table, found no rows"),
        ("# t\n", "expected a table, found no rows"),
        ('t,x,y,yaw\n"0,0,0,0\n', "line 2: expected cells, found"),
        ("t,x,y,yaw\n0,0,0,\xff", "byte 16: expected UTF-8 text, found 0xff"),
    ],
)
def test_wrong_table_is_one_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(LogError, match=r"drive\.csv: ") as caught:
        read_run(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_texts_of_the_time_of_day_are_read(tmp_path: Path) -> None:
    rows = [("23:59:59.5", 1, 2, 0), ("0:00:00,25", 1, 3, 0)]
    run = read_run(write(tmp_path, "t;x;y;yaw", *rows, sign=";"))
    assert run.poses.time_ns.tolist() == [0, 750_000_000]
    assert run.notes["columns"].startswith("t from t [time of the day, over midnight], x")
    with pytest.raises(LogError, match="line 3, column t: expected a time, found '0:60:00'"):
        read_run(write(tmp_path, "t,x,y,yaw", rows[0], ("0:60:00", 1, 3, 0)))


@pytest.mark.parametrize("last", ["0.3,7,7", "0.3", "0.3,7,7,7,7"])
def test_an_incomplete_last_row_may_be_left_out(last: str, tmp_path: Path) -> None:
    path = write(tmp_path, "t,x,y,yaw", *ROWS, last)
    found = f"line 5: expected 4 cells, found {last.count(',') + 1}"
    if last.count(",") == 4:
        with pytest.raises(LogError, match=f"{found}$"):
            read_run(path, allow_partial=True)
        return
    with pytest.raises(LogError, match=f"{found} in the last row: --partial leaves it out"):
        read_run(path)
    run = read_run(path, allow_partial=True)
    assert len(run.poses) == 3
    assert run.notes["partial"] == f"the last row is left out, {found}"
    path = write(tmp_path, "t,x,y,yaw", *ROWS[:1], last, *ROWS[1:])
    with pytest.raises(LogError, match=r"line 3: expected 4 cells, found \d$"):
        read_run(path, allow_partial=True)


@pytest.mark.parametrize("sign", ["_", ".", "/"])
def test_one_of_several_robots_in_a_table_is_read(sign: str, tmp_path: Path) -> None:
    names = [f"{robot}{sign}{name}" for robot in ("r1", "r2") for name in ("x_mm", "y", "yaw")]
    rows = [(0, 1, 2, 0, 3, 4, 0), (1, 1, 2, 0, 3, 5, 0)]
    path = write(
        tmp_path,
        ",".join(["t", *names, "goal_x", "goal_y", "goal_yaw"]),
        *[(*row, 9, 9, 9) for row in rows],
    )
    run = read_run(path, robot="r2")
    assert run.name == "drive:r2"
    assert run.poses.xy_m.tolist() == [[0.003, 4.0], [0.003, 5.0]]
    assert "unused" not in run.notes
    assert "unused" not in read_file_info(path, ReadChoice(robot="r2")).notes
    if sign == "/":  # what comes before a quantity may be any topic
        return
    with pytest.raises(LogError, match=r"no column for x, y and heading; .*: --robot r1 or --rob"):
        read_run(path)
    with pytest.raises(LogError, match="--robot r1 or --robot r2 chooses a robot"):
        read_run(path, robot="r3")


@pytest.mark.parametrize("robot", [None, "pose"])
def test_a_robot_does_not_give_a_missing_time(robot: str | None, tmp_path: Path) -> None:
    path = write(tmp_path, "clk,pose_x,pose_y,pose_yaw", (0, 0, 0, 0), (1, 1, 0, 0))
    with pytest.raises(LogError, match=r"no column for t; .*: --column t='NAME \[UNIT\]' says wh"):
        read_run(path, robot=robot)


def test_own_tables_are_read_as_ever(tmp_path: Path) -> None:
    run = simulate_short_run()
    export_csv(run, tmp_path / "own.csv")
    assert_same(read_run(tmp_path / "own.csv").poses, run.poses)
    assert "columns" not in read_run(tmp_path / "own.csv").notes


def test_parquet_of_other_programs_is_read(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    stamps = np.array([1_700_000_000_000_000, 1_700_000_000_100_000], dtype="datetime64[us]")
    pose = pa.array([{"x": 1.0, "y": 2.0}, {"x": 1.5, "y": None}, {"x": 2.0, "y": 3.0}][:2])
    table = {"stamp": stamps, "position": pose, "yaw_deg": [90, 180], "cmd_v": [None, 0.5]}
    parquet.write_table(pa.table(table), tmp_path / "drive.parquet")
    run = read_run(tmp_path / "drive.parquet")
    assert run.poses.xy_m.tolist() == [[1.0, 2.0]]
    assert run.poses.heading_rad == pytest.approx([math.pi / 2])
    assert run.commands.time_ns.tolist() == [100_000_000]
    assert run.notes["original_timestamp"] == "2023-11-14T22:13:20.000000000Z"
    since = {"time": np.array([5, 105], dtype="timedelta64[ms]"), "x": [0, 1], "y": [0, 0]}
    parquet.write_table(pa.table({**since, "yaw": [0, 0]}), tmp_path / "since.parquet")
    assert read_run(tmp_path / "since.parquet").poses.time_ns.tolist() == [0, 100_000_000]
    parquet.write_table(
        pa.table({"t": [0], "x": ["a"], "y": [0], "yaw": [0]}), tmp_path / "a.parquet"
    )
    with pytest.raises(LogError, match="row 1, column x: expected a number, found 'a'"):
        read_run(tmp_path / "a.parquet")


def test_goal_and_info_of_a_table(tmp_path: Path) -> None:
    path = write(tmp_path, "t,x,y,yaw", *ROWS)
    run = read_run(path, goal=(3.0, 4.0, 0.5))
    assert (run.goal_xy_m, run.goal_heading_rad) == ((3.0, 4.0), 0.5)
    assert "goal_xy_m" not in run.absent
    assert read_file_info(path).notes["rows"] == "3 poses, 0 commands, 0 samples"


@pytest.mark.parametrize(
    ("step", "unit"), [(1500, "ms"), (1700, "us"), (1_500_000, "us"), (1_700_000, "ns")]
)
def test_steps_that_are_no_seconds_name_the_likely_unit(
    step: int, unit: str, tmp_path: Path
) -> None:
    path = write(tmp_path, "stamp,x,y,yaw", *[(step * row, row, 0, 0) for row in range(3)])
    with pytest.raises(LogError, match=rf"--column t='stamp \[{unit}\]' names"):
        read_run(path)


def test_px4s_quaternions_begin_with_w(tmp_path: Path) -> None:
    header = "t,x,y,q[0],q[1],q[2],q[3]"
    turned = [(row, row, 0, math.cos(0.2), 0, 0, math.sin(0.2)) for row in range(3)]
    path = write(tmp_path, header, *turned)
    assert read_run(path).poses.heading_rad == pytest.approx(0.4)
    names = {"qx": "q[0]", "qy": "q[1]", "qz": "q[2]", "qw": "q[3]"}
    assert read_run(path, columns=names).poses.heading_rad != pytest.approx(0.4)


@pytest.mark.parametrize("turn_rad", [0.09, 0.11])
def test_quaternions_in_another_order_are_said(turn_rad: float, tmp_path: Path) -> None:
    parts = [(math.cos(a / 2), 0, 0, math.sin(a / 2)) for a in (0.0, turn_rad)]
    rows = [(row, row, 0, *part) for row, part in enumerate(parts)]
    note = read_run(write(tmp_path, "t,x,y,qx,qy,qz,qw", *rows)).notes.get("quaternion_order", "")
    assert (note.count("--column") == 4) == (turn_rad > 0.1)
    assert "quaternion_order" not in read_run(write(tmp_path, "t,x,y,qw,qx,qy,qz", *rows)).notes
    rolled = [(row, row, 0, part[3], 0.1, 0, part[0]) for row, part in enumerate(parts)]
    assert "quaternion_order" not in read_run(write(tmp_path, "t,x,y,qx,qy,qz,qw", *rolled)).notes


def test_of_euler_angles_psi_is_the_heading(tmp_path: Path) -> None:
    row = (0, 0, 0, 0.1, 0.2, 0.3)
    assert read_run(write(tmp_path, "t,x,y,phi,theta,psi", row)).poses.heading_rad == [0.3]
    with pytest.raises(LogError, match="expected one for heading, found theta and psi"):
        read_run(write(tmp_path, "t,x,y,phase,theta,psi", row))


def write_robots(path: Path, *, rows: int, name: str = "id") -> Path:
    """Write 40 poses of a robot 1 and `rows` of a robot 2, 5 m beside it, in order of time."""
    poses = [(0.1 * row, 0.01 * row, 0.0, 0.0, 1) for row in range(40)]
    poses += [(0.1 * row, 0.01 * row, 5.0, 0.0, 2) for row in range(rows)]
    return write(path, f"t,x,y,yaw,{name}", *sorted(poses))


@pytest.mark.parametrize(("rows", "is_mixed"), [(9, False), (10, True)])
def test_rows_of_several_robots_are_not_one_path(
    rows: int, *, is_mixed: bool, tmp_path: Path
) -> None:
    path = write_robots(tmp_path, rows=rows)
    if not is_mixed:
        assert len(read_run(path).poses) == 40 + rows
        return
    line = r"rows of several robots alternate: --robot 1 or --robot 2 chooses a robot"
    with pytest.raises(LogError, match=line):
        read_run(path)
    run = read_run(path, robot="2")
    assert (run.name, len(run.poses), run.poses.xy_m[0, 1]) == ("drive:2", rows, 5.0)
    assert len(read_trajectory(path, ReadChoice(robot="1")).time_ns) == 40


def test_other_numbers_of_rows_are_no_robots(tmp_path: Path) -> None:
    assert len(read_run(write_robots(tmp_path, rows=30, name="battery")).poses) == 70
    rows = [(0.1 * row, 0.01 * row, 0.0, 0.0) for row in range(40)]
    for numbers in (range(40), [row // 10 % 2 for row in range(40)]):  # rows, and laps
        numbered = [(*row, number) for row, number in zip(rows, numbers, strict=True)]
        assert len(read_run(write(tmp_path, "t,x,y,yaw,id", *numbered)).poses) == 40


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ("row,failed,law.kp", "a table of turtlelog sweep, not a run: turtlelog plot shows it$"),
        ("file,sha256,error", "results of turtlelog metrics or check, not a run: its column file"),
        ("file,sha256,note", "no column for t, x, y and heading"),
    ],
)
def test_tables_of_results_are_told_as_such(header: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{header}\n1,2,3\n", encoding="utf-8")
    with pytest.raises(LogError, match=told):
        read_run(tmp_path / "a.csv")
