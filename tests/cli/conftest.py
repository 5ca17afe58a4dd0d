import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from turtlelog.cli.app import main


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answer:
    code: int
    out: str
    err: str

    @property
    def flat(self) -> str:
        """What was printed in one line, wherever its lines end and commands continue."""
        return " ".join(self.out.replace(" \\\n", " ").split())

    @property
    def json(self) -> Any:
        return json.loads(self.out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


Call = Callable[..., Answer]

SPEC = """format = 1
[checks.overshoot]
expect = "rotate.overshoot <= 0.5"
reason = "half a percent is seen"
[checks.gains]
expect = "final.position_error < 0.02"
when = "law.kp_linear < 5"
"""
"""One run of the paper passes it, another fails."""


def read_identified(answer: dict[str, Any]) -> dict[str, Any]:
    """Return the identified values of explain's JSON by their keys."""
    return {one["key"]: one["value"] for one in answer["identified"]}


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    """Run a command as a shell would."""

    def run_command(*words: str | Path) -> Answer:
        with pytest.raises(SystemExit) as stop:
            main([str(word) for word in words])
        out, err = capsys.readouterr()
        code = stop.value.code
        assert isinstance(code, int)
        return Answer(code=code, out=out, err=err)

    return run_command


@pytest.fixture(scope="session")
def kp4(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "kp4.mcap"
    tl.write_recording(tl.simulate_run(tl.load_scenario("paper-kp4")), path)
    return path


@pytest.fixture(scope="session")
def kp10(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "kp10.mcap"
    tl.write_recording(tl.simulate_run(tl.load_scenario("paper-kp10")), path)
    return path


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "spec.toml"
    path.write_text(SPEC, encoding="utf-8")
    return path
