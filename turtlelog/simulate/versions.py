"""The simulating software, which becomes the entries of `Run.simulated_by`."""

import platform
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from turtlelog.laws import LAWS, find_law, find_module, is_given, read_law_source
from turtlelog.run.software import LAW
from turtlelog.version import __version__


def find_software(law: str) -> dict[str, str]:
    """Return the versions, the platform and, for a user law, a digest of its code.

    The platform includes the C library, because sines and cosines may differ in their last bits.

    Args:
        law: Kind of the simulated law, which has been loaded.
    """
    code = None if law in LAWS else _read_code(law)
    digest = {} if code is None else {LAW: f"sha256 {sha256(code).hexdigest()[:16]}"}
    return {**_find_versions(), **digest}


@cache
def _find_versions() -> dict[str, str]:
    library = " ".join(platform.libc_ver())
    return {
        "turtlelog": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()} {library}".strip(),
    }


def _read_code(kind: str) -> bytes | None:
    """Return the text of the file that defines a law; None if there is no such file."""
    if is_given(kind):
        source = read_law_source(kind)
        return None if source is None else source.encode()
    file = getattr(sys.modules.get(find_module(find_law(kind))), "__file__", None)
    try:
        return None if file is None else Path(file).read_bytes()
    except OSError:
        return None
