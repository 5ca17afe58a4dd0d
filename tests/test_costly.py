from pathlib import Path

import pytest

from tests import costly

CONFTEST = """
import pytest
from tests.costly import require_reason
from tests.conftest import (
    pytest_collection_modifyitems, pytest_runtest_call, pytest_terminal_summary
)

@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    report = yield
    require_reason(item, report, long_s=0.05, fails_s=0.2)
    return report
"""
BUSY = "begin = time.process_time()\n    while time.process_time() < 0.3 + begin: pass"
INI = "[pytest]\nmarkers =\n    everyday: ids\n    thorough: costly\n"


@pytest.fixture
def suite(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    pytester.makeini(INI)
    pytester.makeconftest(CONFTEST)
    return pytester


def run(suite: pytest.Pytester, body: str, *words: str) -> pytest.RunResult:
    suite.makepyfile(f"import time\nimport pytest\n{body}")
    return suite.runpytest_inprocess("-p", "no:cacheprovider", *words)


EVERYDAY = """
@pytest.mark.everyday("b")
@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_it(name):
    pass
"""


@pytest.mark.parametrize(("chosen", "count"), [("not thorough", 1), ("thorough", 2), ("", 3)])
def test_ids_that_are_not_for_every_day_are_thorough(
    chosen: str, count: int, suite: pytest.Pytester
) -> None:
    run(suite, EVERYDAY, "-m", chosen).assert_outcomes(passed=count, deselected=3 - count)


def test_an_id_that_a_test_does_not_have_is_an_error(suite: pytest.Pytester) -> None:
    done = run(suite, EVERYDAY.replace('y("b")', 'y("d")'))
    done.stderr.fnmatch_lines(["*test_it: everyday: expected its ids, found {'d'}"])
    assert done.ret == pytest.ExitCode.USAGE_ERROR


def test_an_id_that_is_run_alone_needs_no_other(suite: pytest.Pytester) -> None:
    file = suite.makepyfile(f"import pytest\n{EVERYDAY}")
    suite.runpytest_inprocess(f"{file.name}::test_it[a]").assert_outcomes(passed=1)


@pytest.mark.parametrize(
    ("work", "named", "failed"),
    [("pass", 0, 0), ("time.sleep(0.3)", 1, 0), (BUSY, 1, 1)],
    ids=["quick", "waits", "works"],
)
def test_what_takes_long_without_a_reason_is_named_and_what_takes_very_long_fails(
    work: str, named: int, failed: int, suite: pytest.Pytester
) -> None:
    done = run(suite, f"def test_it():\n    {work}\n")
    done.assert_outcomes(passed=1 - failed, failed=failed)
    assert ("the first line does not say why" in done.stdout.str()) == bool(named)
    assert (" says why in" in done.stdout.str()) == bool(failed)


def test_what_takes_long_with_a_reason_passes(suite: pytest.Pytester) -> None:
    done = run(suite, f'def test_it():\n    """It works."""\n    {BUSY}\n')
    done.assert_outcomes(passed=1)
    assert "does not say why" not in done.stdout.str()


def test_reasons_are_asked_for_from_2_seconds_on_and_demanded_from_10() -> None:
    assert (costly.LONG_S, costly.FAILS_S) == (2.0, 10.0)
