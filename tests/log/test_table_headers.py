"""Names, units, comments and encodings of the columns of tables."""

import math
from pathlib import Path

import pytest

from tests.log.plain_tables import ROWS, write
from turtlelog.errors import LogError
from turtlelog.log.any_file import read_run

NAMES = [
    "t,x,y,heading",
    "time,pos_x,pos_y,theta",
    "timestamp,x_m,y_m,heading_rad",
    "%time,field.pose.pose.position.x,field.pose.pose.position.y,yaw",
    "__time,/odom/pose/pose/position/x,/odom/pose/pose/position/y,/odom/yaw",
    "header.stamp,position.x,position.y,psi",
    "Time (s),X (m),Y (m),Yaw (rad)",
    "elapsed_time,px,py,yaw_angle",
]


@pytest.mark.parametrize("header", NAMES)
def test_usual_names_of_columns_are_known(header: str, tmp_path: Path) -> None:
    run = read_run(write(tmp_path, header, *ROWS))
    assert run.poses.time_ns.tolist() == [0, 100_000_000, 200_000_000]
    assert run.poses.xy_m.tolist() == [[1.0, 2.0], [1.5, 2.5], [2.0, 3.0]]
    assert run.poses.heading_rad.tolist() == [0.5, 0.75, 1.0]


def test_a_comment_may_name_the_columns(tmp_path: Path) -> None:
    path = write(tmp_path, "# made by hand\n# t x y theta", *ROWS, suffix="txt", sign=" ")
    assert read_run(path).poses.heading_rad.tolist() == [0.5, 0.75, 1.0]


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("t,x,y,yaw\n", "utf-16"),
        ("t [s],x,y,yaw [°]\n", "latin-1"),
        ("# Fahrt über den Hof\nt,x,y,yaw\n", "latin-1"),
        ("% Log of robot 3\n%\n% t x y yaw\n", "ascii"),
        ("// Log of robot 3\nt,x,y,yaw\n", "ascii"),
        ("#\n\n%Log\nt,x,y,yaw\n", "ascii"),
    ],
)
def test_other_comments_and_encodings_are_read(text: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    rows = "0,1,2,0.5\n0.1,1.5,2.5,0.75\n"
    path.write_bytes((text + (rows.replace(",", " ") if "% t" in text else rows)).encode(encoding))
    run = read_run(path)
    assert run.poses.xy_m.tolist() == [[1.0, 2.0], [1.5, 2.5]]
    scale = math.pi / 180 if "°" in text else 1.0
    assert run.poses.heading_rad == pytest.approx([0.5 * scale, 0.75 * scale])


def test_damaged_utf16_is_told(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_bytes("t,x,y,yaw\n0,0,0,0\n".encode("utf-16")[:-1])
    with pytest.raises(LogError, match=r"drive\.csv: expected UTF-16 text, found a damaged file"):
        read_run(path)


@pytest.mark.parametrize(
    ("first", "name"),
    [("Objects", "Vicon"), ("Trajectories,,,", "Vicon"), ("Format Version,1.23,Ta", "OptiTrack")],
)
def test_headers_of_motion_capture_are_named(first: str, name: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=f"a table of {name} with several rows of names: keep one"):
        read_run(write(tmp_path, first, "120", "Frame,X,Y", "1,2,3"))


def test_repeated_headers_are_left_out(tmp_path: Path) -> None:
    path = write(tmp_path, "t,x,y,yaw", ROWS[0], "t, x,y,yaw", *ROWS[1:], "t,x,y,yaw")
    run = read_run(path)
    assert run.poses.heading_rad.tolist() == [0.5, 0.75, 1.0]
    assert run.notes["repeated_headers"] == "2 rows left out"
    path = write(tmp_path, "t,x,y,yaw", ROWS[0], "t,x,y,theta")
    with pytest.raises(LogError, match="line 3, column t: expected a number, found 't'"):
        read_run(path)
    with pytest.raises(LogError, match="no rows below the header t, x, y, yaw"):
        read_run(write(tmp_path, "t,x,y,yaw", "t,x,y,yaw"))


@pytest.mark.parametrize("unit", ["UTC", "iso8601"])
def test_dates_need_no_unit_in_a_row_of_units(unit: str, tmp_path: Path) -> None:
    rows = [("2024-01-01T00:00:00.100", 1, 2, 0), ("2024-01-01T00:00:00.300", 1, 3, 0)]
    run = read_run(write(tmp_path, "t,x,y,yaw", f"{unit},m,cm,rad", *rows))
    assert run.poses.time_ns.tolist() == [0, 200_000_000]
    assert run.poses.xy_m.tolist() == [[1.0, 0.02], [1.0, 0.03]]


@pytest.mark.parametrize("units", ["ms,mm,cm,deg,", "[ms],(mm),[cm],[deg],-", "ms, mm, cm,°,V"])
def test_a_row_of_units_is_read(units: str, tmp_path: Path) -> None:
    run = read_run(write(tmp_path, "t,x,y,yaw,battery", units, (0, 5, 5, 90, 1), (5, 6, 7, 90, 1)))
    assert run.poses.time_ns.tolist() == [0, 5_000_000]
    assert run.poses.xy_m[0].tolist() == [0.005, 0.05]
    assert run.poses.heading_rad == pytest.approx([math.pi / 2] * 2)
    assert run.notes["columns"].startswith("t from t [ms], x from x [mm], y from y [cm]")


@pytest.mark.parametrize(
    ("units", "message"),
    [
        (
            "s,ft,ft,deg",
            "column x: expected a unit of m, cm, mm, found 'ft': --column x='x [UNIT]'",
        ),
        ("a,b,c,d", "line 2, column t: expected a number, found 'a'"),
        ("0,m,m,rad", "line 2, column x: expected a number, found 'm'"),
        ("2024-01-01T00:00:00Z,m,m,rad", "line 3, column t: expected a time, found '0.0'"),
    ],
)
def test_other_rows_below_the_header_are_values(units: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(LogError) as caught:
        read_run(write(tmp_path, "t,x,y,yaw", units, *ROWS))
    assert message in str(caught.value)
    with pytest.raises(LogError, match="no rows below the header t, x, y, yaw"):
        read_run(write(tmp_path, "t,x,y,yaw", "s,m,m,rad"))


def test_excels_line_of_the_separator_is_no_header(tmp_path: Path) -> None:
    path = write(tmp_path, "sep=;", "t;x;y;yaw", *ROWS, sign=";")
    assert read_run(path).poses.heading_rad.tolist() == [0.5, 0.75, 1.0]


def test_columns_without_a_name_of_their_own_have_numbers(tmp_path: Path) -> None:
    path = write(tmp_path, ",t,x,y,yaw,x,", *[(7, *row, 9, "") for row in ROWS])
    with pytest.raises(LogError, match=r"found x \(#3\) and x \(#6\): --column x='#3' chooses"):
        read_run(path)
    run = read_run(path, columns={"x": "#6 [mm]"})
    assert run.poses.xy_m[0] == pytest.approx([0.009, 2.0])
    assert "x from #6 [mm]" in run.notes["columns"]
    assert "; not read: #1, x (#3), #7; " in run.notes["columns"]
    for name in ("#0", "#8", "#x"):
        with pytest.raises(LogError, match="expected a column of the table, found"):
            read_run(path, columns={"x": name})


def test_a_first_row_like_the_second_is_no_header(tmp_path: Path) -> None:
    rows = [(5, 100_000_000 * row, "odom", 1.0 + row, 0, 0.0) for row in range(3)]
    path = write(tmp_path, ",".join(map(str, rows[0])), *rows[1:])
    with pytest.raises(LogError, match="no column for t, x, y and heading; there are #1, #2, #3"):
        read_run(path)
    columns = {"t": "#1", "t_nanosec": "#2", "x": "#4", "y": "#5", "heading": "#6"}
    run = read_run(path, columns=columns)
    assert run.poses.xy_m[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert run.poses.time_ns.tolist() == [0, 100_000_000, 200_000_000]
    assert "t_nanosec from #2 [ns]" in run.notes["columns"]
    micro = read_run(path, columns={**columns, "t_nanosec": "#2 [us]"})
    assert micro.poses.time_ns[1] == 100_000_000_000
    headed = write(tmp_path, "5,t,frame,x,y,yaw", *rows)
    assert len(read_run(headed, columns={"t": "t [ns]"}).poses) == 3


def test_a_column_without_a_name_is_shown_by_its_number(tmp_path: Path) -> None:
    path = write(tmp_path, ",x,y,yaw", ("2024-03-31 01:59:50", 0, 0, 0))
    with pytest.raises(LogError, match="no column for t; there are #1, x, y, yaw: "):
        read_run(path)
    assert len(read_run(path, columns={"t": "#1"}).poses) == 1


@pytest.mark.parametrize(
    ("names", "speed"),
    [
        ("cmd_vx,measured_cmd_vx,cmd_wz", "cmd_vx"),
        ("cmd_actual_vx,cmd_vx,cmd_wz", "cmd_vx"),
        ("cmd_odom_lin,other,cmd_wz", ""),
        ("cmd_lin,cmd_linear,cmd_wz", ""),
    ],
)
def test_only_one_sure_name_is_a_command(names: str, speed: str, tmp_path: Path) -> None:
    """Optional columns never stop a file; unsure ones are named with the option that reads them."""
    rows = [f"{number / 10},{number},0,0,0.1,0.2,0.3" for number in range(5)]
    run = read_run(write(tmp_path, f"t,x,y,yaw,{names}", *rows))
    assert (f"command_speed from {speed} " in run.notes["chosen"]) == bool(speed)
    assert "command_turn_rate from cmd_wz " in run.notes["chosen"]
    assert speed or "command_speed from" not in run.notes["chosen"]
