import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.log.recording.test_damage import HEAD, write_mcap
from tests.log.runs import STRANGE, make_run, simulate_short_run
from turtlelog.errors import LogError
from turtlelog.laws.sequential_p import DECLARATION
from turtlelog.log import read_info, read_recording, write_recording
from turtlelog.log.recording.reader import declare_format1
from turtlelog.log.recording.topics import (
    define_types,
    find_type_hash,
    name_state_type,
)
from turtlelog.run.loops import ControlLoop, Declaration, format_declaration, parse_declaration

ENTRY: dict[str, Any] = json.loads(format_declaration(STRANGE))


@pytest.mark.parametrize("declaration", [DECLARATION, STRANGE, Declaration(uses_goal=False)])
def test_a_declaration_comes_back_in_order(declaration: Declaration) -> None:
    found = parse_declaration(format_declaration(declaration))
    assert found == declaration
    assert found.phase_names == declaration.phase_names
    assert list(found.phases) == list(declaration.phases)


def test_the_entry_is_as_the_format_page_shows() -> None:
    assert ENTRY == {
        "loops": [
            {
                "name": "b",
                "signal": "heading",
                "command": "turn_rate",
                "reference": "recorded",
            },
            {
                "name": "a",
                "signal": "distance",
                "command": "speed",
                "reference": "zero",
                "gain": "law.kp",
                "limit": "law.v",
            },
        ],
        "phases": [{"name": "two", "loops": ["b", "a"]}, {"name": "one", "loops": ["a"]}],
        "states": ["time_ns", "integral_2"],
        "uses_goal": True,
    }


def test_only_a_loop_that_is_not_proportional_says_so_and_comes_back() -> None:
    assert "is_proportional" not in format_declaration(STRANGE)
    assert all(loop.is_proportional for loop in parse_declaration(json.dumps(ENTRY)).loops)
    second = replace(STRANGE.loops[1], is_proportional=False)
    declaration = replace(STRANGE, loops=(STRANGE.loops[0], second))
    text = format_declaration(declaration)
    assert json.loads(text)["loops"][1] == LOOP | {"is_proportional": False}
    assert parse_declaration(text) == declaration


def test_keys_of_a_pid_come_back_and_stay_out_where_there_are_none() -> None:
    keys: dict[str, Any] = {
        "integral_gain": "law.ki",
        "derivative_gain": "law.kd",
        "derivative_filter": "law.derivative_filter_s",
    }
    assert not keys.keys() & json.loads(format_declaration(STRANGE))["loops"][1].keys()
    declaration = replace(STRANGE, loops=(STRANGE.loops[0], replace(STRANGE.loops[1], **keys)))
    text = format_declaration(declaration)
    assert json.loads(text)["loops"][1] == LOOP | keys
    assert parse_declaration(text) == declaration


LOOP = ENTRY["loops"][1]
WRONG = {
    "no object": ([], "Expected `object`, got `array`"),
    "no JSON": ("{", "Expected `object`, got `str`"),
    "a loop short of a field": (ENTRY | {"loops": [{"name": "b"}]}, r"\$.loops\[0\]"),
    "an unknown field": (ENTRY | {"colour": 1}, "unknown field `colour`"),
    "an unknown signal": (ENTRY | {"loops": [LOOP | {"signal": "luck"}]}, "loop a: signal: exp"),
    "a loop twice": (ENTRY | {"loops": [LOOP, LOOP]}, "loops: expected each name once"),
    "a loop called run": (ENTRY | {"loops": [LOOP | {"name": "run"}]}, "expected another name"),
    "a truth that is none": (
        ENTRY | {"loops": [LOOP | {"is_proportional": 1}]},
        r"Expected `bool`, got `int` - at `\$\.loops\[0\]\.is_proportional`",
    ),
    "a gain that is no key": (ENTRY | {"loops": [LOOP | {"gain": "k p"}]}, "expected a key"),
    "no phase": (ENTRY | {"phases": []}, "phases: expected 1 to 250, found 0"),
    "a phase twice": (ENTRY | {"phases": [ENTRY["phases"][0]] * 2}, "'two' twice"),
    "251 phases": (
        ENTRY | {"phases": [{"name": f"p{number}", "loops": []} for number in range(251)]},
        "phases: expected 1 to 250, found 251",
    ),
    "a loop that is none": (
        ENTRY | {"phases": [{"name": "one", "loops": ["c"]}]},
        "phase one: loop: expected one of b, a, found 'c'",
    ),
    "a name of two lines": (
        ENTRY | {"phases": [{"name": "one\nworse", "loops": []}]},
        r"phase: expected a name of letters, .* found 'one\\nworse'",
    ),
    "a state of two lines": (ENTRY | {"states": ["i\nfloat64 j"]}, r"found 'i\\nfloat64 j'"),
    "a state that is a signal": (ENTRY | {"states": ["distance"]}, "a name that no signal has"),
    "251 states": (
        ENTRY | {"states": [f"s{number}" for number in range(251)]},
        "states: expected up to 250, found 251",
    ),
    "a name without end": (
        ENTRY | {"states": ["x" * 100_000]},
        "state: expected a field name of ROS 2 such as integral, found 'xxx",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_declaration_is_one_short_line(wrong: str, tmp_path: Path) -> None:
    entry, expected = WRONG[wrong]
    head = HEAD | {"format_version": "2", "declaration": json.dumps(entry)}
    path = write_mcap(tmp_path / "odd.mcap", head)
    for read in (read_recording, read_info):
        with pytest.raises(LogError, match=r"\A[^\n]+\Z") as caught:
            read(path)
        assert caught.match(rf"odd\.mcap: metadata turtlelog: declaration: .*{expected}")
        assert len(str(caught.value)) < 500 + len(str(path))


def test_250_states_and_phases_are_read() -> None:
    states = tuple(f"s{number}" for number in range(250))
    phases = {f"p{number}": () for number in range(250)}
    declaration = Declaration(states=states, phases=phases)
    assert parse_declaration(format_declaration(declaration)) == declaration


def test_a_million_states_are_refused_by_their_size(tmp_path: Path) -> None:
    entry = json.dumps(ENTRY | {"states": ["s"] * 1_000_000})
    path = write_mcap(tmp_path / "odd.mcap", HEAD | {"format_version": "2", "declaration": entry})
    with pytest.raises(LogError, match=r"metadata turtlelog: expected up to 262144 bytes, found"):
        read_recording(path)


def make_long(loops: int) -> Declaration:
    """Return a declaration whose phases name their loops again and again."""
    names = tuple(f"{'x' * 50}{number:03}" for number in range(loops))
    return Declaration(
        loops=tuple(
            ControlLoop(name=name, signal="distance", command="speed", reference="zero")
            for name in names
        ),
        phases={f"p{number}": names for number in range(25)},
    )


def test_what_is_written_can_be_read(tmp_path: Path) -> None:
    run = replace(simulate_short_run(), declaration=make_long(80))
    write_recording(run, tmp_path / "a.mcap")
    assert read_recording(tmp_path / "a.mcap").declaration == make_long(80)
    assert len(format_declaration(make_long(90))) > 2**17 > len(format_declaration(make_long(80)))
    with pytest.raises(
        LogError, match=r"b\.mcap: declaration: expected up to 131072 bytes as JSON"
    ):
        write_recording(replace(run, declaration=make_long(90)), tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_format_2_without_a_declaration_is_named(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "odd.mcap", HEAD | {"format_version": "2"})
    with pytest.raises(
        LogError, match=r"mcap: metadata turtlelog: the entry declaration is missing"
    ):
        read_recording(path)


@pytest.mark.parametrize(
    ("tables", "has_samples", "loops"),
    [
        ({"law": {"kind": "sequential-p"}}, False, 2),
        ({"law": {"kp_angular": 2.0}}, True, 2),
        ({}, True, 2),
        ({}, False, 0),
        ({"law": {"kind": "mine.py:Law"}}, True, 0),
        ({"law": {"kind": ["sequential-p"]}}, True, 0),
        ({"law": "sequential-p"}, False, 0),
    ],
)
def test_the_law_of_format_1_is_told_by_its_name(
    tables: dict[str, Any],
    has_samples: bool,  # noqa: FBT001
    loops: int,
) -> None:
    assert len(declare_format1(tables, has_samples=has_samples).loops) == loops


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("sequential-pid", "SequentialPidState"),
        ("laws/file.py:TurnAndDrive", "TurnAndDriveState"),
        ("package.module:my_law2", "MyLaw2State"),
        ("file.py:2nd", "Law2ndState"),
        ("file.py:\u00c4ther\nfloat64 x", "TherFloat64XState"),
        ("", "LawState"),
        (7, "Law7State"),
        ("x" * 500, "X" + "x" * 59 + "State"),
    ],
)
def test_the_type_of_the_states_is_called_after_the_law(kind: object, name: str) -> None:
    assert name_state_type(kind) == f"turtlelog_msgs/msg/{name}"


def test_the_hash_of_the_states_is_that_of_ros_2() -> None:
    kind = name_state_type("mine.py:Law")
    text = define_types(STRANGE, "mine.py:Law")[kind]
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, kind))
    assert find_type_hash(kind, text) == store.hash_rihs01(kind)
    assert find_type_hash(kind, text + "float64 more\n") is None


def test_every_state_has_a_comment(tmp_path: Path) -> None:
    run = make_run(np.ones(3), parameters={"law.kind": "mine.py:Law"})
    write_recording(run, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    texts = {schema.name: schema.data.decode() for schema in summary.schemas.values()}
    lines = texts["turtlelog_msgs/msg/LawState"].splitlines()
    fields = [number for number, line in enumerate(lines) if line.startswith("float64 ")]
    assert [lines[number] for number in fields] == ["float64 time_ns", "float64 integral_2"]
    assert all(lines[number - 1].startswith("# ") for number in fields)
    assert "rotate" not in texts["turtlelog_msgs/msg/ControlSample"]
