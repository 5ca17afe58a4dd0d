import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.laws import LAWS, list_causes

KINDS = ["metrics", "signals", "presets", "laws", "causes", "figures"]


@pytest.mark.parametrize("kind", KINDS)
def test_list_answers_in_json_with_the_names_of_the_table(call: Call, kind: str) -> None:
    answer = call("list", kind, "--json").json
    assert [*answer] == ["kind", "entries"]
    assert answer["kind"] == kind
    _, _, heads, _, *rows = call("list", kind).out.partition("\n\nAnd ")[0].splitlines()
    assert heads.split()[0] == "name"
    shown = [row.split()[0] for row in rows if row and not row.startswith(" ")]
    assert shown[: len(answer["entries"])] == [entry["name"] for entry in answer["entries"]]


def test_every_name_is_listed(call: Call) -> None:
    found = {
        kind: [entry["name"] for entry in call("list", kind, "--json").json["entries"]]
        for kind in KINDS
    }
    declaration = tl.simulate.declare_scenario(tl.load_scenario("textbook"))
    assert found["metrics"] == [*tl.measure.list_metrics(declaration)]
    states = [
        f"{term}_{axis}" for axis in ("angular", "linear") for term in ("integral", "derivative")
    ]
    assert found["signals"] == [*tl.SIGNALS, *states, "lyapunov"]
    assert found["presets"] == [*tl.PRESETS]
    assert found["laws"] == [*LAWS]
    assert found["figures"] == [*tl.draw.FIGURES]
    scenario = tl.load_scenario("paper")
    from turtlelog.explain.causes import find_causes

    # Those of other laws follow, each under its law, and those of the robot.
    ours = find_causes(scenario)
    others = [one.name for kind in [*LAWS][1:] for one in list_causes(LAWS[kind])]
    limits = ("acceleration", "bound", "deadband", "friction", "reverse-gain")
    robot = [f"robot-{name}" for name in limits]
    assert found["causes"] == [*ours, *others, *robot]


@pytest.mark.parametrize("kind", KINDS)
def test_lists_fit_the_terminal(call: Call, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, call("list", kind).out.splitlines())) <= 80


@pytest.mark.parametrize("kind", ["metrics", "signals", "presets"])
def test_a_pipe_has_every_meaning_in_the_line_of_its_name(call: Call, kind: str) -> None:
    lines = call("list", kind).out.splitlines()
    for entry in call("list", kind, "--json").json["entries"]:
        assert any(
            line.split()[:1] == [entry["name"]] and entry["meaning"] in line for line in lines
        )
