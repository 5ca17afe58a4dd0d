import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w

import turtlelog as tl
from turtlelog.check import load_spec
from turtlelog.check.reference import load_reference
from turtlelog.errors import TurtlelogError
from turtlelog.files.text_files import (
    MOST_BYTES,
    format_toml,
    parse_known_toml,
    parse_toml,
    read_text_file,
)
from turtlelog.measure.references import read_reference_path
from turtlelog.scenario import override_scenario, parse_assignments, read_scenario

READERS: list[Callable[[Path], Any]] = [
    read_scenario,
    load_spec,
    tl.check.load_tolerances,
    read_reference_path,
]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null"])
def test_a_device_is_refused_at_once(read: Callable[[Path], Any], device: str) -> None:
    if not Path(device).exists():
        pytest.skip("has no such device")
    start = time.monotonic()
    with pytest.raises(TurtlelogError, match=rf"\A{device}: expected [^\n]*, found: a device\Z"):
        read(Path(device))
    assert time.monotonic() - start < 1.0


@pytest.mark.parametrize("read", READERS)
def test_a_folder_is_refused(read: Callable[[Path], Any], tmp_path: Path) -> None:
    with pytest.raises(TurtlelogError, match=r"expected a .*, found: "):
        read(tmp_path)


@pytest.mark.parametrize("read", READERS)
def test_a_file_beyond_all_measure_is_refused_and_not_read(
    read: Callable[[Path], Any], tmp_path: Path
) -> None:
    with (tmp_path / "a.toml").open("wb") as stream:
        stream.truncate(2**36)  # no disk space
    start = time.monotonic()
    with pytest.raises(TurtlelogError, match=r"found: more than [0-9,]+ bytes\Z"):
        read(tmp_path / "a.toml")
    assert time.monotonic() - start < 2.0


def test_a_file_may_have_so_many_bytes_and_no_more(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"#" * MOST_BYTES)
    assert len(read_text_file(path)) == MOST_BYTES
    path.write_bytes(b"#" * (MOST_BYTES + 1))
    with pytest.raises(OSError, match="more than 1,048,576 bytes"):
        read_text_file(path)


def test_a_reference_that_is_no_file_is_refused(tmp_path: Path) -> None:
    if not Path("/dev/zero").exists():
        pytest.skip("has no such device")
    (tmp_path / "a.json").symlink_to("/dev/zero")
    with pytest.raises(TurtlelogError, match=r"a\.json: expected a file, found a device"):
        load_reference(tmp_path / "a.json")


on_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="has no pipes with a name")


@on_pipes
@pytest.mark.parametrize("read", READERS)
def test_a_pipe_that_nobody_writes_to_is_not_waited_for(
    read: Callable[[Path], Any], tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "a.toml")
    start = time.monotonic()
    with pytest.raises(TurtlelogError, match=r"found: a pipe that nobody writes to\Z"):
        read(tmp_path / "a.toml")
    assert time.monotonic() - start < 5.0


@on_pipes
@pytest.mark.parametrize("before_s", [0.0, 0.3])
def test_a_pipe_is_read_to_its_end_however_slowly_it_comes(before_s: float, tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    os.mkfifo(path)

    def write() -> None:
        time.sleep(before_s)
        with path.open("w", encoding="utf-8") as stream:
            for part in ('name = "a"\n', "seed = 1\n", "max_duration_s = 2\n"):
                time.sleep(0.1)
                stream.write(part)
                stream.flush()

    writer = threading.Thread(target=write)
    writer.start()
    scenario = read_scenario(path)
    writer.join()
    assert (scenario.name, scenario.seed, scenario.max_duration_s) == ("a", 1, 2.0)


@on_pipes
def test_an_endless_pipe_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    os.mkfifo(path)
    command = [sys.executable, "-c", "import sys\nwhile True: print('#' * 1000)"]
    both = os.open(path, os.O_RDWR)  # so that nobody waits for the other to open it
    with subprocess.Popen(command, stdout=both, stderr=subprocess.DEVNULL) as writer:
        with pytest.raises(TurtlelogError, match="found: more than 1,048,576 bytes"):
            read_scenario(path)
        writer.kill()
    os.close(both)


def nest(depth: int) -> list[str]:
    """Return TOML texts whose tables and arrays lie so deep within each other."""
    return [
        f"a = {'[' * (depth - 1)}{']' * (depth - 1)}",
        f"a = {'{a = ' * (depth - 1)}1{'}' * (depth - 1)}",
        f"{'.'.join(['a'] * depth)} = 1",
        f"[{'.'.join(['a'] * (depth - 1))}]\nb = 1",
        f"""a = {{ {" . ".join(['"a"'] * (depth - 1))} = 1 }}""",
        f"[[{'.'.join(['a'] * (depth // 2))}]]\n{'.'.join(['b'] * (depth - depth // 2 - 1))} = 1",
    ]


@pytest.mark.parametrize("kind", range(6))
def test_toml_may_be_so_deep_and_no_deeper(kind: int) -> None:
    assert parse_toml(nest(33)[kind])
    for depth in (34, 1_000, 100_000):
        start = time.monotonic()
        with pytest.raises(ValueError, match=r"\Atables or arrays more than 32 deep within each"):
            parse_toml(nest(depth)[kind])
        assert time.monotonic() - start < 2.0


@pytest.mark.parametrize("read", READERS[:3])
@pytest.mark.parametrize("text", nest(100_000), ids=range(6))
def test_deep_toml_says_what_is_wrong_in_one_line(
    read: Callable[[Path], Any], text: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text, encoding="utf-8")
    found = r"tables or arrays more than 32 deep within each other"
    with pytest.raises(TurtlelogError, match=rf"a\.toml: not TOML: {found}\Z"):
        read(path)


@pytest.mark.parametrize("value", ["[" * 50_000, "{a=" * 20_000, "[" * 900 + "]" * 900])
def test_a_deep_value_of_set_is_refused_in_one_line(value: str) -> None:
    changes = parse_assignments([f"law.kp_linear={value}"], source="--set")
    line = r"\A--set: law\.kp_linear: expected a number > 0, found [^\n]{60,70}\.\.\. [^\n]*\Z"
    with pytest.raises(TurtlelogError, match=line):
        override_scenario(tl.load_scenario("paper"), changes, source="--set")


@pytest.mark.parametrize(("letters", "is_one_line"), [(80, True), (81, False)])
def test_list_of_numbers_stands_in_one_line_up_to_80_letters(
    letters: int, *, is_one_line: bool
) -> None:
    # Nineteen numbers of a digit take 19 * 1 + 18 * 2 = 55 letters, and two more the rest.
    values = [*[1] * 19, 10 ** (letters - 57 - 1)]
    text = format_toml({"at": values})
    assert parse_toml(text) == {"at": values}
    assert (text == f"at = {values}\n") == is_one_line
    assert text.startswith("at = [1, 1, " if is_one_line else "at = [\n    1, 1, ")


def test_long_list_of_numbers_is_wrapped_between_them() -> None:
    values = [-1.2345678901234567e-100 * number for number in range(1, 31)]
    text = format_toml({"law": {"speed_m_s": values}})
    assert parse_toml(text) == {"law": {"speed_m_s": values}}
    first, *lines, last = text.splitlines()[1:]
    assert (first, last) == ("speed_m_s = [", "]")
    assert all(line.startswith("    -") and 50 < len(line) <= 84 for line in lines)


@pytest.mark.parametrize("count", [4, 40])
def test_long_list_of_points_has_a_line_for_each(count: int) -> None:
    points = [[1.5 + number, -2e-05] for number in range(count)]
    text = format_toml({"points": points})
    assert parse_toml(text) == {"points": points}
    is_long = text.startswith("points = [\n    [1.5, -2e-05],\n    [2.5, -2e-05],\n")
    assert is_long == (count == 40)
    assert len(text.splitlines()) == (42 if count == 40 else 1)


def test_lists_of_text_and_text_like_lists_stay_as_they_are() -> None:
    tables = {"name": "[\n    1.0,\n]", "kinds": ["[", "1.0,", "]"], "none": [], "mixed": [1, "a"]}
    text = format_toml(tables)
    assert parse_toml(text) == tables
    assert text == tomli_w.dumps(tables)


LINES = 'a = 1\nb = "x = 1"\n\n[law]\nkind = "p"\nkp = 2.5\n[loop]\nkp = 1e-3\nwrap = true\n'


@pytest.mark.parametrize(
    "text",
    [
        *(LINES, LINES.replace("\n", "\r\n"), "", "\n", "# nothing\n", "a.b = 1\na.c = 2\n"),
        "a = [\n1,\n2]\n[t]\nb = {c = 1}\n",
        'a = """\nb = 1\n[c]\n"""\nd = 2\n',
        "a = '''\nb = 1\n'''\n",
        "[a.b]\nc = 1\n[a]\nd = 2\n",
        "[[a]]\nb = 1\n[[a]]\nb = 2\n",
        '["a b"]\nc = 1 # said\n  d = 2\n',
        f"a = 1 # {'long ' * 50}\n",
    ],
)
def test_a_text_read_line_by_line_is_read_as_a_whole_is(text: str) -> None:
    assert parse_known_toml(text) == parse_toml(text)
    assert parse_known_toml(text) == parse_toml(text)  # now of lines that are known


@pytest.mark.parametrize(
    "text",
    ["a = 1\na = 1\n", "[a]\n[a]\n", "a = 1\n[a]\n", "a = [\nb = 1\n", "a\n", "[a\nb = 1\n"],
)
def test_a_text_read_line_by_line_is_refused_as_a_whole_is(text: str) -> None:
    with pytest.raises(ValueError) as whole:  # noqa: PT011
        parse_toml(text)
    with pytest.raises(ValueError) as lines:  # noqa: PT011
        parse_known_toml(text)
    assert str(lines.value) == str(whole.value)
