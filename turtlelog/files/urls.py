"""URLs in place of files, such as `s3://bucket/run.mcap`: paths that fetch their content.

Printed URLs contain no password and no signature.
"""

import errno
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Final

from turtlelog.errors import RemoteError, UsageError
from turtlelog.escapes import URL, show_url

if TYPE_CHECKING:
    from turtlelog.files.remote_file import RemoteFile

_TOPIC: Final = re.compile(r"(.*?):(/[A-Za-z_~{][\w/~{}]*)([?#].*)?", re.DOTALL)
"""Pattern that splits the URL of a file, a ROS topic, and the text behind both."""

if TYPE_CHECKING:
    _LocalPath = Path
else:
    _LocalPath = type(Path())  # until Python 3.12 Path itself cannot have children


_MAX_DOWNLOAD: Final[ContextVar[int]] = ContextVar("max_download", default=4 * 2**30)
"""Largest size of a download into a temporary file [bytes]: the free space of a small disk."""

_SIZES: Final = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12,
    "Ki": 2**10, "Mi": 2**20, "Gi": 2**30, "Ti": 2**40}  # fmt: skip


@contextmanager
def limit_downloads(most: int | None = None) -> Iterator[None]:
    """Limit the size of downloads into temporary files within a block.

    Args:
        most: Largest size of one file [bytes]; None: the limit before the block.
    """
    token = _MAX_DOWNLOAD.set(_MAX_DOWNLOAD.get() if most is None else most)
    try:
        yield
    finally:
        _MAX_DOWNLOAD.reset(token)


def set_max_download(most: int) -> None:
    """Set the limit until the end of the enclosing `limit_downloads` block."""
    _MAX_DOWNLOAD.set(most)


def parse_size(text: str) -> int | None:
    """Return a size such as 500MB, 4GiB or 4G in bytes; None if the text is not a size."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?) *([kKMGT]?i?)B?", text)
    prefix = "" if found is None else found[2].replace("K", "k").replace("ki", "Ki")
    if found is None or prefix not in _SIZES:
        return None
    return int(float(found[1]) * _SIZES[prefix])


def format_size(count: int) -> str:
    """Return a number of bytes as text in the largest suitable unit, such as `4 GiB`."""
    unit = next((name for name in ("Ti", "Gi", "Mi", "Ki") if count >= _SIZES[name]), "")
    return f"{count / _SIZES[unit]:.4g} {unit}B" if unit else f"{count} bytes"


class RemoteNote(UserWarning):
    """A note on a file that needed more requests than necessary."""


def is_url(text: str) -> bool:
    """Return whether a text is a URL. `C:/x.mcap` and a file called `a:b.mcap` are not URLs."""
    return URL.match(text) is not None


class _ShownUrl(str):
    """Text of a remote path. A path made from this text has the complete URL.

    Attributes:
        path: Path that the text belongs to.
    """

    path: "RemotePath"

    def __reduce__(self) -> tuple[Any, tuple["RemotePath"]]:
        return str, (self.path,)


class RemotePath(_LocalPath):
    """A file behind a URL. The text of the path is the URL without secrets.

    Attributes:
        url: The complete URL.
        max_download: Largest download into a temporary file [bytes], needed for SQLite files and
            servers without ranges. Default: the limit of `limit_downloads`, or else 4 GiB.
    """

    url: str
    _most: int | None
    _file: "RemoteFile | None"
    _failure: RemoteError | None

    def __new__(cls, url: str, *, max_download: int | None = None) -> "RemotePath":  # noqa: ARG004
        """Create a path from its text."""
        return super().__new__(cls, show_url(url))

    def __init__(self, url: str, *, max_download: int | None = None) -> None:
        if sys.version_info >= (3, 12):
            super().__init__(show_url(url))
        self.url, self._file, self._failure = url, None, None
        self._most = max_download

    @property
    def max_download(self) -> int:
        """Largest download into a temporary file [bytes]."""
        return _MAX_DOWNLOAD.get() if self._most is None else self._most

    def __str__(self) -> str:
        shown = _ShownUrl(show_url(self.url))
        shown.path = self
        return shown

    def __fspath__(self) -> str:
        return str(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RemotePath) and self.url == other.url

    def __hash__(self) -> int:
        return hash(self.url)

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return partial(RemotePath, max_download=self.max_download), (self.url,)

    def split_topic(self) -> tuple["RemotePath", str | None]:
        """Return the URL and the topic in URL:TOPIC, as in `https://host/bag.mcap:/odom`."""
        scheme, mark, rest = self.url.partition("://")
        found = _TOPIC.fullmatch(rest)
        if found is None:
            return self, None
        url = scheme + mark + found[1] + (found[3] or "")
        return RemotePath(url, max_download=self._most), found[2]

    @property
    def file(self) -> "RemoteFile":
        """File object that fetches the data.

        The object is kept, so that the file's ends are fetched once.

        Raises:
            RemoteError: If the file does not exist or cannot be reached.
        """
        if self._failure is not None:
            raise self._failure
        if self._file is None:
            from turtlelog.files.remote_file import RemoteFile

            try:
                self._file = RemoteFile(self.url, self.max_download)
            except RemoteError as err:
                self._failure = err
                raise
        return self._file

    def put(self, source: Path) -> None:
        """Upload a complete local file, replacing an existing object."""
        from turtlelog.files.requests import put_file

        put_file(source, self.url)
        self._file = self._failure = None

    def open(self, mode: str = "r", *args: Any, **options: Any) -> IO[Any]:  # type: ignore[override]  # noqa: ARG002
        """Open the file for reading bytes."""
        if mode != "rb":
            raise ValueError(f"a URL: expected mode rb, found {mode}")
        return self.file.open()

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:  # noqa: ARG002
        """Return the size of the file. A remote file is never written in place."""
        return os.stat_result((stat.S_IFREG | 0o444, 0, 0, 1, 0, 0, self.file.size, 0, 0, 0))

    def mkdir(self, *_: Any, **__: Any) -> None:
        """Refuse to create a folder; folders exist only on disks."""
        raise OSError(errno.ENOTSUP, "a URL, where only single files are written", str(self))

    def is_dir(self, **_: Any) -> bool:
        """Return False, because folders of bags are read only from disks."""
        return False

    def is_file(self, **_: Any) -> bool:
        """Return True, because only reading shows that a file is missing."""
        return True

    def is_symlink(self) -> bool:
        """Return False."""
        return False

    def exists(self, **_: Any) -> bool:
        """Return True, because only reading shows that a file is missing."""
        return True

    def resolve(self, strict: bool = False) -> "RemotePath":  # noqa: ARG002, FBT001, FBT002
        """Return the path unchanged."""
        return self

    def absolute(self) -> "RemotePath":
        """Return the path unchanged."""
        return self

    def samefile(self, other_path: "str | os.PathLike[str]") -> bool:
        """Return whether another path has the same URL."""
        return self == other_path

    @property
    def parent(self) -> "RemotePath":
        """The URL of the folder."""
        return self._replace(lambda path: path.rpartition("/")[0])

    @property
    def parents(self) -> Sequence["RemotePath"]:
        """Always empty, because no output is within an object."""
        return ()

    def with_name(self, name: str) -> "RemotePath":
        """Return the path with another file name."""
        return self._replace(lambda path: f"{path.rpartition('/')[0]}/{name}")

    def with_suffix(self, suffix: str) -> "RemotePath":
        """Return the path with another suffix."""
        return self.with_name(self.stem + suffix)

    def __truediv__(self, key: "str | os.PathLike[str]") -> "RemotePath":
        return self._replace(lambda path: f"{path.rstrip('/')}/{os.fspath(key)}")

    def _replace(self, change: Callable[[str], str]) -> "RemotePath":
        place, end = re.fullmatch(r"([^?#]*)(.*)", self.url, re.DOTALL).groups()  # type: ignore[union-attr]
        scheme, mark, path = place.partition("://")
        return RemotePath(scheme + mark + change(path) + end, max_download=self._most)


def make_path(path: "str | os.PathLike[str]") -> Path:
    """Return the path of a file or URL that a user names.

    Raises:
        UsageError: If the argument is not a path.
    """
    if not isinstance(path, str | os.PathLike):
        raise UsageError(f"path: expected text or a Path, found {path!r:.60}")
    if isinstance(path, Path):  # in which no URL has both of its slashes
        return path
    if isinstance(path, _ShownUrl):
        return path.path
    text = os.fspath(path)
    return RemotePath(text) if is_url(text) else Path(path)


def is_there(path: Path) -> bool:
    """Return whether a file, or an object behind a URL, exists."""
    if not isinstance(path, RemotePath):
        return path.exists()
    from turtlelog.files.requests import find_object

    return find_object(path.url)


def has_files(folder: Path) -> bool:
    """Return whether a folder contains anything, or any object exists below a URL."""
    if not isinstance(folder, RemotePath):
        return folder.is_dir() and any(folder.iterdir())
    from turtlelog.files.requests import find_objects

    return find_objects(folder.url)


def expect_reads(stream: BinaryIO, ranges: Iterable[tuple[int, int]]) -> None:
    """Announce the next ranges to a remote stream. Local streams ignore the announcement."""
    expect = getattr(stream, "expect", None)
    if expect is not None:
        expect(ranges)
