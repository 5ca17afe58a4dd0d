"""Load the class of a law by the `kind` of the scenario.

Modules imported from the folder of a law's file are private to that folder: `sys.path` and the
names of other modules do not change. If two laws in two folders each `import helper`, each law gets
its own `helper`, also if the import is in `step`. Import statements of these modules search the
folder first, except for the standard library and turtlelog. Functions such as
`importlib.import_module` do not search the folder.
"""

import builtins
import dataclasses
import importlib
import inspect
import re
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from functools import partial
from hashlib import sha256
from importlib import machinery
from importlib.abc import MetaPathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NoReturn

from turtlelog.display import NamedValues
from turtlelog.errors import LawError, TurtlelogError, describe_error, describe_unknown
from turtlelog.laws.base import AnyLaw, Goal, LawPart
from turtlelog.parts import load_parts
from turtlelog.run.loops import Cause, Declaration
from turtlelog.run.paths import Path as TrackedPath

_PROTOCOL: Final = "docs/own-law.md describes what a law is"

_SCENARIO_KEY: Final = re.compile(r"(?!law\b)[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)*")
"""A table of the scenario, or a key in it. Parameters of the law are checked by the law."""

_FILES: Final = (
    "sequential_p",
    "sequential_pid",
    "posture",
    "pure_pursuit",
    "kanayama",
    "open_loop",
)

LAWS: Final[Mapping[str, LawPart]] = NamedValues(
    "law", {part.name: part for part in load_parts("turtlelog.laws", _FILES)}
)
"""The `PART` of each file of laws, by kind."""


def find_law(kind: str) -> AnyLaw:
    """Return a law by its name: a built-in kind, `path.py:Name` or `package.module:Name`.

    The last two forms run the named code. An unchanged file gives the same law. Name is a class, or
    a `LawPart`.

    Raises:
        LawError: If no law has this name, or the object of this name is not a control law.
    """
    if kind in LAWS:
        return LAWS[kind]
    require_law_name(kind)
    place, _, name = kind.rpartition(":")
    from turtlelog.laws import given_laws  # few commands run such a law

    law: Any = None
    if place == "session":
        law = given_laws.find_given_law(kind)
    else:
        law = getattr(_load_module(place), name, None)
    if law is None:
        raise LawError(f"{place} has no class {name}")
    if isinstance(law, LawPart):
        return law
    if inspect.isfunction(law):
        _require_call(law, ("time_ns", "pose", "goal"), kind)
    elif not isinstance(law, type):
        found = f"an instance of {type(law).__name__}"
        raise LawError(f"{kind}: expected a class, a function or a LawPart, found {found}")
    elif not hasattr(law, "step"):
        raise LawError(f"{kind}: a law needs a method step(self, time_ns, pose): {_PROTOCOL}")
    law = given_laws.complete_short_law(law)
    _require_law(law, kind)
    return law  # type: ignore[no-any-return]


def name_law(law: AnyLaw) -> str:
    """Return the name of a law for errors."""
    return law.name if isinstance(law, LawPart) else law.__name__


def find_module(law: AnyLaw) -> str:
    """Return the name of the module that defines a law."""
    return law.step.__module__ if isinstance(law, LawPart) else law.__module__


def declare_law(
    law: AnyLaw, parameters: object, goal: Goal | None, path: TrackedPath | None = None
) -> Declaration:
    """Return the declaration of a law. Without a declaration, a law has one phase and no loop.

    Raises:
        LawError: If `declare` fails, returns no declaration, or uses a forbidden name of a loop or
            state.
    """
    declare = getattr(law, "declare", None)
    if declare is None:
        return Declaration()
    place = f"{name_law(law)}.declare"
    with _tell_errors(law, place):
        # Twice: who records a run asks again, and reads its samples by the answer.
        declared, again = declare(parameters, goal, path), declare(parameters, goal, path)
    if not isinstance(declared, Declaration):
        raise LawError(f"{place}: expected a Declaration, found {type(declared).__name__}")
    if declared != again or [*declared.phases] != [*again.phases]:
        raise LawError(f"{place}: must return the same Declaration for the same parameters")
    _require_nameable(declared, place)
    return declared


@contextmanager
def _tell_errors(law: AnyLaw, place: str) -> Iterator[None]:
    """Raise a LawError with the place for an error of a law; those of built-in laws name a key."""
    try:
        with print_to_stderr():
            yield
    except KeyboardInterrupt:
        raise
    except BaseException as err:
        if isinstance(err, LawError) and law in LAWS.values():
            raise
        raise LawError(f"{place}: {describe_law_error(err, law)}") from err


def _require_nameable(declared: Declaration, place: str) -> None:
    """Refuse names that formulas cannot contain, although recordings with such names are read."""
    for loop in declared.loops:
        if "-" in loop.name:
            expected = "a name of letters, digits and _, as - is minus in formulas"
            raise LawError(f"{place}: loop: expected {expected}, found {loop.name!r}")
    if not declared.states:
        return
    from turtlelog.expressions.parser import KEYWORDS  # most laws have no states

    for state in declared.states:
        if state in KEYWORDS:
            expected = "a name that is no word of formulas"
            raise LawError(f"{place}: state: expected {expected}, found {state!r}")


def list_causes(law: AnyLaw) -> tuple[Cause, ...]:
    """Return the causes that a law adds to the ideal loop.

    Raises:
        LawError: If the law lists anything that is not a cause.
    """
    causes = getattr(law, "causes", ())
    if isinstance(causes, tuple) and all(isinstance(one, Cause) for one in causes):
        return causes
    expected = "a tuple of Cause"
    raise LawError(f"{name_law(law)}.causes: expected {expected}, found {causes!r:.60}")


def list_sample_counters(law: AnyLaw) -> tuple[str, ...] | None:
    """Return the parameters of a law that count samples; None if the law does not list them.

    Raises:
        LawError: If the law lists a name that is not a parameter.
    """
    counters = getattr(law, "counts_samples", None)
    if counters is None:
        return None
    known = [field.name for field in dataclasses.fields(law.Parameters)]
    if isinstance(counters, tuple) and set(counters) <= set(known):
        return counters
    expected = f"a tuple of {', '.join(known)}" if known else "()"
    raise LawError(f"{name_law(law)}.counts_samples: expected {expected}, found {counters!r:.60}")


def list_unused_keys(law: AnyLaw, parameters: object) -> tuple[str, ...]:
    """Return the tables and keys of a scenario that a law does not use; () if the law lists none.

    Raises:
        LawError: If `list_unused` fails, or returns anything that is neither a table nor a key.
    """
    ask = getattr(law, "list_unused", None)
    if ask is None:
        return ()
    place = f"{name_law(law)}.list_unused"
    with _tell_errors(law, place):
        found = ask(parameters)
    if isinstance(found, tuple) and all(
        isinstance(key, str) and _SCENARIO_KEY.fullmatch(key) for key in found
    ):
        return found
    expected = "a tuple of tables and keys outside [law], such as goal.heading_rad"
    raise LawError(f"{place}: expected {expected}, found {found!r:.60}")


def print_to_stderr() -> AbstractContextManager[object]:
    """Send text that a law prints in the block to stderr, because stdout is for results."""
    return redirect_stdout(sys.stderr)


def describe_law_error(err: BaseException, law: AnyLaw) -> str:
    """Return an error raised by a law in one line, with its place in the file of the law."""
    file = getattr(sys.modules.get(find_module(law)), "__file__", None)
    frames = [] if file is None else traceback.extract_tb(err.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == file]
    reason = str(err) if isinstance(err, TurtlelogError) else describe_error(err)
    return f"{file}, line {lines[-1]}: {reason}" if lines else reason


def require_law_name(kind: str) -> None:
    """Refuse a name that cannot be the name of a law, without loading any code.

    Raises:
        LawError: If the name is neither a built-in kind nor `place:Class`.
    """
    place, colon, name = kind.rpartition(":")
    if kind not in LAWS and not (colon and place and name):
        place = "turtlelog list laws. A law of your own is path.py:Class or package.module:Class"
        raise LawError(describe_unknown("law", kind, LAWS, place=place))


def _load_module(place: str) -> ModuleType:
    if place.endswith(".py") and not Path(place).is_file():
        raise LawError(f"no Python file {place}")
    try:
        with print_to_stderr():
            if place.endswith(".py"):
                return load_law_file(Path(place))
            return importlib.import_module(place)
    except KeyboardInterrupt:
        raise
    except BaseException as err:
        reason = describe_error(err)
        if isinstance(err, ImportError) and "'Phase'" in reason:
            reason = f"{reason}: a law names its phases itself now, as text: {_PROTOCOL}"
        file = f"{place.replace('.', '/')}.py"
        if isinstance(err, ModuleNotFoundError) and Path(file).is_file():
            reason = f"{reason}: the file {file} is no installed module; write {file}:CLASS"
        raise LawError(f"{place} cannot be loaded: {reason}") from err


def _require_law(law: Any, kind: str) -> None:
    parameters = law.Parameters
    is_dataclass = isinstance(parameters, type) and dataclasses.is_dataclass(parameters)
    if not is_dataclass or not parameters.__dataclass_params__.frozen:
        found = "one that is not frozen" if is_dataclass else repr(parameters)[:60]
        raise LawError(f"{kind}: expected Parameters to be a frozen dataclass, found {found}")
    if "kind" in parameters.__dataclass_fields__:
        taken = "kind, which names the law"
        raise LawError(f"{kind}: expected another name of a parameter than {taken}")
    _require_call(law.reset, ("self", "start", "goal", "path"), f"{kind}: reset")
    _require_call(law.step, ("self", "time_ns", "pose"), f"{kind}: step")
    if hasattr(law, "take_limits"):
        names = ("self", "speed_m_s", "turn_rate_rad_s")
        _require_call(law.take_limits, names, f"{kind}: take_limits")


def _require_call(method: object, names: tuple[str, ...], place: str) -> None:
    """Refuse a method that does not accept the arguments of its call."""
    if not callable(method):
        raise LawError(f"{place}: expected a method, found {method!r:.60}")
    try:
        signature = inspect.signature(method)
    except (TypeError, ValueError):
        return  # Of a builtin: only calling it tells.
    try:
        signature.bind(*names)
    except TypeError as err:
        expected = f"({', '.join(names)})"
        raise LawError(f"{place}: expected {expected}, found {signature}: {_PROTOCOL}") from err


# Files of laws.

_PREFIX: Final = "turtlelog_law_folder_"

_NEVER_BESIDE: Final = sys.stdlib_module_names | {"__main__", "turtlelog"}
"""Modules that a file beside a law cannot replace: a `random.py` in the folder may be unrelated."""


def load_law_file(path: Path) -> ModuleType:
    """Return the module of a file. An unchanged file gives the same module."""
    source, place = path.read_bytes(), path.resolve()
    key = sha256(str(place).encode() + source).hexdigest()[:16]
    name = f"turtlelog_law_{path.stem}_{key}"
    if name in sys.modules:
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(path)
    folder = _open_folder(place.parent)
    folder.elsewhere.clear()  # the file may have been edited because of one that was missing
    vars(module)["__builtins__"] = folder.builtins
    # Dataclasses and pickle look their module up by name.
    sys.modules[name] = module
    try:
        # Compiled here: Python's own cache beside the file overlooks an edit within a second.
        exec(compile(source, str(path), "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def list_law_files(path: Path) -> list[Path]:
    """Return the file of a law, and the files beside it that have been imported so far."""
    beside = f"{_name_folder(path.resolve().parent)}."
    modules = [module for name, module in [*sys.modules.items()] if name.startswith(beside)]
    files = [getattr(module, "__file__", None) for module in modules]
    return [path, *sorted(Path(file) for file in files if file)]


class _LawFolder(MetaPathFinder):
    """A folder of laws: a package with a unique name, and the finder of its modules.

    Attributes:
        name: Name of the package; the names of the modules in the folder begin with it.
        builtins: Python's builtins, with an import that searches the folder first.
        elsewhere: Names that the folder does not contain.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self.elsewhere: set[str] = set()
        self.builtins: dict[str, Any] = {**vars(builtins), "__import__": self._import}
        self._loaders: Any = (
            (machinery.ExtensionFileLoader, machinery.EXTENSION_SUFFIXES),
            (partial(_Loader, self.builtins), machinery.SOURCE_SUFFIXES),
        )
        package = ModuleType(name)
        package.__path__ = [str(path)]
        sys.modules[name] = self._package = package

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> machinery.ModuleSpec | None:
        """Return the spec of a module of the package, found below the parent module's folders."""
        del target
        if fullname.partition(".")[0] != self.name:
            return None
        specs = (
            machinery.FileFinder(one, *self._loaders).find_spec(fullname) for one in path or ()
        )
        return next((spec for spec in specs if spec is not None), None)

    def _import(
        self,
        name: str,
        globals: Mapping[str, object] | None = None,  # noqa: A002
        locals: Mapping[str, object] | None = None,  # noqa: A002
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        """Import like Python; a module of the folder is imported by its name in the package."""
        first = name.partition(".")[0]
        if level or not self._has(first):
            return builtins.__import__(name, globals, locals, fromlist, level)
        found = builtins.__import__(f"{self.name}.{name}", globals, locals, fromlist, 0)
        return found if fromlist else sys.modules[f"{self.name}.{first}"]

    def _has(self, first: str) -> bool:
        if first in _NEVER_BESIDE or first in self.elsewhere:
            return False
        name = f"{self.name}.{first}"
        if name in sys.modules:
            return True
        spec = self.find_spec(name, self._package.__path__)
        # A folder without `__init__.py`, of data maybe, counts where nothing else has the name.
        if spec is None or (spec.loader is None and find_spec(first) is not None):
            self.elsewhere.add(first)
            return False
        return True


class _Loader(machinery.SourceFileLoader):
    """Loader of a module of a folder of laws, without a cache, which would miss quick edits."""

    def __init__(self, inner: dict[str, Any], name: str, path: str) -> None:
        super().__init__(name, path)
        self._builtins = inner

    def path_stats(self, path: Any) -> NoReturn:
        raise OSError(path)

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["__builtins__"] = self._builtins
        super().exec_module(module)


_FOLDERS: Final[dict[str, _LawFolder]] = {}


def _name_folder(path: Path) -> str:
    return f"{_PREFIX}{sha256(str(path).encode()).hexdigest()[:16]}"


def _open_folder(path: Path) -> _LawFolder:
    name = _name_folder(path)
    if name not in _FOLDERS:
        _FOLDERS[name] = _LawFolder(name, path)
    folder = _FOLDERS[name]
    if folder not in sys.meta_path:
        sys.meta_path.insert(0, folder)  # before those that know files alone
    return folder
