from typing import Any

import pytest

from tests.effects_cases import build_case
from turtlelog.explain.game import Game, Outcome
from turtlelog.simulate.many import LOOP


def play(monkeypatch: pytest.MonkeyPatch, kernel: Any) -> list[Outcome]:
    monkeypatch.setattr(LOOP, "_loops", kernel)
    monkeypatch.setattr(LOOP, "_saved_s", 1e9)
    scenario = build_case("noise", "loss", preset="paper", max_duration_s=4.0)
    game = Game(scenario, "final.heading_error")
    return [found for out in ([], ["noise"], ["loss"]) for found in game.take_out_each(out)]


def test_outcomes_of_the_compiled_loop_are_those_of_the_interpreted_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("numba")
    kernel = LOOP.load()
    assert kernel is not None
    interpreted = play(monkeypatch, None)
    assert len({found.value for found in interpreted}) > 64
    assert play(monkeypatch, kernel) == interpreted
