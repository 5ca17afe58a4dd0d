import struct

import pytest

from turtlelog.errors import LogError, RunError
from turtlelog.log.border import name_file


@pytest.mark.parametrize("error", [struct.error, KeyError, MemoryError, OverflowError, RunError])
def test_what_foreign_bytes_cause_names_the_file(error: type[Exception]) -> None:
    with pytest.raises(LogError, match=r"^a\.mcap: "), name_file("a.mcap", expected="a recording"):
        raise error("odd")


@pytest.mark.parametrize("error", [AttributeError, NameError, AssertionError, ImportError])
def test_a_defect_of_our_own_is_not_blamed_on_the_file(error: type[Exception]) -> None:
    with pytest.raises(error), name_file("a.mcap", expected="a recording"):
        raise error("defect")
