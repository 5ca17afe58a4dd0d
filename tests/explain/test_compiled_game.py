from typing import Any, Final

import pytest

from tests.effects_cases import build_case
from turtlelog.explain.game import Outcome, ScenarioGame
from turtlelog.scenario import resolve_scenario
from turtlelog.simulate.many import CompiledCode, find_loop

SCENARIO: Final = build_case("noise", "loss", preset="paper", max_duration_s=4.0)


def play(monkeypatch: pytest.MonkeyPatch, loop: CompiledCode, kernel: Any) -> list[Outcome]:
    monkeypatch.setattr(loop, "_loops", kernel)
    monkeypatch.setattr(loop, "_saved_s", 1e9)
    game = ScenarioGame(SCENARIO, "final.heading_error")
    return [found for out in ([], ["noise"], ["loss"]) for found in game.take_out_each(out)]


@pytest.mark.thorough
def test_outcomes_of_the_compiled_loop_are_those_of_the_plain_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("numba")
    loop = find_loop(resolve_scenario(SCENARIO), SCENARIO.plant.facts)
    assert loop is not None
    kernel = loop.load()
    assert kernel is not None
    plain = play(monkeypatch, loop, None)
    assert len({found.value for found in plain}) > 64
    assert play(monkeypatch, loop, kernel) == plain
