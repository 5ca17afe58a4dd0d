"""From the `kind` of a scenario's law to its class."""

import dataclasses
import importlib
import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Final

from turtlelog.errors import LawError
from turtlelog.laws.base import Law
from turtlelog.laws.sequential_p import SequentialP

LAWS: Final = MappingProxyType({"sequential-p": SequentialP})
"""The built-in laws by kind."""


def find_law(kind: str) -> type[Law]:
    """Return the class of a law: a built-in kind, `path.py:Class` or `package.module:Class`.

    The last two run the code that they name.

    Raises:
        LawError: Where there is no such law, or the class is not one.
    """
    if kind in LAWS:
        return LAWS[kind]
    place, colon, name = kind.rpartition(":")
    if not colon or not place or not name:
        known = ", ".join(LAWS)
        raise LawError(f"expected {known}, path.py:Class or package.module:Class, found {kind!r}")
    law = getattr(_load_module(place), name, None)
    if law is None:
        raise LawError(f"expected a class {name} in {place}, found none")
    _require_law(law, kind)
    return law  # type: ignore[no-any-return]


def _load_module(place: str) -> ModuleType:
    if place.endswith(".py") and not Path(place).is_file():
        raise LawError(f"expected a Python file at {place}, found none")
    try:
        return _run_file(Path(place)) if place.endswith(".py") else importlib.import_module(place)
    except Exception as err:
        raise LawError(f"{place} cannot be loaded: {type(err).__name__}: {err}") from err


def _run_file(path: Path) -> ModuleType:
    loader = SourceFileLoader(f"turtlelog_law_{path.stem}", str(path))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    module = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
    # Dataclasses look their module up by name.
    sys.modules[loader.name] = module
    loader.exec_module(module)
    return module


def _require_law(law: object, kind: str) -> None:
    missing = [name for name in ("Parameters", "reset", "step") if not hasattr(law, name)]
    if not isinstance(law, type) or missing:
        wanted = "a class with Parameters, reset and step"
        raise LawError(f"{kind}: expected {wanted}, found {law!r} without {', '.join(missing)}")
    if not dataclasses.is_dataclass(law.Parameters):  # type: ignore[attr-defined]
        raise LawError(f"{kind}: expected Parameters to be a frozen dataclass")
