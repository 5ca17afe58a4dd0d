import pytest

from tests.cli.conftest import Call


def test_theory_answers_in_json(call: Call) -> None:
    answer = call("theory", "--kp", "1,4,10,16", "--dead-time", "6", "--json").json
    assert (answer["period_s"], answer["dead_time_ticks"]) == (0.016, 6)
    assert round(answer["overshoot_gain"], 2) == 3.54
    assert round(answer["stability_gain"], 2) == 15.07
    gains = answer["gains"]
    assert [gain["kp"] for gain in gains] == [1.0, 4.0, 10.0, 16.0]
    assert [gain["overshoots"] for gain in gains] == [False, True, True, True]
    assert [gain["stable"] for gain in gains] == [True, True, True, False]
    assert [len(gain["poles"]) for gain in gains] == [7] * 4
    assert gains[1]["poles"][0]["im"] == -gains[1]["poles"][1]["im"] != 0.0
    assert (gains[3]["overshoot_percent"], gains[3]["sampled_settling_time_s"]) == (None, None)


def test_theory_tells_the_plant_in_json(call: Call) -> None:
    plant = call("theory", "--json").json["plant"]
    assert plant["bibo_stable"] is False
    ends = {end["input"]: (end["value"], end["status"]) for end in plant["final_values"]}
    assert ends == {
        "impulse": (1.0, "ok"),
        "step": (None, "unbounded"),
        "ramp": (None, "unbounded"),
    }


def test_theory_has_null_where_there_is_no_crossover(call: Call) -> None:
    [gain] = call("theory", "--kp", "130", "--json").json["gains"]
    assert (gain["phase_margin_rad"], gain["delay_margin_ticks"], gain["delay_margin_s"]) == (
        None,
        None,
        None,
    )


def test_theory_reads_well_in_a_terminal(call: Call) -> None:
    answer = call("theory", "--dead-time", "6", "--kp", "1,2,4,10,16")
    assert (answer.code, answer.err) == (0, "")
    assert max(map(len, answer.out.splitlines())) <= 96
    assert "Kp = 1, 2: no overshoot. Kp = 4, 10: overshoots, and settles. Kp = 16: unstable." in (
        " ".join(answer.out.split())
    )


def test_theory_shows_the_limits_of_the_dead_time_asked_for(call: Call) -> None:
    limits = call("theory", "--dead-time", "20", "--json").json["limits"]
    assert [limit["dead_time_ticks"] for limit in limits] == [*range(9), 20]


@pytest.mark.parametrize("dead_time_ticks", [0, 1, 1000])
def test_theory_goes_from_no_dead_time_to_the_most(call: Call, dead_time_ticks: int) -> None:
    answer = call("theory", "--dead-time", str(dead_time_ticks), "--kp", "1,62.5,125,1e6")
    assert (answer.code, answer.err) == (0, "")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--kp", "nan"], "kp: expected a gain > 0, found nan"),
        (["--kp", "0"], "kp: expected a gain > 0, found 0.0"),
        (["--kp=-1"], "kp: expected a gain > 0, found -1.0"),
        (["--kp", "inf"], "kp: expected a gain from 1e-100 to 1e+100, found inf"),
        (["--kp", "abc"], "--kp: expected gains as in 1,2,4,10, found 'abc'"),
        (["--kp="], "--kp: expected gains as in 1,2,4,10, found ''"),
        (["--kp", "1,,2"], "--kp: expected gains as in 1,2,4,10, found '1,,2'"),
        (["--kp", ",".join(["1"] * 101)], "--kp: expected at most 100 gains, found 101"),
        (["--period", "0"], "period_s: expected a sampling period > 0, found 0.0"),
        (["--period", "nan"], "period_s: expected a sampling period > 0, found nan"),
        (["--dead-time=-1"], "dead_time_ticks: expected a whole number from 0 to 1000, found -1"),
        (["--dead-time", "1.5"], "--dead-time: expected a whole number, found '1.5'"),
        (["--dead-time", "1e9"], "--dead-time: expected a whole number, found '1e9'"),
        (["--dead-time", "1000000000"], "expected a whole number from 0 to 1000, found 1000000000"),
    ],
)
def test_theory_names_what_it_cannot_use(call: Call, words: list[str], expected: str) -> None:
    answer = call("theory", *words)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("turtlelog: error: ")
    assert expected in answer.err
    assert answer.err.count("\n") == 1
