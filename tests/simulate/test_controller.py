import math
import re
from dataclasses import replace
from typing import Any, ClassVar

import pytest

from turtlelog.errors import SimulationError
from turtlelog.laws import Decision, Goal, Pose, SequentialPParameters
from turtlelog.plants import TURTLESIM
from turtlelog.run.paths import Path
from turtlelog.scenario import Limits, LoopSettings, Scenario
from turtlelog.simulate import PlainLoop, SampleRow, TickRow, loop


class Script:
    """Answers its n-th pose with the n-th command of a script, then with the last."""

    Parameters: ClassVar = SequentialPParameters

    def __init__(self, *script: dict[str, Any]) -> None:
        self.script = script or ({},)
        self.resets: list[tuple[Pose, Goal | None]] = []
        self.times_ns: list[int] = []

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        assert path is None
        self.resets.append((start, goal))

    def step(self, time_ns: int, pose: Pose) -> Decision:
        self.times_ns.append(time_ns)
        own = self.script[min(len(self.times_ns), len(self.script)) - 1]
        values: dict[str, Any] = {
            "speed_m_s": 0.0,
            "turn_rate_rad_s": 0.0,
            "bearing_rad": 0.0,
            "heading_error_rad": 0.0,
            "error_x_m": 3.0,
            "error_y_m": 4.0,
        }
        return Decision(**(values | own))


class Sparse(Script):
    """Answers with a command alone."""

    def step(self, time_ns: int, pose: Pose) -> Decision:
        return Decision(speed_m_s=1.0, turn_rate_rad_s=0.0)


class Controller:
    """The controller of a loop without a plant: poses are handed to it tick by tick.

    A tick lasts 1000 ns here.
    """

    def __init__(self, scenario: Scenario, law: Script) -> None:
        self.loop = PlainLoop(scenario, TICK, law=law)
        self.failure: SimulationError | None = None

    def receive(self, tick: int, pose: Pose) -> None:
        made = self.loop
        row = made.rows.ticks[tick] = TickRow(pose.x_m, pose.y_m, pose.heading_rad, arrival_ns=0)
        made.now.ticks += 1
        loop.queue_pose(made.settings, made.now, made.rows, row, tick)

    def answer(self, tick: int) -> tuple[list[SampleRow], list[SampleRow]]:
        """Return the samples computed and those published."""
        made, now = self.loop, self.loop.now
        before, sent = now.samples, now.published
        try:
            loop.answer_poses(made.settings, made.state, made.rows, made.parts, tick)
        except SimulationError as err:
            # Without the frame of this file, in which the law stands.
            above = err.__traceback__ and err.__traceback__.tb_next
            self.failure = made.describe_failure(err.with_traceback(above))
        rows = made.rows.samples
        computed = [rows[number] for number in range(before, now.samples)]
        return computed, [rows[number] for number in range(sent, now.published)]

    @property
    def dropped(self) -> int:
        return int(self.loop.now.poses_dropped)


TICK = replace(TURTLESIM, period_ns=1000)


def make_controller(law: Script, limits: Limits | None = None, **loop: Any) -> Controller:
    scenario = replace(Scenario(), loop=LoopSettings(**loop), limits=limits or Limits())
    return Controller(scenario, law)


def run_ticks(controller: Controller, ticks: range) -> list[tuple[list[int], list[int]]]:
    """Return the numbers of the poses answered, and of the samples published, by tick."""
    answers = []
    for tick in ticks:
        controller.receive(tick, Pose(float(tick), 0.0, 0.0))
        computed, published = controller.answer(tick)
        answers.append(([s.pose_sequence for s in computed], [s.sequence for s in published]))
    return answers


def answer_once(law: Script, limits: Limits | None = None) -> SampleRow:
    controller = make_controller(law, limits)
    controller.receive(0, Pose(1.0, 2.0, 3.0))
    return controller.answer(0)[1][0]


def test_every_pose_is_answered_in_its_tick() -> None:
    answers = run_ticks(make_controller(Script()), range(3))
    assert answers == [([0], [0]), ([1], [1]), ([2], [2])]


def test_law_is_reset_once_with_the_first_pose_it_reads() -> None:
    law = Script()
    run_ticks(make_controller(law, start_backlog=3), range(5))
    assert law.resets == [(Pose(0.0, 0.0, 0.0), Goal(2.0, 10.0))]


def test_what_a_law_leaves_out_is_filled_in() -> None:
    sample = answer_once(Sparse())
    assert (sample.error_x_m, sample.error_y_m) == (1.0, 8.0)


def test_start_backlog_is_answered_at_once() -> None:
    law = Script()
    answers = run_ticks(make_controller(law, start_backlog=3), range(4))
    assert answers == [([], []), ([], []), ([0, 1, 2], [0, 1, 2]), ([3], [3])]
    assert law.times_ns == [2000, 2000, 2000, 3000]


def test_start_backlog_beyond_the_pose_queue_loses_the_oldest_poses() -> None:
    controller = make_controller(Script(), start_backlog=12, pose_queue=10)
    assert run_ticks(controller, range(12))[-1][0] == list(range(2, 12))
    assert controller.dropped == 2


def test_controller_answers_every_nth_pose() -> None:
    answers = run_ticks(make_controller(Script(), period_ticks=3), range(8))
    assert [tick for tick, (computed, _) in enumerate(answers) if computed] == [0, 3, 6]


def test_blocked_controller_publishes_at_the_end_of_its_callback() -> None:
    controller = make_controller(Script({}, {"blocks_ticks": 3}, {}))
    answers = run_ticks(controller, range(6))
    assert answers[1:4] == [([1], []), ([], []), ([], [])]
    assert answers[4:] == [([2, 3, 4], [1, 2, 3, 4]), ([5], [5])]


def test_poses_that_waited_are_answered_in_one_burst() -> None:
    law = Script({"blocks_ticks": 33}, {})
    controller = make_controller(law)
    answers = run_ticks(controller, range(35))
    assert answers[33] == (list(range(24, 34)), list(range(11)))
    assert answers[34] == ([34], [11])
    assert controller.dropped == 23
    assert set(law.times_ns[1:11]) == {33_000}


def test_block_within_a_burst_keeps_the_rest_waiting() -> None:
    controller = make_controller(Script({}, {"blocks_ticks": 2}, {}), start_backlog=3)
    assert run_ticks(controller, range(5))[2:] == [
        ([0, 1], [0]),
        ([], []),
        ([2, 3, 4], [1, 2, 3, 4]),
    ]


def test_law_that_goes_on_with_a_phase_it_ended_is_refused() -> None:
    controller = make_controller(Script({"ends_phase": True}, {}))
    run_ticks(controller, range(2))
    line = "sample 1: expected another phase than control, which had ended, found it again"
    assert line in str(controller.failure)


def test_nothing_is_answered_after_the_last_sample() -> None:
    controller = make_controller(Script({}, {"stop_reason": "standstill"}), start_backlog=5)
    assert run_ticks(controller, range(5))[-1] == ([0, 1], [0, 1])


@pytest.mark.parametrize(
    ("wanted", "clipped"), [(3.0, 0.8), (-3.0, -0.8), (0.5, 0.5), (0.8, 0.8), (-0.0, 0.0)]
)
def test_commands_are_clipped_to_their_limits(wanted: float, clipped: float) -> None:
    limits = Limits(speed_m_s=0.8, turn_rate_rad_s=0.8)
    sample = answer_once(Script({"speed_m_s": wanted, "turn_rate_rad_s": wanted}), limits)
    assert (sample.speed_m_s, sample.turn_rate_rad_s) == (clipped, clipped)
    assert (sample.wanted_speed_m_s, sample.wanted_turn_rate_rad_s) == (wanted, wanted)


def test_each_command_has_its_own_limit() -> None:
    limits = Limits(speed_m_s=2.0, turn_rate_rad_s=0.5)
    sample = answer_once(Script({"speed_m_s": 9.0, "turn_rate_rad_s": 9.0}), limits)
    assert (sample.speed_m_s, sample.turn_rate_rad_s) == (2.0, 0.5)


def test_infinite_limits_clip_nothing() -> None:
    limits = Limits(speed_m_s=math.inf, turn_rate_rad_s=math.inf)
    sample = answer_once(Script({"speed_m_s": 1e6, "turn_rate_rad_s": -1e6}), limits)
    assert (sample.speed_m_s, sample.turn_rate_rad_s) == (1e6, -1e6)


def test_sample_holds_its_distance_to_the_goal() -> None:
    assert answer_once(Script()).distance_m == 5.0


@pytest.mark.parametrize("name", ["speed_m_s", "turn_rate_rad_s"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_command_that_is_not_finite_is_refused(name: str, value: float) -> None:
    controller = make_controller(Script({}, {name: value}))
    run_ticks(controller, range(2))
    assert re.match(r"\Alaw Script, sample 1: expected [^\n]*\Z", str(controller.failure))
