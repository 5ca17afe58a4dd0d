"""What commands print as JSON is what the page of schemas says."""

import importlib
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.cli.conftest import Call, call as call, kp4 as kp4, kp10 as kp10
from tests.cli.test_commands_alone import say_twist
from tests.docs.json_schemas import (
    ANSWERS,
    PAGE,
    SCHEMAS,
    find_answer,
    format_page,
    format_schemas,
    know_types,
    show_type,
)
from tests.log.ros2.bags import write_mcap

TYPED = {
    "run": ["run", "paper-kp4"],
    "theory": ["theory"],
    "theory --lag": ["theory", "--lag", "0.1"],
    "theory FILE": ["theory", "KP4"],
    "info": ["info", "KP4"],
    "metrics": ["metrics", "KP4", "KP10"],
    "compare": ["compare", "KP4", "KP10"],
    "compare BAG SCENARIO": ["compare", "KP4", "lagged.toml"],
    "compare --reference": ["compare", "--reference", "KP4", "KP10"],
    "compare --reference --ate": ["compare", "--reference", "KP4", "KP10", "--ate", "--rpe", "1m"],
    "compare --why": ["compare", "KP4", "KP10", "--why", "run.duration"],
    "explain": ["explain", "KP4", "--causes", "queue"],
    "identify": ["identify", "KP4"],
    "replay": ["replay", "KP4", "--set", "law.kp_linear=3", "--expect-equal"],
    "replay --law": ["replay", "KP4", "--law"],
    "replay --plant": ["replay", "KP4", "--plant"],
    "replay of commands alone": ["replay", "commands.mcap"],
    "list": ["list", "causes"],
    "check": ["check", "KP4", "--expect", "rotate.overshoot <= 0"],
    "convert": ["convert", "KP4", "-o", "out.csv"],
    "convert --recover": ["convert", "--recover", "KP4", "-o", "out.mcap"],
    "sweep": ["sweep", "textbook", "--grid", "law.kp_linear=1:2", "-o", "out.parquet"],
    "tune": ["tune", "textbook", "--grid", "law.kp_linear=1:2:1", "--minimise", "run.duration"],
    "metrics -o TABLE": ["metrics", "KP4", "-o", "out.parquet"],
    "plot": ["plot", "KP4", "-o", "out.svg", "--only", "heading"],
    "plot TABLE": ["plot", "TABLE"],
    "report": ["report", "KP4", "-o", "out.html", "--explain", "none"],
}


def test_the_page_and_the_schemas_are_those_of_the_answers() -> None:
    """The modules of all commands are loaded, and each schema is built twice."""
    assert PAGE.read_text("utf-8") == format_page()
    assert SCHEMAS.read_text("utf-8") == format_schemas()


@pytest.mark.parametrize("typed", TYPED)
def test_what_is_printed_has_the_fields_and_types_of_the_answer(
    call: Call,
    kp4: Path,
    kp10: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    files = {"KP4": kp4, "KP10": kp10}
    if "lagged.toml" in TYPED[typed]:
        Path("lagged.toml").write_text(call("scenario", "lagged").out)
    if "commands.mcap" in TYPED[typed]:
        write_mcap(Path("commands.mcap"), [say_twist(0.2, row=0)])
        files["commands.mcap"] = Path("commands.mcap")
    if "TABLE" in TYPED[typed]:
        table = ("--grid", "law.kp_linear=1:2", "--metric", "run.duration", "-o", "TABLE.parquet")
        assert call("sweep", "textbook", *table).code == 0
        files["TABLE"] = Path("TABLE.parquet")
    found = call(*(files.get(word, word) for word in TYPED[typed]), "--json").json
    know_types()
    for value in found if isinstance(found, list) else [found]:
        answer = msgspec.convert(value, show_type(find_answer(typed)), dec_hook=_take, strict=True)
        assert _list_keys(msgspec.to_builtins(answer, enc_hook=dict)) == _list_keys(value)


def _take(_: type, value: Any) -> Any:
    return value


def _list_keys(value: Any) -> Any:
    """Return the keys of a value, of all that is in it."""
    if isinstance(value, dict):
        return {key: _list_keys(inner) for key, inner in value.items()}
    return [_list_keys(inner) for inner in value] if isinstance(value, list | tuple) else None


def test_every_answer_is_tried() -> None:
    assert ANSWERS.keys() == TYPED.keys()


COPIED = {
    "cli.explain:FindingAnswer": ("explain.scenario_from_log:Finding", ""),
    "cli.plot_table:SweptAxisAnswer": ("sweep.sweep_table:SweptAxis", "is_number places"),
    "cli.plot_table:KeySensitivity": (
        "sweep.sweep_analysis:Sensitivity",
        "axis least_place most_place others",  # as keys and values
    ),
    "cli.plot_table:BorderAnswer": (
        "sweep.sweep_analysis:Border",
        "place is_near is_mixed verdict",
    ),
    "cli.plot_table:SensitivityAnswer": (
        "sweep.sweep_analysis:Sensitivities",
        "center metric rows",
    ),
    "cli.replay_answer:DifferenceAnswer": ("replay.differences:Difference", "time_ns"),
    "cli.replay_answer:SignalAnswer": (
        "replay.differences:SignalDifference",
        "largest_difference limit",
    ),
    "cli.replay_answer:GapAnswer": ("replay.breaks_and_commands:Gap", "start_ns end_ns"),
    "cli.replay_answer:JumpAnswer": ("replay.breaks_and_commands:Jump", "at_ns"),
    "cli.replay_answer:PlantReplayAnswer": ("replay.plant_replay:PlantReplay", ""),
    "cli.replay_answer:CommandReplayAnswer": ("replay.plant_replay:CommandReplay", "run"),
    "cli.identify:IdentifyAnswer": ("identify.robot_model:RobotModel", "speed turn_rate"),
    "cli.compare_answer:_Difference": ("compare.ranking:ConditionDifference", "is_unknown"),
}
"""Answers that repeat a result's fields, the result, and its fields that have another form, or that
JSON lacks."""


@pytest.mark.parametrize("answer", COPIED)
def test_an_answer_has_every_field_of_its_result(answer: str) -> None:
    shown, (source, others) = load_class(answer), COPIED[answer]
    known = {one.name for one in fields(load_class(source))}
    assert known - {one.name for one in fields(shown)} == {*others.split()}


def load_class(name: str) -> Any:
    module, _, kind = name.partition(":")
    return getattr(importlib.import_module(f"turtlelog.{module}"), kind)
