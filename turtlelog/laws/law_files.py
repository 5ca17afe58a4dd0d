"""Load the file of a law as a module. Modules imported from its folder are private to the folder.

`sys.path` and the names of other modules do not change. If two laws in two folders each `import
helper`, each law gets its own `helper`, also if the import is in `step`. Import statements of these
modules search the folder first, except for the standard library and turtlelog. Functions such as
`importlib.import_module` do not search the folder.
"""

import builtins
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from hashlib import sha256
from importlib.abc import MetaPathFinder
from importlib.machinery import (
    EXTENSION_SUFFIXES,
    SOURCE_SUFFIXES,
    ExtensionFileLoader,
    FileFinder,
    ModuleSpec,
    SourceFileLoader,
)
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NoReturn

_PREFIX: Final = "turtlelog_law_folder_"

_NEVER_BESIDE: Final = sys.stdlib_module_names | {"__main__", "turtlelog"}
"""Modules that a file beside a law cannot replace: a `random.py` in the folder may be unrelated."""


def load_law_file(path: Path) -> ModuleType:
    """Return the module of a file. An unchanged file gives the same module.

    Raises:
        OSError: If the file cannot be read.
        BaseException: Any exception that the file raises.
    """
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


class _LawFolder:
    """A folder of laws: a package with a unique name.

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
            (ExtensionFileLoader, EXTENSION_SUFFIXES),
            (partial(_Loader, self.builtins), SOURCE_SUFFIXES),
        )
        package = ModuleType(name)
        package.__path__ = [str(path)]
        sys.modules[name] = self._package = package

    def find_spec(self, name: str, path: Sequence[str]) -> ModuleSpec | None:
        """Return the spec of a module of the package, found below the parent module's folders."""
        specs = (FileFinder(one, *self._loaders).find_spec(name) for one in path)
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


class _Loader(SourceFileLoader):
    """Loader of a module of a folder of laws, without a cache, which would miss quick edits."""

    def __init__(self, inner: dict[str, Any], name: str, path: str) -> None:
        super().__init__(name, path)
        self._builtins = inner

    def path_stats(self, path: Any) -> NoReturn:
        raise OSError(path)

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["__builtins__"] = self._builtins
        super().exec_module(module)


class _Finder(MetaPathFinder):
    """Finder of the modules in folders of laws, by their names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        del target
        folder = _FOLDERS.get(fullname.partition(".")[0])
        return None if folder is None else folder.find_spec(fullname, path or ())


_FOLDERS: Final[dict[str, _LawFolder]] = {}
_FINDER: Final = _Finder()


def _name_folder(path: Path) -> str:
    return f"{_PREFIX}{sha256(str(path).encode()).hexdigest()[:16]}"


def _open_folder(path: Path) -> _LawFolder:
    name = _name_folder(path)
    if name not in _FOLDERS:
        _FOLDERS[name] = _LawFolder(name, path)
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)  # before those that know files alone
    return _FOLDERS[name]
