"""A law, an effect, a plant and a key: each is added to a copy of the package as a file and a line.

Takes over 2 s: what is added is compiled.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import turtlelog

CREEP = """
from dataclasses import dataclass
from typing import Any

from turtlelog.laws.base import LawPart
from turtlelog.run.loops import Declaration


@dataclass(frozen=True, slots=True, kw_only=True)
class CreepParameters:
    pace: float = 0.5


@dataclass(slots=True)
class CreepState:
    count: int = 0


def step(settings: Any, state: Any, row: Any) -> tuple[float, float]:
    state.count += 1
    if state.count > 50:
        row.stop = 1
    return settings.law.pace, 0.1


PART = LawPart(
    name="creep",
    meaning="Creep along a circle.",
    Parameters=CreepParameters,
    step=step,
    declare=lambda *_: Declaration(uses_goal=False),
    State=CreepState,
    stops=("enough",),
    counts_samples=(),
)
"""

WEAKEN = """
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from turtlelog.run.loops import Cause
from turtlelog.parts import Action, Complaint, Effect, Probability, absent


@dataclass(frozen=True, slots=True, kw_only=True)
class WeakenKeys:
    weakening: Probability = absent(0.0)


def weaken(settings: Any, value: tuple[float, float]) -> tuple[float, float]:
    if settings.limits.weakening == 0.0:
        return value
    rest = 1.0 - settings.limits.weakening
    return value[0] * rest, value[1] * rest


def judge(scenario: Any) -> Iterator[Complaint]:
    if scenario.limits.weakening == 1.0:
        yield "limits.weakening", "less than all", "1"


PART = Effect(
    name="weaken",
    tables={"limits": WeakenKeys},
    actions={"limit": Action(step=weaken)},
    causes=(
        Cause(
            name="weaken",
            kind="effect",
            neutral={"limits.weakening": 0.0},
            meaning="commands in full",
        ),
    ),
    judge=judge,
)
"""

SLED = """
import math
from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Plant, PlantPart


@dataclass(frozen=True, slots=True, kw_only=True)
class SledKeys:
    period_s: float = 0.02
    friction: float = 0.0


@dataclass(slots=True)
class SledState:
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    speed: float = 0.0
    turn_rate: float = 0.0
    hit_wall: bool = False


def begin(keys: Any, x_m: float, y_m: float, heading_rad: float, *, is_rounded: bool) -> SledState:
    return SledState(x_m, y_m, heading_rad)


def hold(settings: Any, state: Any, rows: Any, time_ns: int, speed: float, turn: float) -> None:
    state.speed, state.turn_rate = speed * (1.0 - settings.plant.friction), turn


def push(settings: Any, state: Any, speed: float, turn_rate: float) -> None:
    state.speed += speed


def move(settings: Any, state: Any, rows: Any, time_ns: int) -> bool:
    state.heading_rad += state.turn_rate * settings.scene.period_s
    state.x_m += state.speed * math.cos(state.heading_rad) * settings.scene.period_s
    state.y_m += state.speed * math.sin(state.heading_rad) * settings.scene.period_s
    return True


def read(state: Any) -> tuple[float, float, float, float, float]:
    return state.x_m, state.y_m, state.heading_rad, abs(state.speed), state.turn_rate


PART = PlantPart(
    name="sled",
    meaning="a sled",
    Keys=SledKeys,
    find_facts=lambda keys: Plant(
        name="sled",
        period_ns=round(keys.period_s * 1e9),
        low_m=-1e6,
        high_m=1e6,
        acts_in_steps=True,
        turns_first=True,
        holds_rates=True,
        dynamics="other" if keys.friction else "integrator",
    ),
    State=SledState,
    begin=begin,
    hold=hold,
    push=push,
    move=move,
    read=read,
)
"""

FILES = {"laws/creep.py": CREEP, "effects/weaken.py": WEAKEN, "plants/sled.py": SLED}
LATE = "    late_s: Time = absent(0.0)\n"
LINES = {
    "laws/loading.py": ('    "open_loop",\n', '    "open_loop",\n    "creep",\n'),
    "effects/__init__.py": ('    "precision",\n', '    "weaken",\n    "precision",\n'),
    "plants/__init__.py": ('    "lagged",\n', '    "lagged",\n    "sled",\n'),
    # And a key of an effect that is there.
    "effects/late.py": (LATE, f"{LATE}    lateness: Time = absent(0.0)\n"),
}

SCENARIO = (
    *("--set", "law.kind=creep", "--set", "law.pace=0.8", "--set", "plant.kind=sled"),
    *("--set", "plant.friction=0.25", "--set", "limits.weakening=0.5"),
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parts")
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(turtlelog.__file__).parent, folder / "turtlelog", ignore=ignored)
    for name, text in FILES.items():
        (folder / "turtlelog" / name).write_text(text, "utf-8")
    for name, (before, after) in LINES.items():
        file = folder / "turtlelog" / name
        text = file.read_text("utf-8")
        assert text.count(before) == 1
        file.write_text(text.replace(before, after), "utf-8")
    return folder


def run(copy: Path, *words: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    command = [sys.executable, "-P", *words]
    done = subprocess.run(
        command, cwd=copy, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def ask(copy: Path, *words: str) -> Any:
    return json.loads(run(copy, "-m", "turtlelog", *words, "--json"))


CALLS = """
import contextlib, io, json, sys
from turtlelog.cli.app import main

answers = []
for words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(words.split())
        except SystemExit as end:
            answers.append((end.code, out.getvalue() + err.getvalue()))
print(json.dumps(answers))
"""


def call(copy: Path, *commands: str) -> list[tuple[int, str]]:
    """Return exit code and text of each command; all run in one process."""
    return [tuple(one) for one in json.loads(run(copy, "-c", CALLS, json.dumps(commands)))]


def read_metrics(found: Any) -> dict[str, float]:
    return {one["id"]: one["value"] for one in found[0]["metrics"]}


def test_new_parts_run_and_are_recorded_and_replayed(copy: Path) -> None:
    run(copy, "-m", "turtlelog", "run", "textbook", *SCENARIO, "-o", "run.mcap")
    metrics = read_metrics(ask(copy, "metrics", "run.mcap", "--all"))
    # 51 samples of 20 ms: the last command, the 50th that acts, is 0.8 m/s, weakened and slowed.
    assert metrics["run.duration"] == pytest.approx(1.0)
    assert metrics["run.path_length"] == pytest.approx(50 * 0.02 * 0.8 * 0.5 * 0.75)
    assert ask(copy, "replay", "run.mcap")["first_difference"] is None


@pytest.mark.thorough
def test_new_parts_are_explained_and_listed(copy: Path) -> None:
    """Five commands are started, each in its own process."""
    run(copy, "-m", "turtlelog", "run", "textbook", *SCENARIO, "-o", "explained.mcap")
    found = ask(copy, "explain", "explained.mcap", "--metric", "run.path_length")
    assert "weaken" in json.dumps(found)
    for kind, name in (("laws", "creep"), ("plants", "sled"), ("causes", "weaken")):
        assert name in {entry["name"] for entry in ask(copy, "list", kind)["entries"]}


def test_a_new_effect_judges_the_scenario_and_a_new_key_is_one(copy: Path) -> None:
    code = (
        "from turtlelog.scenario import get_preset, override_scenario, flatten_scenario\n"
        "from turtlelog.errors import ScenarioError\n"
        "base = get_preset('textbook')\n"
        "changes = {'loop.lateness': 0.5}\n"
        "print(flatten_scenario(override_scenario(base, changes))['loop.lateness'])\n"
        "try:\n    override_scenario(base, {'limits.weakening': 1.0})\n"
        "except ScenarioError as err:\n    print(err)\n"
    )
    lines = run(copy, "-c", code).splitlines()
    expected = "changes: limits.weakening: expected less than all, found 1"
    assert lines == ["0.5", expected]


@pytest.mark.thorough
def test_new_parts_are_compiled_as_they_run_plain(copy: Path) -> None:
    """A loop is compiled."""
    pytest.importorskip("numba")
    code = (
        "from turtlelog.scenario import get_preset, override_scenario\n"
        "from turtlelog.simulate import simulate_run\n"
        "from turtlelog.simulate.compiled_loop import CompiledRunner\n"
        "from turtlelog.simulate.many import find_loop\n"
        "changes = {'law.kind': 'creep', 'plant.kind': 'sled', 'limits.weakening': 0.3,\n"
        "           'sensing.noise_position_m': 0.1}\n"
        "scenario = override_scenario(get_preset('textbook'), changes)\n"
        "plant = scenario.plant.facts\n"
        "loop = find_loop(scenario, plant).load()\n"
        "one = CompiledRunner().simulate(loop, scenario, plant)\n"
        "two = simulate_run(scenario)\n"
        "print((one.poses.xy_m == two.poses.xy_m).all(), len(one.samples), one.stop_reason)\n"
        "print((one.poses.sensed_xy_m == two.poses.sensed_xy_m).all())\n"
    )
    assert run(copy, "-c", code).split() == ["True", "51", "enough", "True"]


ROUGH = "textbook --set plant.kind=sled --set plant.friction=0.25"
UNKNOWN = "theory knows no plant of the kind sled"


@pytest.fixture(scope="module")
def sled(copy: Path) -> Path:
    recorded, scenario = call(copy, f"run {ROUGH} -o sled.mcap", f"scenario {ROUGH}")
    assert (recorded[0], scenario[0]) == (0, 0), (recorded, scenario)
    (copy / "sled.toml").write_text(scenario[1], "utf-8")
    return copy


def test_a_new_plant_is_replayed_by_its_own_step(sled: Path) -> None:
    """The sled is simulated in another process."""
    found = ask(sled, "replay", "sled.mcap", "--plant")
    assert (found["first_difference"], found["heading_bits"]) == (None, 64)
    assert (found["stretches"][0]["ticks"], found["jumps"], found["gaps"]) == (1277, [], [])


def test_theory_has_no_model_of_a_new_plant_unless_it_declares_one(sled: Path) -> None:
    """Four commands take 2 s."""
    recorded, rough, smooth, turtle = call(
        sled,
        "theory sled.mcap --json",
        f"theory {ROUGH} --json",
        "theory textbook --set plant.kind=sled --json",
        "theory textbook --json",
    )
    for code, text in (recorded, rough):
        assert (code, {loop["reason"] for loop in json.loads(text)["loops"]}) == (0, {UNKNOWN})
    # Without friction it declares 1/s, of which P control is stable up to 2 / T.
    for (_, text), limit in ((smooth, 2.0 / 0.02), (turtle, 2.0 / 0.016)):
        stable = [loop["sampled"]["stable_gains"] for loop in json.loads(text)["loops"]]
        assert stable == [[[0.0, pytest.approx(limit)]]] * 2


def test_a_new_plant_has_no_figures_of_the_plant_1_over_s(sled: Path) -> None:
    """matplotlib is loaded in another process."""
    only = "plot sled.mcap -o pics --only"
    plant, locus, plane = call(
        sled, f"{only} plant", f"{only} root-locus", f"{only} step-responses,plane,speed"
    )
    assert (plant[0], locus[0], plane[0]) == (2, 2, 0), plane
    assert plant[1].strip().endswith("figure plant needs a plant that is 1/s")
    assert UNKNOWN in locus[1]


@pytest.mark.thorough
def test_a_new_plant_is_measured_and_identified_as_a_robot(sled: Path) -> None:
    """The fit takes 5 s."""
    metrics, identified = call(sled, "metrics sled.mcap --all --json", "identify sled.mcap --json")
    (found,) = json.loads(metrics[1])
    values = {one["id"]: one["value"] for one in found["metrics"]}
    # The sled turns at the commanded rate, and drives at 75 % of the commanded speed.
    assert (values["rotate.dead_time"], values["translate.dead_time"]) == (0.0, None)
    gains = [axis["gain"]["value"] for axis in json.loads(identified[1])["axes"]]
    assert gains == pytest.approx([0.75, 1.0])


@pytest.mark.thorough
def test_a_new_plant_is_compared_explained_and_checked(sled: Path) -> None:
    """Six commands take 5 s."""
    robot, made, compared, explained, init, checked = call(
        sled,
        "compare sled.toml sled.mcap",
        "run textbook -o turtle.mcap",
        "compare sled.mcap turtle.mcap --json",
        "explain sled.mcap",
        "check --init sled.mcap -o spec.toml",
        "check spec.toml sled.mcap",
    )
    assert robot[0] == 2
    assert "not sled; turtlelog replay drives sled with recorded commands" in robot[1]
    codes = [code for code, _ in (made, compared, explained, init, checked)]
    assert codes == [0] * 5, (compared, explained, init, checked)
    assert '"plant.kind"' in compared[1]
    assert "turtlesim" not in explained[1]


def test_recorded_commands_drive_a_new_plant(sled: Path) -> None:
    """The sled is simulated in another process."""
    code = (
        "import turtlelog as tl\n"
        "turtle = tl.simulate.simulate_run(tl.scenario.get_preset('textbook'))\n"
        "samples = tl.run.take_rows(turtle.samples, slice(0))\n"
        "given = {'poses': turtle.poses, 'commands': turtle.commands, 'samples': samples}\n"
        "bag = tl.run.Run(name='bag', source='test', **given)\n"
        "found = tl.replay.drive_commands(bag, tl.scenario.read_scenario('sled.toml'))\n"
        "again = tl.replay.drive_commands(bag)\n"
        "print(found.plant, found.path_length_m / again.path_length_m)\n"
    )
    plant, ratio = run(sled, "-c", code).split()
    assert plant == "sled"
    assert float(ratio) == pytest.approx(0.75, abs=0.01)
