import shutil
from pathlib import Path

import pytest

# pytester forgets the modules that a run inside this process has loaded, and numpy loads but once:
# what the plugin loads when it is asked is loaded here, for all runs.

RECORDINGS = Path(__file__).parents[3] / "recordings" / "paper"


@pytest.fixture
def suite(pytester: pytest.Pytester) -> pytest.Pytester:
    """A team's folder: two of the paper's recordings in runs/, and nothing else."""
    runs = pytester.mkdir("runs")
    for name in ("kp4", "kp10"):
        shutil.copyfile(RECORDINGS / f"{name}.mcap", runs / f"{name}.mcap")
    pytester.makeini("[pytest]\nfilterwarnings = error\nstrict = true\n")
    return pytester


NAMES = "\n".join(
    ["import pytest"]
    + [
        f"@pytest.fixture\ndef {name}(turtlelog_{name}):\n    return turtlelog_{name}\n"
        for name in ("recording", "reference", "simulate")
    ]
)
"""A team's conftest.py that gives the fixtures shorter names, as docs/checking.md shows."""


def run(
    pytester: pytest.Pytester, body: str, *words: str, marker: str = '"runs/*.mcap"'
) -> pytest.RunResult:
    """Run tests with the plugin in this process; `body` follows the marker."""
    if not (pytester.path / "conftest.py").exists():
        pytester.makeconftest(NAMES)
    head = "import pytest\nfrom turtlelog import Tolerance, override_scenario\n"
    mark = f"pytestmark = pytest.mark.recordings({marker})\n" if marker else ""
    pytester.makepyfile(head + mark + body)
    plugin = ("-p", "turtlelog.check.pytest_plugin", "-p", "no:cacheprovider")
    return pytester.runpytest_inprocess(*plugin, *words)
