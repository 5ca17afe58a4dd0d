import numpy as np

from turtlelog.draw.report_drawing import describe_plane, describe_plot

FALLING = np.array([2.0, np.nan, -0.25, 0.5])


def test_a_plot_is_told_by_where_each_curve_begins_ends_and_lies() -> None:
    told = describe_plot("error [m]", [("kp1", FALLING), ("kp2", np.array([-0.0, -0.0]))])
    assert told == (
        "error [m] over time. kp1: from 2 to 0.5, between -0.25 and 2;"
        " kp2: from 0 to 0, between 0 and 0."
    )


def test_of_many_runs_the_range_is_told_and_of_no_values_that() -> None:
    many = [(f"kp{number}", FALLING * number) for number in range(1, 8)]
    assert describe_plot("error [m]", many[:6]).count("from") == 6
    assert describe_plot("error [m]", many) == (
        "error [m] over time of 7 runs, between -1.75 and 14."
    )
    assert describe_plot("error [m]", [("kp1", np.array([np.nan]))]) == "error [m]: no values."
    assert describe_plot("error [m]", []) == "error [m]: no values."


def test_a_plane_is_told_by_where_each_run_begins_and_ends() -> None:
    way = np.array([[5.5, 5.5], [3.0, 7.0], [2.0, 10.0]])
    assert describe_plane("The way", [("kp1", way)]) == (
        "The way. kp1 drives from (5.5, 5.5) to (2, 10) m."
    )
    assert describe_plane("The way", [("kp1", way)] * 7) == (
        "The way: the paths of 7 runs in the plane."
    )
