"""From the `kind` of a scenario's law to its class."""

import dataclasses
import hashlib
import importlib
import sys
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Final

from turtlelog.errors import LawError, describe_error
from turtlelog.laws.base import Law
from turtlelog.laws.sequential_p import SequentialP

LAWS: Final = MappingProxyType({"sequential-p": SequentialP})
"""The built-in laws by kind."""


def find_law(kind: str) -> type[Law]:
    """Return the class of a law: a built-in kind, `path.py:Class` or `package.module:Class`.

    The last two run the code that they name. A file that has not changed gives the same class.

    Raises:
        LawError: Where there is no such law, or the class is not one.
    """
    if kind in LAWS:
        return LAWS[kind]
    require_law_name(kind)
    place, _, name = kind.rpartition(":")
    law = getattr(_load_module(place), name, None)
    if law is None:
        raise LawError(f"expected a class {name} in {place}, found none")
    _require_law(law, kind)
    return law  # type: ignore[no-any-return]


def require_law_name(kind: str) -> None:
    """Refuse what can name no law. Loads nothing.

    Raises:
        LawError: Where it is neither built in nor `place:Class`.
    """
    place, colon, name = kind.rpartition(":")
    if kind not in LAWS and not (colon and place and name):
        known = ", ".join(LAWS)
        raise LawError(f"expected {known}, path.py:Class or package.module:Class, found {kind!r}")


def _load_module(place: str) -> ModuleType:
    if place.endswith(".py") and not Path(place).is_file():
        raise LawError(f"expected a Python file at {place}, found none")
    try:
        return _run_file(Path(place)) if place.endswith(".py") else importlib.import_module(place)
    except (Exception, SystemExit) as err:
        raise LawError(f"{place} cannot be loaded: {describe_error(err)}") from err


def _run_file(path: Path) -> ModuleType:
    source = path.read_bytes()
    # Compiled here: Python's own cache beside the file overlooks an edit within the same second.
    key = hashlib.sha256(str(path.resolve()).encode() + source).hexdigest()[:16]
    name = f"turtlelog_law_{path.stem}_{key}"
    if name in sys.modules:
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(path)
    # Dataclasses and pickle look their module up by name.
    sys.modules[name] = module
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _require_law(law: object, kind: str) -> None:
    if not isinstance(law, type):
        raise LawError(f"{kind}: expected a class, found an instance of {type(law).__name__}")
    missing = [name for name in ("Parameters", "reset", "step") if not hasattr(law, name)]
    if missing:
        raise LawError(f"{kind}: expected Parameters, reset and step, found no {missing[0]}")
    parameters = law.Parameters  # type: ignore[attr-defined]
    is_dataclass = isinstance(parameters, type) and dataclasses.is_dataclass(parameters)
    if not is_dataclass or not parameters.__dataclass_params__.frozen:
        found = "one that is not frozen" if is_dataclass else repr(parameters)[:60]
        raise LawError(f"{kind}: expected Parameters to be a frozen dataclass, found {found}")
