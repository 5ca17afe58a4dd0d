from dataclasses import replace
from functools import cache

import pytest

from tests.explain.logs import simulate
from turtlelog.explain import (
    Attribution,
    Identification,
    ValueSet,
    attribute_run,
    identify_run,
    simulate_what_ifs,
)
from turtlelog.explain.game import name_without
from turtlelog.measure import measure_run


@cache
def explain_kp10() -> tuple[Identification, Attribution]:
    run = simulate("paper-kp10")
    identified = identify_run(run)
    return identified, attribute_run(run, identified=identified)


def test_the_run_is_simulated_without_each_that_acts_and_without_all() -> None:
    identified, found = explain_kp10()
    told: list[tuple[int, int]] = []
    runs = simulate_what_ifs(identified, found, report=lambda *done: told.append(done))
    assert [*runs] == ["queue", "pause", "queue and pause"]
    last = measure_run(runs["queue and pause"], only=[found.metric])[found.metric]
    assert last.value == found.without_all
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_of_one_that_acts_the_run_without_it_is_that_without_all() -> None:
    identified, found = explain_kp10()
    alone = tuple(share for share in found.contributions if share.cause == "queue")
    assert [*simulate_what_ifs(identified, replace(found, contributions=alone, together=()))] == [
        "queue"
    ]


def test_a_simulation_that_is_not_the_log_tells_no_what_if() -> None:
    identified, found = explain_kp10()
    assert (
        simulate_what_ifs(identified, replace(found, withheld="they differ", contributions=()))
        == {}
    )


@pytest.mark.parametrize(
    ("missing", "given", "names"),
    [
        (("pause",), (), ["pause"]),
        ((), ("queue", "pause"), ["queue", "pause", "queue and pause"]),
        ((), (), ["queue", "pause", "wrap", "queue, pause and wrap"]),
    ],
)
def test_where_a_value_is_missing_those_that_decide_are_taken_out(
    missing: tuple[str, ...], given: tuple[str, ...], names: list[str]
) -> None:
    identified, found = explain_kp10()
    without = (ValueSet(causes=missing, reason="it never settles"),)
    with_value = (ValueSet(causes=given),) if given else ()
    none = replace(
        found, withheld="no value", contributions=(), without_value=without, with_value=with_value
    )
    assert [*simulate_what_ifs(identified, none)] == names


@pytest.mark.parametrize(
    ("taken", "name"), [("a", "a"), ("abc", "a, b and c"), ("abcd", "all 4 effects")]
)
def test_many_causes_are_counted(taken: str, name: str) -> None:
    assert name_without(tuple(taken)) == name
