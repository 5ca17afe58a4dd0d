import dataclasses
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

import turtlelog as tl
from tests.check.recordings import simulate
from turtlelog.check.spec_templates import choose_bound, find_doubt, format_first_spec
from turtlelog.measure import find_metric_kind
from turtlelog.measure.pose_noise import measure_noise
from turtlelog.run import Origin


@given(st.floats(min_value=1e-3, max_value=1e6), st.booleans())
def test_a_bound_leaves_ten_to_twenty_percent(value: float, up: bool) -> None:  # noqa: FBT001
    bound, words = choose_bound(value, "m", up=up)
    share = (bound - value) / value if up else (value - bound) / value
    assert 0.1 - 1e-9 <= share <= 0.2 + 1e-9
    assert words == f"{round(share * 100)} %"
    assert float(f"{bound:.3g}") == bound


@pytest.mark.parametrize(
    ("value", "bound", "words"),
    [
        (0.0538, 0.06, "12 %"),
        (0.5, 0.55, "10 %"),
        (0.9166, 1.01, "10 %"),  # 1.1 leaves more than a fifth
        (0.9167, 1.1, "20 %"),
        (2.0, 2.2, "10 %"),
    ],
)
def test_a_bound_has_two_digits_where_they_leave_no_more_than_a_fifth(
    value: float, bound: float, words: str
) -> None:
    assert choose_bound(value, "m", up=True) == (bound, words)


@pytest.mark.parametrize(
    ("unit", "grain"), [("s", 0.016), ("m", 1e-4), ("deg", 1e-2), ("%", 0.1), ("1", 1e-6)]
)
def test_a_value_at_zero_leaves_what_its_unit_may_differ_by(unit: str, grain: float) -> None:
    words = f"{grain:g}" if unit == "1" else f"{grain:g} {unit}"
    assert choose_bound(0.0, unit, up=True) == (grain, words)
    assert choose_bound(0.0, unit, up=False) == (-grain, words)
    below, above = (choose_bound(10 * grain * share, unit, up=True) for share in (0.99, 1.01))
    assert (below[1], above[1].endswith(" %")) == (words, True)
    assert below[0] >= 10.9 * grain * (1 - 1e-9)


@pytest.mark.parametrize("name", ["paper-kp1", "paper-kp4", "paper-kp10", "textbook"])
def test_a_run_passes_what_was_read_off_it_and_a_fifth_more_does_not(name: str) -> None:
    run = simulate(name)
    tables = tomllib.loads(format_first_spec(run, reference="good.mcap"))
    metrics = tl.measure_run(run)
    results = list(tl.check_runs(tl.parse_spec({"checks": tables["checks"]}), [("a", run)]))
    assert {result.verdict for result in results} == {"PASS"}
    for result in results:
        assert result.value is not None
        assert result.margin is not None
        kind = find_metric_kind(result.check)
        floor = None if kind is None else kind.floor
        base = abs(result.value if floor is None else max(result.value, floor))
        limit = result.limit or 0.0
        if re.match(r"observed, and \d\d % to spare", tables["checks"][result.check]["reason"]):
            assert base * 1.2 * (1 + 1e-9) >= limit >= base * 1.1 * (1 - 1e-9)
        else:
            least = {"s": 0.016, "m": 1e-4, "deg": 1e-2, "%": 0.1}[result.unit]
            assert limit - base == pytest.approx(least, rel=0.1)
    assert metrics["run.duration"].value == next(
        result.value for result in results if result.check == "run.duration"
    )


@pytest.mark.parametrize(("limit_m_s", "share"), [(0.24, 0.87463), (0.23, 0.91289)])
def test_a_share_gets_no_bound_that_it_cannot_exceed(limit_m_s: float, share: float) -> None:
    run = simulate("paper-kp10", limits__speed_m_s=limit_m_s)
    lines = format_first_spec(run, reference="good.mcap").splitlines()
    (line,) = [line for line in lines if "translate.saturated_share <=" in line]
    told = f"# translate.saturated_share <= ...: not read off, as no share exceeds 1; here {share}"
    bound = f'expect = "translate.saturated_share <= 0.97"  # here {share}'
    assert line == (bound if share < 0.9 else told)


def test_of_a_run_that_was_cut_nothing_is_read_off_that_it_does_not_pass() -> None:
    for run in (simulate(max_duration_s=3.0), dataclasses.replace(simulate(), stop_reason=None)):
        text = format_first_spec(run, reference="good.mcap")
        assert "# always(abs(cross_track) <= ...): not read off" in text
        spec = tl.parse_spec({"checks": tomllib.loads(text)["checks"]})
        assert {result.verdict for result in tl.check_runs(spec, [("a", run)])} == {"PASS"}


def test_times_of_a_robot_leave_one_of_its_own_ticks() -> None:
    assert choose_bound(0.0, "s", up=True, grain=0.05) == (0.05, "0.05 s")
    robot = {"plant.kind": "lagged", "goal.x_m": 7.0, "goal.y_m": 6.0}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), robot))
    assert 'run.largest_gap <= 0.1"' in format_first_spec(run, reference="run.mcap")


@pytest.mark.parametrize("columns", [("cmd_v",), ("cmd_v", "cmd_w"), ("cmd_w",)], ids="+".join)
def test_what_was_never_commanded_has_no_bound(columns: tuple[str, ...], tmp_path: Path) -> None:
    rows = [f"{n / 20},{n / 20},0,0{',1' * len(columns)}" for n in range(9)]
    file = tmp_path / "drive.csv"
    file.write_text("\n".join([f"t,x,y,yaw,{','.join(columns)}", *rows]))
    bounds = tomllib.loads(format_first_spec(tl.read_run(file), reference="drive.csv"))["checks"]
    known = {"cmd_v": "speed", "cmd_w": "turn_rate"}
    assert [name for name in bounds if "." not in name] == [known[name] for name in columns]


def drive(folder: Path, seed: int = 1, *, noise: float = 1e-3, fault: str = "") -> tl.Run:
    """Return 12 s of a drive along an arc towards a goal, at 20 Hz, with noisy poses."""
    heading = 0.4 * np.sin(np.pi * np.arange(240) / 240)
    steps = 0.02 * np.column_stack([np.cos(heading), np.sin(heading)])
    poses = np.column_stack([np.cumsum(steps, axis=0), heading])
    second, stuck = slice(60, 80), slice(60, 78)
    if fault == "0.15 m aside":
        poses[second, 1] -= 0.15
    if fault == "heading off by 29 deg":
        poses[second, 2] += 0.5
    poses += np.random.default_rng(seed).normal(0.0, noise, poses.shape)
    if fault == "frozen":
        poses[stuck] = poses[59]
    rows = [f"{n / 20},{x},{y},{yaw}" for n, (x, y, yaw) in enumerate(poses.tolist())]
    file = folder / "drive.csv"
    file.write_text("\n".join(["t,x,y,yaw", *rows]))
    return tl.read_run(file, goal=(4.6, 1.1))


def list_failing(spec: tl.Spec, run: tl.Run) -> set[str]:
    return {one.check for one in tl.check_runs(spec, [("a", run)]) if one.verdict == "FAIL"}


def read_first(run: tl.Run) -> tl.Spec:
    text = format_first_spec(run, reference="drive.csv")
    return tl.parse_spec({"checks": tomllib.loads(text)["checks"]})


def test_further_good_drives_pass_and_wrong_poses_fail(tmp_path: Path) -> None:
    specs = [read_first(drive(tmp_path, seed)) for seed in (1, 2)]
    for spec in specs:
        assert [list_failing(spec, drive(tmp_path, seed)) for seed in range(3, 9)] == [set()] * 6
        for fault, check in [
            ("0.15 m aside", "run.pose_jumps"),
            ("0.15 m aside", "run.cross_track_max"),
            ("frozen", "run.pose_jumps"),
            ("heading off by 29 deg", "run.total_turning"),
        ]:
            assert check in list_failing(spec, drive(tmp_path, 9, fault=fault)), fault
        assert "run.path_length" in list_failing(spec, drive(tmp_path, 9, noise=1e-2))


def test_a_run_whose_poses_jump_does_not_tell_how_often_they_may(tmp_path: Path) -> None:
    text = format_first_spec(drive(tmp_path, fault="0.15 m aside"), reference="drive.csv")
    assert "# run.pose_jumps <= ...: not read off, as its poses jump; here 2" in text
    good = format_first_spec(drive(tmp_path), reference="drive.csv")
    assert 'expect = "run.pose_jumps <= 0"  # here 0\n' in good


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_a_place_leaves_four_standard_deviations_of_its_noise(noise: float, tmp_path: Path) -> None:
    run = drive(tmp_path, noise=noise)
    found = measure_noise(run.poses).position_m
    results = {one.check: one for one in tl.check_runs(read_first(run), [("a", run)])}
    result = results["final.position_error"]
    assert result.value is not None
    assert result.margin is not None
    if noise < 5e-3:  # a tenth of the distance is more
        assert result.margin >= 0.1 * result.value > 4.0 * found
    else:
        assert result.margin == pytest.approx(4.0 * found, rel=0.05)
        assert 4.0 * found > 0.1 * result.value


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_lengths_say_that_they_contain_noise(noise: float, tmp_path: Path) -> None:
    text = format_first_spec(drive(tmp_path, noise=noise), reference="drive.csv")
    for name in ("run.path_length", "run.total_turning"):
        reason = tomllib.loads(text)["checks"][name]["reason"]
        assert (": with the noise of its poses" in reason) is (noise > 0.0)


def test_a_first_spec_doubts_a_run_that_did_not_end_well() -> None:
    good, cut = simulate("paper-kp2"), simulate(max_duration_s=3.0)
    for run, text in [
        (good, None),
        # A law without an end of its own holds the goal until the maximum duration.
        (dataclasses.replace(good, stop_reason="max_duration"), None),
        (dataclasses.replace(good, stop_reason="law_failed"), "(stop reason: law failed)"),
        (simulate("paper-kp10"), "It missed the goal by 0.107 m"),
        (cut, "(stop reason: max duration)"),
        (cut.slice(0.0, 2.0), "(stop reason: end not recorded)"),
        (
            dataclasses.replace(good, notes={"partial": "cut"}, origin=Origin(lost="rows")),
            "The recording is not complete: cut.",
        ),
    ]:
        doubt = find_doubt(run)
        assert doubt is None if text is None else text in str(doubt)
        lines = format_first_spec(run, reference="good.mcap").splitlines()
        assert any("Was it a good run?" in line for line in lines) is (text is not None)
