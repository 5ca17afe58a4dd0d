"""The words of the reasons why a run ended."""

import pytest

from turtlelog.laws.loading import LAWS
from turtlelog.run import stop_reasons

WORDS = {word for word in vars(stop_reasons).values() if isinstance(word, str)}


def test_reasons_of_every_built_in_law_are_words_of_the_list() -> None:
    found = {word for law in LAWS.values() for word in law.stops}
    assert "timeout" in found
    assert found <= WORDS


def test_only_reasons_that_are_no_law_s_cut_a_run_short() -> None:
    assert not stop_reasons.CUT_SHORT & {word for law in LAWS.values() for word in law.stops}


@pytest.mark.parametrize("reason", stop_reasons.OF_LOOP)
def test_number_of_a_reason_of_the_loop_names_it(reason: str) -> None:
    number = stop_reasons.number_stop(reason)
    assert number < 0
    assert stop_reasons.name_stop(number, ("arrived",)) == reason


def test_numbers_above_0_name_the_reasons_of_the_law() -> None:
    named = [stop_reasons.name_stop(number, ("arrived", "stuck")) for number in (1, 2)]
    assert named == ["arrived", "stuck"]
